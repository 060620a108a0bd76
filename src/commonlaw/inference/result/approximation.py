"""Whether solutions of a law explain the measurements, or only the process noise of the law does.

A law with process noise may follow any measurements: the noise makes up from sample to sample for what the law lacks.
Its likelihood compares predictions of the next sample, by which the empty law with a smooth force is the best
description of a smooth curve that no law of the library follows within a small noise. A law is to explain whole
trials, though. So a law with process noise is weighed against laws of the same library without it by what their
solutions leave of whole trials, from initial conditions that are fitted to these:

    2 log B = sum over trials of n_eff log(s_C^2 / s_R^2) - p log n,

with s^2 the mean square that the law with process noise (C) and its rival without (R) leave, p coefficients of the
rival, n measurements, and n_eff independent ones that autocorrelated residuals are worth.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import fit_solutions
from commonlaw.inference.fit.covariance import fitted_law
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.result.held_out_forecasts import of_each_size, score_of_forecasts, weighed_by_forecasts
from commonlaw.inference.result.history import LACKS_OF_FIT
from commonlaw.inference.search.law_search import resolved
from commonlaw.inference.search.pool import Pool
from commonlaw.law import Law, Uncertainty
from commonlaw.outcomes import Outcome, note
from commonlaw.runtime.progress import ProgressCallback, unannounced
from commonlaw.trials import Trials

Series = list[Floats]
"""Residuals of one state, trial by trial, each of shape (n,)."""


def approximated(pool: Pool, progress: ProgressCallback, pooled: Callable[[Law], Law] | None = None) -> Pool:
    """Return a pool whose best is the law without process noise that explains whole trials better, if any does.

    The evidence for it must be strong, at the price of its coefficients (BIC), which were fitted to whole trials, and
    it must explain more than a constant for each trial does. Of several the one of largest evidence is taken, but if
    its forecasts of what was left out diverge: then the best forecaster of all, laws of fewer terms among them.
    `pooled` says how coefficients of objects learn from each other in forecasts; none where the terms are given.
    """
    rivals = [each for each in _without_process_noise(pool) if each.size]
    if not pool.best.has_process_noise or not rivals:
        return pool
    progress("comparing residuals of whole trials")
    least = _left_by(pool.best), _constants(pool.best.problem.trials)

    def explaining(listed: Iterable[Fit]) -> list[Fit]:
        pairs = [(_evidence_over(each, least), each) for each in listed]
        return [each for value, each in sorted(pairs, key=lambda pair: -pair[0]) if value > settings.STRONG]

    listed = explaining(rivals)
    if not listed:
        return pool
    best = listed[0]
    if pooled is not None and np.isneginf(score_of_forecasts(best, pooled)):
        chosen = [each for each in rivals if each.problem.solver is not None]  # From plain terms: fewer of these
        pairs = [
            (each, own) for each in chosen for own in of_each_size(Pool((each,), each.alternatives), each.size - 1)
        ]
        fewer = [fit_solutions(each.problem, own) for each, own in pairs]
        smaller = explaining(each for each in fewer if each.is_usable)
        scores = [(score_of_forecasts(each, pooled), each) for each in (*listed[1:], *smaller)]
        most, first = max(scores, key=lambda pair: pair[0], default=(-np.inf, best))
        best = best if np.isneginf(most) else weighed_by_forecasts(first, 0.0)
    return replace(resolved(Pool((best,), pool.explored), progress), is_approximation=True)


def explains_whole_trials(fit: Fit) -> bool:
    """Return whether solutions of a law leave at most twice its errors of measurement of whole trials."""
    if fit.has_process_noise:
        return False
    problem, correlated = fit.problem, fit.problem.errors.correlated
    variances = np.mean(problem.white_std**2, axis=0) + (0.0 if correlated is None else correlated**2)
    pairs = zip(_left_by(fit), variances[_measured(problem.trials)], strict=True)
    return all(_mean_square(series) <= 4 * variance for series, variance in pairs)


def most_explaining(ranked: Sequence[Pool]) -> int:
    """Return the index of the law that explains whole trials best, of those of several orders.

    It is the first, of the largest evidence, unless the evidence of another without process noise is strong, as in
    `approximated`.
    """
    first = ranked[0].best
    least = _left_by(first), _constants(first.problem.trials)
    evidences = [
        max((_evidence_over(rival, least) for rival in _without_process_noise(each) if rival.size), default=-np.inf)
        for each in ranked
    ]
    best = int(np.argmax(evidences))
    return best if evidences[best] > max(evidences[0], 0.0) + settings.STRONG else 0


def _evidence_over(rival: Fit, others: Iterable[Sequence[Series]]) -> float:
    """Return 2 log B of a law over all that leaves others, at the price of its coefficients."""
    left, count = _left_by(rival), sum(rival.problem.measured)
    price = rival.size * len(rival.problem.models) * float(np.log(count))
    return min(gain(left, other) for other in others) - price


def _without_process_noise(pool: Pool) -> list[Fit]:
    return [*pool.approximations, *(fit for fit in pool.fits if not fit.has_process_noise)]


def with_approximation(pool: Pool, outcomes: Sequence[Outcome]) -> tuple[Outcome, ...]:
    """Return outcomes of a law that was found; those of one by `approximated` say how large its lack of fit is."""
    if not pool.is_approximation:
        return tuple(outcomes)
    problem = pool.best.problem
    schema, noise = problem.trials.schema, problem.noise_estimate
    left = [np.sqrt(np.mean(np.concatenate(each) ** 2)) for each in _left_by(pool.best)]
    parts = [
        f"{value:.3g} {schema.units.get(name, '')}".rstrip() + f" in {name} (noise {level:.2g})"
        for name, value, level in zip(schema.measured, left, noise[~schema.unmeasured], strict=True)
    ]
    of = "this law" if problem.solver is None else "this law, the best of its library,"
    lack = note("lack-of-fit", law=of, residuals=parts)
    return (lack, *(each for each in outcomes if each.kind not in LACKS_OF_FIT))


def _left_by(fit: Fit) -> list[Series]:
    """Return what solutions of a law leave of whole trials, state by state; infinite if none can be fitted."""
    trials = fit.problem.trials
    try:
        return _residuals(fitted_law(fit.problem.law, fit), trials)
    except (CommonlawError, ArithmeticError, np.linalg.LinAlgError):
        return _constants(trials, np.inf)


@unannounced()
def _residuals(law: Law, trials: Trials) -> list[Series]:
    measured = np.concatenate([each.states for each in trials])
    spread = np.nanstd(measured, axis=0)
    noise = np.where(spread > 0, spread, 1.0)  # So that samples of a state count alike, and none as an outlier
    own = replace(law, uncertainty=Uncertainty(covariance=law.uncertainty.covariance, noise=noise))
    forecast = own.predict(trials, start="all", averaged=False)
    pairs = list(zip(forecast.trials, (each.states for each in forecast.trajectories), strict=True))
    return [
        [_seen(trial.states[:, j] - states[:, j]) for trial, states in pairs] for j in np.flatnonzero(_measured(trials))
    ]


def _constants(trials: Trials, left: float = 0.0) -> list[Series]:
    """Return what the mean of each trial leaves, state by state, and so much more."""
    return [
        [_seen(each.states[:, j] - np.nanmean(each.states[:, j]) + left) for each in trials]
        for j in np.flatnonzero(_measured(trials))
    ]


def _measured(trials: Trials) -> Bools:
    """Return which states were measured, as laws may differ in others, shape (states,)."""
    return ~trials.schema.unmeasured


def _seen(left: Floats) -> Floats:
    """Return the residuals of what was measured."""
    return left[~np.isnan(left)]


def gain(of: Sequence[Series], over: Sequence[Series]) -> float:
    """Return twice the log-likelihood ratio of residuals with a smaller variance over those with a larger one.

    Residuals of a lack of fit are autocorrelated, and count as so many independent ones as they are worth.
    """
    return sum(
        sum(map(effective_count, one)) * float(np.log(_mean_square(two) / _mean_square(one)))
        for one, two in zip(of, over, strict=True)
    )


def _mean_square(series: Series) -> float:
    return max(float(np.mean(np.concatenate(series) ** 2)), np.finfo(float).tiny)


def effective_count(residuals: Floats) -> float:
    """Return how many independent numbers have a mean square as accurate as that of a series, shape (n,).

    n/(1 + 2 sum of rho_k^2) with autocorrelations rho_k up to the first that is not positive (Bayley and Hammersley
    1946, for a variance; Geyer 1992 for where the sum ends).
    """
    count, power = len(residuals), float(residuals @ residuals)
    if not power > 0:
        return float(count)
    correlations = np.correlate(residuals, residuals, "full")[count:] / power
    ends = np.flatnonzero(correlations <= 0)
    kept = correlations[: ends[0]] if len(ends) else correlations
    return float(count / (1 + 2 * np.sum(kept**2)))
