"""The search for the supports of a law, from many terms to few, while the trajectories become solutions of it.

At each model error the likelihood is linearised about the trajectories and coefficients so far, the supports of largest
evidence are chosen on it, and both are fitted again. Supports and model errors are compared by their evidence: where
the measurements follow a law of the library, the smallest model error wins; where they do not, one wins that is not
negligible, a random walk that pushes the states off their course (weak constraint; Evensen 2009, chapter 7).
"""

from collections.abc import Sequence

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.inference import settings
from commonlaw.inference.fit.fit import (
    NO_ERROR,
    PLAUSIBLE,
    Fit,
    Status,
    best_of,
    errors_to_fit,
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
"""Why the noise is what it is."""


def search(problem: SearchProblem, progress: ProgressCallback, proposals: Sequence[Bools] = ()) -> list[Fit]:
    """Return what all schedules find, proposals, and what may be as plausible, that of largest evidence first.

    Raises `CommonlawError` if no fit succeeds.
    """
    fits = anneal(problem, progress)
    distinct = {proposal.tobytes(): proposal for proposal in proposals}.values()
    fits += [fit_supports(problem, support, settings.SCHEDULES[-1]) for support in distinct]
    best = best_of(fits)
    if best.has_model_error:  # No schedule may have come by its supports without one
        fits.append(fitted(problem, best.estimates, best.supports, NO_ERROR))
    return with_neighbours(fits)


def anneal(
    problem: SearchProblem, progress: ProgressCallback, schedules: Sequence[Sequence[float]] = settings.SCHEDULES
) -> list[Fit]:
    """Return the fits at all model errors of all schedules."""

    def show(done: int) -> None:
        of = counted(len(schedules), "search", "es")
        progress(Stage(f"choosing terms, {done} of {of} done", done / (len(schedules) + 1)))

    show(0)
    pays = threads_are_worthwhile(problem.models)
    ways = in_parallel(lambda schedule: _anneal(problem, None, schedule), schedules, pays=pays, done=show)
    return [fit for way in ways for fit in way]


def refine_support(
    problem: SearchProblem, supports: Bools, estimates: Sequence[Estimate] | None, model_error: float
) -> Fit:
    """Choose supports and fit them in turn at one model error until nothing gets better."""
    best = fit = fitted(problem, estimates, supports, model_error)
    for _ in range(1, settings.MAX_SWEEPS):
        if not fit.is_usable:
            break
        chosen = _chosen(problem, fit.evidence, fit.supports)
        if np.array_equal(chosen, fit.supports):
            break
        fit = fit.refitted(chosen)
        if not fit < best:
            break
        best = fit
    return best


def fit_supports(problem: SearchProblem, supports: Bools, model_errors: Sequence[float] = settings.MODEL_ERRORS) -> Fit:
    """Return the fit of supports, shape (equations, terms), at the model error of largest evidence.

    Model errors that are compared are relative to the noise, from large to small. Where terms are much alike, large
    ones leave coefficients undetermined, and lead away; so the smallest is also begun with, from the smoothed
    measurements. Where states were not measured, large ones lead from one set of coefficients to another that fits as
    well, and the smallest is begun with only from where the search begins.
    """
    *larger, smallest = model_errors
    ways = dict.fromkeys(((tuple(larger) if problem.trials.schema.starts else (*larger, smallest)), (smallest,)))
    fits = [fit for way in ways for fit in _anneal(problem, supports, way)]
    last = [fit for fit in fits if fit.model_error == smallest]
    compared = [*(fit for fit in fits if fit.model_error != smallest), *sorted(last, key=_objective)[:1]]
    return min(compared, default=Fit.failed(problem, supports, Status.NOT_COMPUTABLE, smallest))


def fit_with(
    problem: SearchProblem, supports: Bools, model_error: float, start: Sequence[Estimate] | None = None
) -> Fit:
    """Return the fit of supports at one model error, see `fit_supports`.

    It begins at estimates that are near. Without them larger model errors lead there from the smoothed measurements, or
    these are near enough, whichever fits better.
    """
    if start is None and problem.trials.schema.starts:
        start = problem.starts
    if start is not None:
        return fitted(problem, start, supports, model_error)
    larger = [error for error in settings.MODEL_ERRORS if error > model_error]
    ways = dict.fromkeys(((*larger, model_error), (model_error,)))
    fits = [fit for way in ways for fit in _anneal(problem, supports, way) if fit.model_error == model_error]
    return min(fits, key=_objective, default=Fit.failed(problem, supports, Status.NOT_COMPUTABLE, model_error))


def _objective(fit: Fit) -> float:
    """Return minus twice the log-likelihood at estimates, which compares those with the same supports and errors."""
    return sum(estimate.objective for estimate in fit.estimates)


def fit_solutions(problem: SearchProblem, supports: Bools) -> Fit:
    """Return the fit of supports without a model error, see `fit_with`, under the noise that this takes."""
    return rescale_noise(fit_with(problem, supports, NO_ERROR))


def rescale_noise(fit: Fit) -> Fit:
    """Return a fit under white noise of the size that it leaves.

    Step by step, as less of what is left goes with outliers then. Noise that was given stays, and none is below that
    which laws are fitted under at least. Levels of other errors were found at their size.
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
    return fit


def with_neighbours(fits: Sequence[Fit], starts: InitialConditionPrior | None = None) -> list[Fit]:
    """Return fits of one problem, and what may be as plausible as the best; this comes first, with the others.

    Starts that are alike count where they are given; the values of the fits have their prices.
    Evidence linearised about one law errs for others. So supports are fitted one after the other whose evidence, about
    any law that was fitted and is plausible, comes near to the best, the most promising first: until none is left, or
    so many as are carried along at most were fitted in vain.
    """
    best, ranked = best_of(fits), sorted(fit for fit in fits if fit.is_usable)
    done = {fit.supports.tobytes() for fit in ranked if fit.model_error == best.model_error}
    seen, promising, vain = set[bytes](), dict[bytes, tuple[float, Fit, Bools]](), 0
    while vain < settings.MAX_MODELS:
        most = best.score.total + PLAUSIBLE
        for near in (fit for fit in ranked if fit.model_error == best.model_error and fit.score.total < most):
            if (key := near.supports.tobytes()) not in seen:
                seen.add(key)
                more = starts.near(near) if starts else lambda _: 0.0
                for predicted, supports in near.predicted_neighbours():
                    value = predicted + more(supports)
                    known = promising.get(proposed := supports.tobytes())
                    promising[proposed] = (value, near, supports) if known is None or value < known[0] else known
        untried = [entry for key, entry in promising.items() if key not in done and entry[0] < most]
        if not untried:
            break
        _, near, supports = min(untried, key=lambda entry: entry[0])
        done.add(supports.tobytes())
        fit = _comparable(near.problem, near, supports, best.model_error, starts)
        ranked = sorted([*ranked, fit]) if fit.is_usable else ranked
        vain = vain + 1 if ranked[0] is best else 0
        best = ranked[0]
    return [best.with_alternatives([fit for fit in ranked if fit.model_error == best.model_error]), *ranked[1:]]


def _comparable(
    problem: SearchProblem, near: Fit, supports: Bools, model_error: float, starts: InitialConditionPrior | None
) -> Fit:
    """Return supports fitted from a fit that is near, to be compared with others.

    Of supports that leave far more than the noise all would count as outliers, which cost too little; so no evidence is
    larger than under noise of the size that they leave.
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
    return fit.with_score(score.plus("initial conditions", starts.price(fit)) if starts else score)


def compare_alternatives(fit: Fit) -> Fit:
    """Return the best of a fit and its alternatives, fitted to its problem, and of what else may be as plausible."""
    here, starts = fit.with_score(fit.evidence.score(fit.supports)), InitialConditionPrior(fit)
    plausible = [alternative for alternative in fit.alternatives if alternative.score - fit.score < PLAUSIBLE]
    fits = [
        _comparable(fit.problem, alternative, alternative.supports, fit.model_error, starts)
        for alternative in plausible
    ]
    best = with_neighbours([here, *fits], starts)[0]
    return fit.with_alternatives_of(best) if np.array_equal(best.supports, fit.supports) else best


def refit_leading(fit: Fit) -> Fit:
    """Return the best of a fit and the supports next to it that have more evidence as linearised about it, fitted.

    At most as many are fitted as laws are carried along.
    """
    starts, done = InitialConditionPrior(fit), {known.supports.tobytes() for known in (fit, *fit.alternatives)}
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
        candidate = _comparable(fit.problem, fit, supports, fit.model_error, starts)
        if candidate.is_usable:
            best, rest = sorted([fit, candidate])
            fit = best.with_alternatives([*fit.alternatives, rest])
    return fit


def _anneal(problem: SearchProblem, given: Bools | None, model_errors: Sequence[float]) -> list[Fit]:
    """Choose supports, or take those given, and fit at one model error after the other, as long as that succeeds."""
    supports: Bools = problem.allowed
    estimates: Sequence[Estimate] = problem.starts
    fits: list[Fit] = []
    for model_error in model_errors:
        try:
            evidence = linearized_evidence(problem, estimates, errors_to_fit(model_error)[0])
        except NotPositiveError:
            break
        chosen = _chosen(problem, evidence, supports) if given is None else given
        begin: Sequence[Estimate] | None = estimates
        if given is not None or not np.array_equal(chosen, supports):
            supports, begin = chosen, restricted(problem, evidence, estimates, chosen)
        if given is None and not model_error:
            fit = refine_support(problem, supports, begin, model_error)
        else:
            fit = fitted(problem, begin, supports, model_error)
        if not fit.is_usable:
            break
        fits.append(fit)
        estimates = fit.estimates
    return fits


def _chosen(problem: SearchProblem, evidence: SupportEvidence, supports: Bools) -> Bools:
    assert problem.solver is not None
    return evidence.choose(supports, problem.solver)
