"""From a law and trials to what the measurements are off its trajectories."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import noise_level
from commonlaw.discrepancy.residual_tests import Residuals, patterns
from commonlaw.errors import CommonlawError
from commonlaw.forecast import fitted
from commonlaw.forecast.schemes import scheme_of
from commonlaw.law import Law
from commonlaw.law.alignment import TRIALS, matched
from commonlaw.law.objects import with_estimates
from commonlaw.law.parameters import named_parameters, restrictions_of, units_with_rates
from commonlaw.runtime.arguments import check_type
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.trial import property_names


def residuals(law: Law, trials: Trials) -> Residuals:
    """Return what measurements are off the trajectories of a law, see `Law.residuals`."""
    refuse_discrete_time(law)
    result, starts = untested(law, trials, law.uncertainty.noise)
    names, parameters, spent = law.observation.measured.states, fitted_parameters(law), 0.0
    for name, count in starts.items():
        pairs = zip(result.trials, result.standardized, strict=True)
        counts = np.sum([np.isfinite(z).sum(axis=0) for trial, z in pairs if trial.object == name], axis=0)
        spent = spent + (count + parameters.get(name, 0.0)) * counts / max(counts.sum(), 1)
    tested = patterns(names, result.standardized, result.columns, law.schema.time, np.asarray(spent).tolist())
    return replace(result, patterns=tested)


def refuse_discrete_time(law: Law) -> None:
    """Refuse a law that has no trajectories."""
    if law.order == 0:
        raise CommonlawError("discrete-without-trajectories")


def untested(law: Law, trials: Trials, noise: Floats | None) -> tuple[Residuals, dict[str, int]]:
    """Return residuals without patterns, and how many initial values were fitted to the trials of each object."""
    check_type("trials", trials, (Trials, TrialStream), TRIALS)
    if not law.schema.doses:  # Which may be given where nothing was measured
        trials = trials.with_trials([trial.measured() for trial in trials])
    trials = matched(law, trials)
    noise = noise_of([noise_squares(trials)]) if noise is None else noise
    law = replace(law, uncertainty=replace(law.uncertainty, noise=noise))
    forecast, states = fitted(law, trials), law.observation.measured.states
    followed = forecast.followed or forecast
    curves = [trajectory.states[:, : len(states)] for trajectory in followed.trajectories]
    errors = law.uncertainty.error_model
    standardized = tuple(
        (trial.states - curve)
        / errors.measurement_std(curve, trial.std(errors.noise_of_trial(trial, noise)), trial.elapsed)
        for trial, curve in zip(followed.trials, curves, strict=True)
    )
    names, units = law.terms.variables.states, units_with_rates(law)
    latent = [j for j, name in enumerate(names) if name not in states]
    solved = tuple(np.column_stack([curve, x[:, latent]]) for curve, x in zip(curves, forecast.solutions, strict=True))
    others = {names[j]: units.get(names[j], "") for j in latent}
    starts = dict.fromkeys(trials.objects, 0)
    scheme = scheme_of(law, property_names(trials.properties))
    for trial in trials:
        starts[trial.object] += scheme.free_starts(trial)
    return Residuals(followed.trials, solved, standardized, others, ()), starts


def fitted_parameters(law: Law) -> dict[str, float]:
    """Return how many parameters were fitted to each object's trials.

    Those that several objects share count for each by their part, and partially pooled ones by the trace of their
    covariance times the information of the object's own trials.
    """
    named, unpooled = named_parameters(law), law.uncertainty.unpooled
    shares = np.ones(named.values.shape)
    if law.uncertainty.covariance is not None and unpooled is not None:
        apart = named_parameters(with_estimates(law, unpooled)).covariance
        scales = np.sqrt(np.diagonal(apart, axis1=1, axis2=2))[:, :, np.newaxis]
        scales = np.where(scales > 0, scales, np.inf)
        alike = scales * scales.transpose(0, 2, 1)
        information = np.linalg.pinv(apart / alike, hermitian=True)
        shares = np.clip(np.einsum("nij,nji->ni", named.covariance / alike, information), 0.0, 1.0)
    is_shared = np.isin(named.names, [*restrictions_of(law).shared])
    sharing = np.array([np.sum(named.values == values, axis=0) for values in named.values])
    is_free = ~(named.errors == 0) | named.limited
    counts = np.where(is_free, np.where(is_shared, 1 / sharing, shares), 0.0).sum(axis=1)
    return dict(zip(law.objects, counts.tolist(), strict=True))


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
