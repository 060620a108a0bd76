"""From a law and trials to what the measurements are off its trajectories."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import noise_level
from commonlaw.discrepancy.residual_tests import Residuals, patterns
from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.law.alignment import TRIALS, matched
from commonlaw.law.law import object_index
from commonlaw.law.parameters import rate_names, units_with_rates
from commonlaw.likelihood import WHITE_NOISE
from commonlaw.runtime.arguments import check_type
from commonlaw.trials import Trials, TrialStream


def residuals(law: Law, trials: Trials) -> Residuals:
    """Return what measurements are off the trajectories of a law, see `Law.residuals`."""
    refuse_discrete_time(law)
    result, spent = untested(law, trials, law.uncertainty.noise)
    names, totals = law.observation.measured.states, spent.sum(axis=0).tolist()
    tested = patterns(names, result.standardized, result.columns, law.schema.time, totals)
    return replace(result, patterns=tested)


def refuse_discrete_time(law: Law) -> None:
    """Refuse a law that has no trajectories."""
    if law.order == 0:
        raise CommonlawError("discrete-without-trajectories")


def untested(law: Law, trials: Trials, noise: Floats | None) -> tuple[Residuals, Floats]:
    """Return residuals without patterns, and the numbers that were fitted, (objects, states)."""
    check_type("trials", trials, (Trials, TrialStream), TRIALS)
    if not law.schema.doses:  # Which may be given where nothing was measured
        trials = trials.with_trials([trial.measured() for trial in trials])
    trials = matched(law, trials, observed=True)
    noise = noise_of([noise_squares(trials)]) if noise is None else noise
    if law.scheme == "shooting":
        return _of_observation(law, trials, noise)
    known = replace(law.uncertainty, noise=noise, error_model=WHITE_NOISE)
    forecast = replace(law, uncertainty=known).predict(trials, start="all", averaged=False)
    forecast = forecast.followed or forecast
    fitted = tuple(trajectory.states for trajectory in forecast.trajectories)
    states, errors = len(law.schema.states), law.uncertainty.error_model
    standardized = []
    for trial, curve in zip(forecast.trials, fitted, strict=True):
        std = errors.measurement_std(curve[:, :states], trial.std(noise))
        standardized.append((trial.states - curve[:, :states]) / std)
    units = units_with_rates(law)
    rates = {name: units.get(name, "") for name in rate_names(law)}
    result = Residuals(forecast.trials, fitted, tuple(standardized), rates, ())
    counts = np.array([[len(trials.of_object(name))] for name in trials.objects])
    return result, counts * np.array(law.order) + _spent(law, trials)


def _of_observation(law: Law, trials: Trials, noise: Floats) -> tuple[Residuals, Floats]:
    """Return the same for a law with observation equations, whose other states stand behind the measured quantities.

    Initial values and parameters count alike for all.
    """
    forecast, measured = law.predict(trials, start="all"), law.observation.measured
    forecast = forecast.followed or forecast
    shown, curves = forecast.trials, [trajectory.states for trajectory in forecast.trajectories]
    errors = law.uncertainty.error_model
    standardized = tuple(
        (trial.states - curve) / errors.measurement_std(curve, trial.std(noise))
        for trial, curve in zip(shown, curves, strict=True)
    )
    names, units = law.terms.variables.states, units_with_rates(law)
    latent = [j for j, name in enumerate(names) if name not in measured.states]
    fitted = tuple(np.column_stack([a, b[:, latent]]) for a, b in zip(curves, forecast.latent, strict=True))
    counts = np.array(
        [np.sum([trial.counts.sum(axis=0) for trial in trials.of_object(name)], axis=0) for name in trials.objects]
    )
    starts = [sum(estimate.object == name for estimate in law.trial_estimates) for name in trials.objects]
    parameters = int(law.support.sum()) + np.array(starts)
    spent = parameters[:, np.newaxis] * counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    return Residuals(shown, fitted, standardized, {names[j]: units.get(names[j], "") for j in latent}, ()), spent


def _spent(law: Law, trials: Trials) -> Floats:
    """Return how many coefficients of each equation were fitted to each object's trials, shape (objects, states).

    Pooled coefficients count by the trace of their covariance times the information of the object's own trials.
    """
    known, unpooled = law.uncertainty.covariance, law.uncertainty.unpooled
    shares = np.ones((len(law.objects), int(law.support.sum())))
    if known is not None:
        covariance = known if unpooled is None else unpooled.covariance
        scales = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))[:, :, np.newaxis]
        scales = np.where(scales > 0, scales, np.inf)
        alike = scales * scales.transpose(0, 2, 1)
        information = np.linalg.pinv(covariance / alike, hermitian=True)
        shares = np.clip(np.einsum("nij,nji->ni", known / alike, information), 0.0, 1.0)
    spent = np.zeros((len(trials.objects), *law.support.shape))
    for whole, name in zip(spent, trials.objects, strict=True):
        if name in law.objects:
            whole[law.support] = shares[object_index(law, name)]
    return np.asarray(spent.sum(axis=2))


def noise_squares(trials: Trials) -> tuple[int, Floats]:
    """Return how many trials are complete, and the sum of their squared noise, from differences of neighbours."""
    squares = [noise_level(trial.times, trial.states) ** 2 for trial in trials if trial.complete]
    return len(squares), np.sum(squares, axis=0)


def noise_of(parts: Sequence[tuple[int, Floats]]) -> Floats:
    """Return the noise of each state, shape (states,), from what `noise_squares` says of parts."""
    count = sum(measured for measured, _ in parts)
    if not count:
        raise CommonlawError("noise-unknown-and-incomplete")
    return np.asarray(np.sqrt(sum(squares for measured, squares in parts if measured) / count))
