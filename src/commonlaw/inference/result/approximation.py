"""Whether the solutions of a law fit whole trials, or only its process noise fits them.

Process noise lets a law fit any measurements. Its likelihood is that of one-step predictions, by which an empty law
with a smooth force is the best description of any smooth curve that no law in the library fits within a small noise.
A law should explain whole trials, though. So a law with process noise (C) is compared with deterministic laws of the
same library (R) by the residuals of solutions over whole trials, with initial conditions fitted to them:

    2 log B = sum over trials of n_eff log(s_C^2 / s_R^2) - p log n,

with s^2 the residual mean squares, p the number of coefficients of R, n the number of measurements, and n_eff the
effective number of independent residuals.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.diagnostics import Outcome, note
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import fit_solutions
from commonlaw.inference.fit.covariance import fitted_law
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.result.held_out_forecasts import best_of_each_size, score_of_forecasts, scored_by_forecasts
from commonlaw.inference.result.history import LACKS_OF_FIT
from commonlaw.inference.search.law_search import resolved
from commonlaw.inference.search.pool import Pool
from commonlaw.law import Law, Uncertainty
from commonlaw.runtime.progress import ProgressCallback, unannounced
from commonlaw.trials import Trials

Series = list[Floats]
"""Residuals of one state in each trial, of shape (n,) each."""


def choose_deterministic(pool: Pool, progress: ProgressCallback, pooled: Callable[[Law], Law] | None = None) -> Pool:
    """Return a pool whose best is a deterministic law, if one fits whole trials better than a law with process noise.

    The evidence for it, with the BIC penalty for its coefficients, must be strong both against the law with process
    noise and against a constant in each trial. Among several, the one of largest evidence is taken, unless its
    forecasts of held-out data diverge: then the best forecaster among all of them and laws of fewer terms. `pooled`
    pools the coefficients of the objects for forecasts; None if the terms are given.
    """
    rivals = [fit for fit in _without_process_noise(pool) if fit.size]
    if not pool.best.has_process_noise or not rivals:
        return pool
    progress("comparing residuals of whole trials")
    references = _residuals_of_trials(pool.best), _constants(pool.best.problem.trials)

    def explaining(listed: Iterable[Fit]) -> list[Fit]:
        pairs = [(_log_bayes_factor(fit, references), fit) for fit in listed]
        return [fit for value, fit in sorted(pairs, key=lambda pair: -pair[0]) if value > settings.STRONG]

    listed = explaining(rivals)
    if not listed:
        return pool
    best = listed[0]
    if pooled is not None and np.isneginf(score_of_forecasts(best, pooled)):
        chosen = [rival for rival in rivals if rival.problem.solver is not None]  # Among plain terms: try fewer of them
        pairs = [
            (fit, supports)
            for fit in chosen
            for supports in best_of_each_size(Pool((fit,), fit.alternatives), fit.size - 1)
        ]
        fewer = [fit_solutions(fit.problem, supports) for fit, supports in pairs]
        smaller = explaining(fit for fit in fewer if fit.is_usable)
        scores = [(score_of_forecasts(fit, pooled), fit) for fit in (*listed[1:], *smaller)]
        most, first = max(scores, key=lambda pair: pair[0], default=(-np.inf, best))
        best = best if np.isneginf(most) else scored_by_forecasts(first, 0.0)
    return replace(resolved(Pool((best,), pool.explored), progress), is_approximation=True)


def fits_whole_trials(fit: Fit) -> bool:
    """Return whether residuals over whole trials have at most twice the standard deviation of measurement errors."""
    if fit.has_process_noise:
        return False
    problem, correlated = fit.problem, fit.problem.errors.correlated
    variances = np.mean(problem.white_std**2, axis=0) + (0.0 if correlated is None else correlated**2)
    pairs = zip(_residuals_of_trials(fit), variances[~problem.trials.schema.is_latent], strict=True)
    return all(_mean_square(series) <= 4 * variance for series, variance in pairs)


def index_of_best_fit_to_whole_trials(ranked: Sequence[Pool]) -> int:
    """Return the index of the pool whose law fits whole trials best, among several orders.

    It is the first, of largest evidence, unless the evidence for a deterministic law of another one is strong, as in
    `choose_deterministic`.
    """
    first = ranked[0].best
    references = _residuals_of_trials(first), _constants(first.problem.trials)
    evidences = [
        max(
            (_log_bayes_factor(rival, references) for rival in _without_process_noise(pool) if rival.size),
            default=-np.inf,
        )
        for pool in ranked
    ]
    best = int(np.argmax(evidences))
    return best if evidences[best] > max(evidences[0], 0.0) + settings.STRONG else 0


def _log_bayes_factor(rival: Fit, others: Iterable[Sequence[Series]]) -> float:
    """Return the least 2 log B of a law over other residuals, with the BIC penalty for its coefficients."""
    residuals, count = _residuals_of_trials(rival), sum(rival.problem.measured)
    penalty = rival.size * len(rival.problem.models) * float(np.log(count))
    return min(log_likelihood_gain(residuals, series) for series in others) - penalty


def _without_process_noise(pool: Pool) -> list[Fit]:
    return [*pool.approximations, *(fit for fit in pool.fits if not fit.has_process_noise)]


def with_approximation(pool: Pool, outcomes: Sequence[Outcome]) -> tuple[Outcome, ...]:
    """Return the outcomes of a law; if `choose_deterministic` replaced the best, with the size of its lack of fit."""
    if not pool.is_approximation:
        return tuple(outcomes)
    problem = pool.best.problem
    schema, noise = problem.trials.schema, problem.noise_estimate
    residuals = [np.sqrt(np.mean(np.concatenate(series) ** 2)) for series in _residuals_of_trials(pool.best)]
    parts = [
        f"{value:.3g} {schema.units.get(name, '')}".rstrip() + f" in {name} (noise {level:.2g})"
        for name, value, level in zip(schema.measured, residuals, noise[~schema.is_latent], strict=True)
    ]
    of = "this law" if problem.solver is None else "this law, the best of its library,"
    lack = note("lack-of-fit", law=of, residuals=parts)
    return (lack, *(outcome for outcome in outcomes if outcome.kind not in LACKS_OF_FIT))


def _residuals_of_trials(fit: Fit) -> list[Series]:
    """Return the residuals of solutions over whole trials, state by state; infinite if no solution can be fitted."""
    trials = fit.problem.trials
    spread = np.nanstd(np.concatenate([trial.states for trial in trials]), axis=0)
    noise = np.where(spread > 0, spread, 1.0)  # Equal weights for the samples of a state, and none is an outlier
    try:
        law = fitted_law(fit.problem.law, fit)
        law = replace(law, uncertainty=Uncertainty(covariance=law.uncertainty.covariance, noise=noise))
        with unannounced():
            forecast = law.predict(trials, start="all", averaged=False)
    except (CommonlawError, ArithmeticError, np.linalg.LinAlgError):
        return _deviations(trials, [np.full_like(trial.states, -np.inf) for trial in trials])
    return _deviations(forecast.trials, [trajectory.states for trajectory in forecast.trajectories])


def _constants(trials: Trials) -> list[Series]:
    """Return the deviations from the mean of each trial, state by state."""
    columns = ([column[np.isfinite(column)] for column in trial.states.T] for trial in trials)
    return _deviations(trials, [np.array([[column.sum() / max(len(column), 1) for column in row]]) for row in columns])


def _deviations(trials: Trials, references: Iterable[Floats]) -> list[Series]:
    """Return the deviations of measurements from reference values, state by state, where there are any.

    States are those measured, as laws may differ in their latent states.
    """
    pairs, states = list(zip(trials, references, strict=True)), np.flatnonzero(~trials.schema.is_latent)
    deviations = ([trial.states[:, j] - values[:, j] for trial, values in pairs] for j in states)
    return [[series[~np.isnan(series)] for series in of_state] for of_state in deviations]


def log_likelihood_gain(of: Sequence[Series], over: Sequence[Series]) -> float:
    """Return twice the log-likelihood ratio of one set of residuals over another, sum of n_eff log(s_2^2/s_1^2).

    Residuals of a lack of fit are autocorrelated: see `effective_count`.
    """
    return sum(
        sum(map(effective_count, one)) * float(np.log(_mean_square(two) / _mean_square(one)))
        for one, two in zip(of, over, strict=True)
    )


def _mean_square(series: Series) -> float:
    return max(float(np.mean(np.concatenate(series) ** 2)), np.finfo(float).tiny)


def effective_count(residuals: Floats) -> float:
    """Return the effective sample size of a series, shape (n,), for its mean square.

    It is n/(1 + 2 sum of rho_k^2) with autocorrelations rho_k up to the first that is not positive (Bayley and
    Hammersley 1946, for a variance; Geyer 1992, for the truncation).
    """
    count, power = len(residuals), float(residuals @ residuals)
    if not power > 0:
        return float(count)
    correlations = np.correlate(residuals, residuals, "full")[count:] / power
    ends = np.flatnonzero(correlations <= 0)
    kept = correlations[: ends[0]] if len(ends) else correlations
    return float(count / (1 + 2 * np.sum(kept**2)))
