"""The search for supports among plain terms, or the fit of given terms, on refined meshes.

A search linearizes the likelihood with all candidate terms many times, and a few thousand samples suffice to find the
supports. With long trials or many objects it runs on a subset; all samples then decide among the supports found.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import AbstractDifferentiator
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import (
    compare_alternatives,
    fit_supports,
    fit_with,
    refine_support,
    refit_leading,
    rescale_noise,
    search,
    with_neighbours,
)
from commonlaw.inference.fit.convergence import on_finer_mesh, until_resolved
from commonlaw.inference.fit.final_score import final
from commonlaw.inference.fit.fit import ALL_MODEL_ERRORS, NO_MODEL_ERROR, Fit, best_fit
from commonlaw.inference.fit.lack_of_fit import with_heteroscedastic_noise
from commonlaw.inference.fit.problem import SearchProblem, prepare
from commonlaw.inference.score.score import Kind
from commonlaw.inference.search.pool import Pool
from commonlaw.inference.search.setup import FitSetup, possible_interpolations, with_interpolation
from commonlaw.law import Step
from commonlaw.library import Terms
from commonlaw.likelihood import threads_are_worthwhile
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.parallel import in_parallel
from commonlaw.runtime.progress import ProgressCallback, Stage, part
from commonlaw.solvers import AbstractSolver, BestSubset
from commonlaw.trials import Trials

PATH = BestSubset(largest=8, nodes=1)
"""Lists candidate supports of an equation. None is proven optimal: neighbours of the chosen one are compared, too."""


def search_supports(
    trials: Trials,
    terms: Terms,
    known: Floats,
    *,
    solver: AbstractSolver,
    differentiation: AbstractDifferentiator,
    noise: Floats | None,
    huber_threshold: float,
    kinds: Sequence[ErrorKind],
    most_samples: int,
    progress: ProgressCallback,
) -> Pool:
    """Return the supports of largest evidence on the coarsest mesh, see `search_on_finer_mesh`.

    Known coefficients have the shape (objects, equations, terms), NaN where they are estimated. Solver and
    differentiation are those of a `SearchProblem`; noise, Huber threshold and samples those of `prepare`. The noise is
    heteroscedastic if that is among the error models and differences of the measurements indicate it.

    Raises `CommonlawError` if a trial is too short, a term is not finite on it, or the likelihood cannot be computed.
    """
    progress("estimating noise, smoothing")

    def prepared(most_samples: int) -> SearchProblem:
        problem = prepare(
            trials,
            terms,
            known,
            noise=noise,
            huber_threshold=huber_threshold,
            most_samples=most_samples,
            guess=np.nan_to_num(known),
        )
        problem = replace(problem, solver=solver, differentiation=differentiation)
        return with_heteroscedastic_noise(problem, kinds)

    problem, rest = prepared(most_samples), part(progress, 0.05, 1.0)
    _ = problem.law  # Refused if there is none, such as of second order on a logarithmic scale
    objects, (size, count) = len(problem.models), settings.OBJECT_GROUPS
    groups = [range(first, objects, objects // size) for first in range(count)] if objects > size * count else []
    most = settings.FEW_SAMPLES * objects // size if groups else settings.FEW_SAMPLES
    has_many = sum(map(len, problem.trials)) > 2 * most
    fewer = prepared(most) if has_many else problem
    subsets = [fewer.of_objects(group) for group in groups] or [fewer] * has_many
    fits = _search_subsets(problem, subsets, rest) if subsets else search(problem, rest)
    return Pool((rescale_noise(fits[0]),), fits)


def search_on_finer_mesh(pool: Pool, progress: ProgressCallback) -> Pool:
    """Return the result of a search on finer meshes while the best law has a model error.

    The discretization error of a coarse mesh acts as a model error.
    """
    fits = pool.explored
    while fits[0].has_model_error and fits[0].problem.points < settings.MAX_MESH_POINTS[0]:
        # Twice as many steps of a random walk of the same variance in time
        finer = on_finer_mesh(fits[0], (fits[0].model_error / np.sqrt(2),))
        if finer is None:
            break
        progress("searching again on a finer mesh")
        fits = search(finer.problem, progress)
    return pool if fits is pool.explored else Pool((rescale_noise(fits[0]),), fits)


def fit_terms(setup: FitSetup) -> Pool:
    """Fit the given terms of a law on a mesh that is refined until the estimates converge.

    Raises `CommonlawError` if a trial is too short, a term is not finite on it, or the likelihood cannot be computed.
    """
    problem = setup.problem()
    fit = fit_supports(problem, problem.allowed, ALL_MODEL_ERRORS)
    return Pool((rescale_noise(until_resolved(fit, lambda finer: finer)),))


def choose_interpolation(
    begin: Callable[[Trials, ProgressCallback], Pool],
    trials: Trials,
    *,
    input_interpolation: str,
    progress: ProgressCallback,
    is_chosen: bool = False,
) -> tuple[Pool, list[Step]]:
    """Return a pool under the input interpolation of largest evidence, and the step of the history that records it.

    `begin` searches for supports (`search_supports`) or fits given terms (`fit_terms`). Interpolations are compared if
    `input_interpolation` is ``"auto"``. That of the trials is kept unless the evidence for another one, for the same
    supports, is strong and, if plain terms have already chosen it (`is_chosen`), the law has no lack of fit under the
    other. With jumps nothing is assumed of the input within their intervals: a law that has no model error with them
    is not given one by another interpolation.

    Raises `CommonlawError` if the likelihood cannot be computed.
    """
    pool = begin(trials, part(progress, 0.0, 0.75))
    if input_interpolation != "auto" or not any(np.ptp(trial.inputs, axis=0).any() for trial in trials):
        return pool, []
    progress("comparing interpolations of inputs between samples")
    fit, before, gains = pool.best, trials.schema.input_interpolation, dict[str, float]()
    for between in (interpolation for interpolation in possible_interpolations(trials) if interpolation != before):
        if fit.problem.samples and "jumps" in (before, between):  # Of other samples the evidence is not comparable
            continue
        problem = fit.problem.interpolated(with_interpolation(trials, between))
        rival = fit_supports(problem, fit.supports, ALL_MODEL_ERRORS)
        gain = fit.score - rival.score
        if before == "jumps" and rival.has_model_error > fit.has_model_error:
            continue
        if gain > settings.STRONG and not (is_chosen and rival.lack_of_fit):
            gains[between] = gain
    if not gains:
        why = "the evidence for no other interpolation is strong, or the law has a lack of fit with it"
        return pool, [Step("inputs", before, f"between samples: {why}")]
    best = max(gains, key=gains.__getitem__)
    why = f"between samples: twice the log Bayes factor (2 log B) for it against {before} is {gains[best]:.3g}"
    return begin(with_interpolation(trials, best), progress), [Step("inputs", best, why)]


def resolved(pool: Pool, progress: ProgressCallback) -> Pool:
    """Return the pool with its best fit on a mesh that is refined until the estimates converge.

    There, plain terms are selected again among all plausible supports.
    """

    def reselect(fit: Fit) -> Fit:
        if fit.problem.solver is None:
            return fit
        progress("choosing terms again on a finer mesh")
        return refine_support(fit.problem, fit.supports, fit.estimates, fit.model_error).with_alternatives_of(fit)

    fit, done = pool.best, set[bytes]()
    while True:
        fit = best_fit([rescale_noise(until_resolved(fit, reselect))])
        if fit.problem.solver is None:
            return pool.with_best(fit)
        done.add(fit.supports.tobytes())
        best = compare_alternatives(fit)
        if best.supports.tobytes() in done:  # Two supports may each win under the residual variance of the other
            return pool.with_best(best)
        progress("fitting more plausible candidates")
        fit = best


def with_leading_support(pool: Pool) -> Pool:
    """Return a pool whose best has the supports that its linearization ranks first, if these have a better fit.

    Of those that are nearly as probable, that comes first whose fit is best as it is reported.
    """
    if pool.best.problem.solver is None:
        return pool
    fit = refit_leading(pool.best)
    same = np.array_equal(fit.supports, pool.best.supports)
    return pool.with_best(_best_as_reported(fit if same else rescale_noise(fit)))


def _best_as_reported(fit: Fit) -> Fit:
    """Return the best of a fit and its alternatives, if the evidence against these is not strong, see `final`."""
    near = [
        alternative
        for alternative in fit.alternatives
        if alternative.score - fit.score < settings.STRONG and alternative.is_resolved
    ]
    if not near or fit.score.kind is not Kind.EVIDENCE:
        return fit
    scores = [
        (done.score.total, alternative)
        for alternative in near
        for done, is_converged in [final(alternative)]
        if is_converged
    ]
    least, best = min(scores, key=lambda pair: pair[0], default=(np.inf, fit))
    done, _ = final(fit)
    if not least < done.score.total - settings.SAME_DEVIANCE:
        return fit
    more = least - done.score.total - (best.score - fit.score)
    others = [alternative for alternative in (fit, *fit.alternatives) if alternative is not best]
    return best.with_score(best.score.plus("refit", more)).with_alternatives(others)


def _search_subsets(problem: SearchProblem, smaller: Sequence[SearchProblem], progress: ProgressCallback) -> list[Fit]:
    """Return the fits of a search on subsets of samples or objects, compared on all samples.

    If the best law of a smaller problem, or of all samples, has a model error, its size and the supports depend on each
    other: then the search runs on all samples.
    """

    def reselected(fit: Fit) -> list[Fit]:
        """Return a fit of all samples with a model error, and the support selected from there without one."""
        large = settings.SCHEDULES[1][0]
        if len(fit.estimates) == len(problem.starts):
            first = fit_with(problem, fit.supports, large, problem.starts_with(fit.estimates))
        else:
            first = fit_supports(problem, fit.supports, (large,))
        return [first, refine_support(problem, fit.supports, first.estimates or None, NO_MODEL_ERROR)]

    show = part(progress, 0.0, 0.7) if len(smaller) == 1 else lambda _: None
    pays = threads_are_worthwhile(problem.models)
    best = [fits[0] for fits in in_parallel(lambda subset: search(subset, show), smaller, pays=pays)]
    if not any(fit.has_model_error for fit in best):
        progress(Stage("re-evaluating candidates on all samples", 0.7))
        distinct = {fit.supports.tobytes(): fit for fit in best}.values()
        compared = [fit for fits in in_parallel(reselected, distinct, pays=pays) for fit in fits]
        if all(fit.is_usable for fit in compared):
            compared = with_neighbours(compared)
            if not compared[0].has_model_error:
                return compared
    return search(problem, progress, proposals=[fit.supports for fit in best] if len(smaller) > 1 else [])
