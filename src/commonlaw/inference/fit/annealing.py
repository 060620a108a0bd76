"""Selection of supports by continuation in the model-error variance, from smoothed trajectories to solutions.

States follow the law but for a random walk of standard deviation q in each step (weak constraint; Evensen 2009, Data
Assimilation, chapter 7). For q from large to small, the likelihood is linearized about the present trajectories and
coefficients, the supports of largest evidence are selected, and both are fitted again. Supports and model errors are
compared by their evidence: for q = 0, trajectories are solutions of the law; a larger q indicates lack of fit.
"""

from collections.abc import Sequence

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.inference import settings
from commonlaw.inference.fit.fit import (
    NO_MODEL_ERROR,
    PLAUSIBLE,
    Fit,
    Status,
    best_fit,
    fitted,
    linearized_evidence,
    restricted,
)
from commonlaw.inference.fit.initial_condition_prior import InitialConditionPrior
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.score.supports import SupportEvidence
from commonlaw.likelihood import Estimate, NotPositiveError, threads_are_worthwhile
from commonlaw.runtime.parallel import in_parallel
from commonlaw.runtime.progress import ProgressCallback, Stage
from commonlaw.text import counted

FROM_RESIDUALS = "from the residuals of the law"
"""Estimator of the noise, as the history describes it."""


def search(problem: SearchProblem, progress: ProgressCallback, proposals: Sequence[Bools] = ()) -> list[Fit]:
    """Return the fits of all schedules, of proposed supports, and of plausible neighbours, the best first.

    Raises `CommonlawError` if no fit succeeds.
    """
    fits = anneal(problem, progress)
    distinct = {proposal.tobytes(): proposal for proposal in proposals}.values()
    fits += [fit_supports(problem, support, settings.SCHEDULES[-1]) for support in distinct]
    best = best_fit(fits)
    if best.has_model_error:  # Its supports may not have been fitted without one
        fits.append(fitted(problem, best.estimates, best.supports, NO_MODEL_ERROR))
    return with_neighbours(fits)


def anneal(
    problem: SearchProblem, progress: ProgressCallback, schedules: Sequence[Sequence[float]] = settings.SCHEDULES
) -> list[Fit]:
    """Return the fits at all model errors of all schedules, each of which selects supports by continuation."""

    def show(done: int) -> None:
        of = counted(len(schedules), "search", "es")
        progress(Stage(f"choosing terms, {done} of {of} done", done / (len(schedules) + 1)))

    show(0)
    pays = threads_are_worthwhile(problem.models)
    by_schedule = in_parallel(lambda schedule: _continuation(problem, None, schedule), schedules, pays=pays, done=show)
    return [fit for fits in by_schedule for fit in fits]


def refine_support(
    problem: SearchProblem, supports: Bools, estimates: Sequence[Estimate] | None, model_error: float
) -> Fit:
    """Return the best fit of alternating selection of supports and fits at one model error."""
    best = fit = fitted(problem, estimates, supports, model_error)
    for _ in range(1, settings.MAX_SWEEPS):
        if not fit.is_usable:
            break
        chosen = _selected(problem, fit.evidence, fit.supports)
        if np.array_equal(chosen, fit.supports):
            break
        fit = fit.refitted(chosen)
        if not fit < best:
            break
        best = fit
    return best


def fit_supports(problem: SearchProblem, supports: Bools, model_errors: Sequence[float] = settings.MODEL_ERRORS) -> Fit:
    """Return the fit of supports, shape (equations, terms), at the model error of largest evidence.

    Model errors are relative to the noise, from large to small. The smallest one is also fitted from the smoothed
    measurements, as larger ones do not identify coefficients of collinear terms; with latent states it is fitted only
    so, as larger ones lead between equivalent optima.
    """
    *larger, smallest = model_errors
    first = tuple(larger) if problem.trials.schema.initial_values else (*larger, smallest)
    return min(_fit_schedules(problem, supports, first, smallest))


def fit_with(
    problem: SearchProblem, supports: Bools, model_error: float, start: Sequence[Estimate] | None = None
) -> Fit:
    """Return the fit of supports at one model error from given initial estimates.

    Without any, it is the better one of a fit by continuation from larger model errors and one from the smoothed
    measurements.
    """
    if start is None and problem.trials.schema.initial_values:
        start = problem.starts
    if start is not None:
        return fitted(problem, start, supports, model_error)
    larger = [error for error in settings.MODEL_ERRORS if error > model_error]
    return _fit_schedules(problem, supports, (*larger, model_error), model_error)[-1]


def _fit_schedules(problem: SearchProblem, supports: Bools, schedule: tuple[float, ...], smallest: float) -> list[Fit]:
    """Return the fits at the model errors of a schedule, last that at the smallest one, also fitted by itself.

    Of both that of largest likelihood is taken; it is a failed fit if there is none.
    """
    schedules = dict.fromkeys((schedule, (smallest,)))
    fits = [fit for errors in schedules for fit in _continuation(problem, supports, errors)]
    last = min(
        (fit for fit in fits if fit.model_error == smallest),
        key=lambda fit: sum(estimate.objective for estimate in fit.estimates),
        default=Fit.failed(problem, supports, Status.NOT_COMPUTABLE, smallest),
    )
    return [*(fit for fit in fits if fit.model_error != smallest), last]


def fit_solutions(problem: SearchProblem, supports: Bools) -> Fit:
    """Return the fit of supports without a model error, see `fit_with`, under its residual noise."""
    return rescale_noise(fit_with(problem, supports, NO_MODEL_ERROR))


def rescale_noise(fit: Fit) -> Fit:
    """Return a fit under white noise of its residual variance, by fixed-point iteration.

    Given noise is kept, and so are errors other than white noise, of which the levels are estimated. The variance is at
    least that of the noise floor.
    """
    problem = fit.problem
    if not fit.is_usable or problem.noise_is_fixed or problem.errors or fit.has_model_error:
        return fit
    for _ in range(settings.MAX_ITERATIONS):
        variance = max(fit.evidence.noise_variance(fit.supports), problem.least_variance)
        factor = float(np.sqrt(variance))
        if 1 / (1 + settings.CONVERGED_NOISE) <= factor <= (1 + settings.CONVERGED_NOISE) or not 0 < factor < np.inf:
            break
        problem, before = problem.with_scaled_noise(factor, FROM_RESIDUALS), fit
        fit = fitted(problem, fit.estimates, fit.supports, fit.model_error)
        if not fit.is_usable:
            break
        fit = fit.with_alternatives_of(before)
        if not fit.has_converged:  # The residual variance of a maximum that was not reached is none
            break
    return fit


def with_neighbours(fits: Sequence[Fit], prior: InitialConditionPrior | None = None) -> list[Fit]:
    """Return fits of one problem with those of plausible neighbours, the best first, with the others as alternatives.

    Best-first search: neighbours of all plausible fits are ranked by their evidence, linearized about these, and the
    best one is fitted, until none is within `PLAUSIBLE` of the best fit or `MAX_MODELS` in a row were no better. With a
    prior of initial conditions, scores include it.
    """
    best, ranked = best_fit(fits), sorted(fit for fit in fits if fit.is_usable)
    done = {fit.supports.tobytes() for fit in ranked if fit.model_error == best.model_error}
    seen, candidates, failures = set[bytes](), dict[bytes, tuple[float, Fit, Bools]](), 0
    while failures < settings.MAX_MODELS:
        most = best.score.total + PLAUSIBLE
        for near in (fit for fit in ranked if fit.model_error == best.model_error and fit.score.total < most):
            if (key := near.supports.tobytes()) not in seen:
                seen.add(key)
                more = prior.near(near) if prior else lambda _: 0.0
                for predicted, supports in near.predicted_neighbours():
                    value, proposed = predicted + more(supports), supports.tobytes()
                    if proposed not in candidates or value < candidates[proposed][0]:
                        candidates[proposed] = (value, near, supports)
        untried = [entry for key, entry in candidates.items() if key not in done and entry[0] < most]
        if not untried:
            break
        _, near, supports = min(untried, key=lambda entry: entry[0])
        done.add(supports.tobytes())
        fit = _refitted(near.problem, near, supports, best.model_error, prior)
        ranked = sorted([*ranked, fit]) if fit.is_usable else ranked
        failures = failures + 1 if ranked[0] is best else 0
        best = ranked[0]
    return [best.with_alternatives([fit for fit in ranked if fit.model_error == best.model_error]), *ranked[1:]]


def _refitted(
    problem: SearchProblem, near: Fit, supports: Bools, model_error: float, prior: InitialConditionPrior | None
) -> Fit:
    """Return supports fitted from a near fit, with the smaller evidence of those under present and residual noise.

    Otherwise supports with residuals far above the noise would have them all as outliers, whose penalty is too small.
    """
    if np.array_equal(supports, near.supports):
        fit = fitted(problem, near.estimates, supports, model_error)
    else:
        fit = near.refitted(supports, model_error)
    scaled = rescale_noise(fit)
    if not scaled.is_usable:
        return scaled
    if not fit.has_converged:
        return fit.but(Status.NOT_CONVERGED)
    score = scaled.score if fit.score < scaled.score else fit.score
    return fit.with_score(score.plus("scatter of starts", prior.correction(fit)) if prior else score)


def compare_alternatives(fit: Fit) -> Fit:
    """Return the best of a fit and its plausible alternatives and neighbours, all fitted to the same problem."""
    refitted, prior = fit.with_score(fit.evidence.score(fit.supports)), InitialConditionPrior(fit)
    plausible = [alternative for alternative in fit.alternatives if alternative.score - fit.score < PLAUSIBLE]
    fits = [
        _refitted(fit.problem, alternative, alternative.supports, fit.model_error, prior) for alternative in plausible
    ]
    best = with_neighbours([refitted, *fits], prior)[0]
    return fit.with_alternatives_of(best) if np.array_equal(best.supports, fit.supports) else best


def refit_leading(fit: Fit) -> Fit:
    """Return the best of a fit and at most `MAX_MODELS` neighbours of larger linearized evidence, fitted in turn."""
    prior, done = InitialConditionPrior(fit), {known.supports.tobytes() for known in (fit, *fit.alternatives)}
    for _ in range(settings.MAX_MODELS):
        ahead = [
            (predicted, supports)
            for predicted, supports in fit.predicted_neighbours()
            if predicted < fit.score.total and supports.tobytes() not in done
        ]
        if not ahead:
            break
        _, supports = min(ahead, key=lambda pair: pair[0])
        done.add(supports.tobytes())
        candidate = _refitted(fit.problem, fit, supports, fit.model_error, prior)
        if candidate.is_usable:
            best, rest = sorted([fit, candidate])
            fit = best.with_alternatives([*fit.alternatives, rest])
    return fit


def _continuation(problem: SearchProblem, given: Bools | None, model_errors: Sequence[float]) -> list[Fit]:
    """Return fits of given or selected supports at decreasing model errors, until one fails (continuation)."""
    supports: Bools = problem.allowed
    estimates: Sequence[Estimate] = problem.starts
    fits: list[Fit] = []
    for model_error in model_errors:
        try:
            evidence = linearized_evidence(problem, estimates, problem.errors_to_fit(model_error)[0])
        except NotPositiveError:
            break
        chosen = _selected(problem, evidence, supports) if given is None else given
        initial: Sequence[Estimate] | None = estimates
        if given is not None or not np.array_equal(chosen, supports):
            supports, initial = chosen, restricted(problem, evidence, estimates, chosen)
        if given is None and not model_error:
            fit = refine_support(problem, supports, initial, model_error)
        else:
            fit = fitted(problem, initial, supports, model_error)
        if not fit.is_usable:
            break
        fits.append(fit)
        estimates = fit.estimates
    return fits


def _selected(problem: SearchProblem, evidence: SupportEvidence, supports: Bools) -> Bools:
    """Return the supports of largest evidence on the path of the solver."""
    assert problem.solver is not None
    return evidence.choose(supports, problem.solver)
