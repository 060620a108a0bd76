"""The fit of a law to trials: its solutions through all samples of each, in place of forecasts."""

from dataclasses import replace

import numpy as np

from commonlaw.forecast.forecast import Forecast
from commonlaw.law import Law
from commonlaw.law.alignment import matched
from commonlaw.likelihood import NO_ERRORS
from commonlaw.trials import Trials


def fitted(law: Law, trials: Trials, return_std: bool = False) -> Forecast:
    """Return the solutions of a law whose initial conditions are estimated from all samples of each trial.

    ``x0 = argmin sum_i ((y_i - x(t_i; x0)) / sigma_i)^2`` with the coefficients as they are, and the Huber loss
    for outliers. Sigma is the standard deviation of a measurement: it varies along a trial where errors grow with the
    states. Process noise is left out, so that the residuals are all that the equations leave; such fits have no bands.

    Parameters
    ----------
    law
        A law in continuous time.
    trials
        What was measured.
    return_std
        Whether the curves are to have bands.

    Raises
    ------
    CommonlawError
        If the law is in discrete time, or not finite near the samples of a trial.
    """
    errors, trials = law.uncertainty.error_model, matched(law, trials)
    solution = replace(law, uncertainty=replace(law.uncertainty, error_model=NO_ERRORS))
    return_std = return_std and not errors.of_law
    fit = solution.predict(trials, start="all", return_std=return_std, averaged=False)
    if law.noise is None or law.schema.logarithmic or (errors.proportional is None and errors.correlated is None):
        return fit
    # Errors that grow with the states are known once these are
    deviations = [
        errors.measurement_std(np.nan_to_num(curve.states[:, : len(law.states)]), trial.std(law.noise))
        for trial, curve in zip(trials, fit.trajectories, strict=True)
    ]
    weighted = tuple(replace(trial, noise=each) for trial, each in zip(trials, deviations, strict=True))
    names = {name: f"standard deviation of {name}" for name in law.states} | dict(trials.schema.noise_columns)
    trials = replace(trials, trials=weighted, schema=replace(trials.schema, noise_columns=names))
    return solution.predict(trials, start="all", return_std=return_std, averaged=False)
