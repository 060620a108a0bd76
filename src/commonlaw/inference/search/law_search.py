"""The search among plain terms, or the fit of terms that are given, on meshes that are fine enough.

Of long trials and many objects, supports are sought in some of them, and all weigh what is found there: a search
linearizes the likelihood with all candidate terms many times, and some thousand samples show it the same supports.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import AbstractDifferentiator
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import (
    fit_supports,
    fit_with,
    recompared,
    refine_support,
    rescale_noise,
    search,
    with_close_neighbours,
)
from commonlaw.inference.fit.convergence import on_finer_mesh, until_resolved
from commonlaw.inference.fit.fit import ANY_ERROR, NO_ERROR, Fit, best_of
from commonlaw.inference.fit.lack_of_fit import with_growing_noise
from commonlaw.inference.fit.problem import SearchProblem, prepare
from commonlaw.inference.search.pool import Pool
from commonlaw.inference.search.setup import FitSetup, error_kinds, with_interpolation
from commonlaw.integration import BETWEEN
from commonlaw.law import Step
from commonlaw.library import Terms
from commonlaw.likelihood import meshes, threads_pay
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.parallel import in_parallel
from commonlaw.runtime.progress import ProgressCallback, Stage, part
from commonlaw.solvers import AbstractSolver, BestSubset
from commonlaw.trials import Trials

PATH = BestSubset(largest=8, nodes=1)
"""Lists the candidates of an equation. They need not be proven the best: neighbours of the chosen are compared too."""


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
    """Search for the supports of largest evidence on the coarsest mesh, see `explained_on_finer_mesh`.

    Coefficients that are known have the shape (objects, equations, terms), NaN where they are to be found. Solver and
    differentiation are those of a `SearchProblem`, noise, Huber threshold and samples those of `prepare`; noise is in
    proportion where that is among the kinds of errors and differences show it.

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
        return with_growing_noise(problem) if "proportional" in kinds else problem

    problem, rest = prepared(most_samples=most_samples), part(progress, 0.05, 1.0)
    _ = problem.law  # Refused if there is none, such as of second order on a logarithmic scale
    few = few_of(problem, prepared)
    fits = search_by_few(problem, few, rest) if few else search(problem, rest)
    return Pool((rescale_noise(fits[0]),), fits)


def explained_on_finer_mesh(pool: Pool, progress: ProgressCallback) -> Pool:
    """Return a search on a finer mesh if its law has a model error, as a coarse mesh looks, too."""
    fits = pool.explored
    while fits[0].has_model_error and fits[0].problem.points < settings.MAX_MESH_POINTS[0]:
        # The random walk is to be the same in twice as many steps
        finer = on_finer_mesh(fits[0], (fits[0].model_error / np.sqrt(2),))
        if finer is None:
            break
        progress("searching again on a finer mesh")
        fits = search(finer.problem, progress)
    return pool if fits is pool.explored else Pool((rescale_noise(fits[0]),), fits)


def fit_terms(setup: FitSetup) -> Pool:
    """Fit the terms of a law to what was measured, on a mesh that is fine enough.

    Raises `CommonlawError` if a trial is too short, a term is not finite on it, or the likelihood cannot be computed.
    """
    problem = setup.problem()
    fit = best_of([fit_supports(problem, problem.allowed, ANY_ERROR)])
    return Pool((rescale_noise(until_resolved(fit, lambda finer: finer)),))


def begin_search(
    begin: Callable[[Trials, ProgressCallback], Pool],
    trials: Trials,
    *,
    input_between: str,
    errors: ErrorKind | Literal["auto"],
    progress: ProgressCallback,
    is_chosen: bool = False,
) -> tuple[Pool, list[Step]]:
    """Return a search with the interpolation of inputs that is chosen, and what to say of that.

    It begins by `search_supports`, or fits terms that are given by `fit_terms`. The interpolation ``"auto"`` is that of
    largest evidence; if laws of plain terms have chosen that of the trials, only one without lack of fit is taken
    instead.

    Raises `CommonlawError` if the likelihood cannot be computed, or the `errors` that are asked for do not go with the
    trials.
    """
    error_kinds(errors, trials.schema)
    pool, steps = begin(trials, part(progress, 0.0, 0.75)), list[Step]()
    if input_between == "auto" and trials.schema.inputs:
        progress("comparing interpolations of inputs between samples")
        steps = [best_interpolation(pool.best, is_chosen)]
        if steps[0].choice != trials.schema.input_between:
            pool = begin(with_interpolation(trials, steps[0].choice), progress)
    return pool, steps


def best_interpolation(fit: Fit, is_chosen: bool) -> Step:
    """Return the interpolation of inputs of largest evidence, for the supports that were found.

    That of the fit stays unless the evidence for another is strong; where laws of plain terms chose it, without a lack
    of fit of the law with the other.
    """
    before, gains = fit.problem.trials.schema.input_between, dict[str, float]()
    for other in (_fitted_with(fit, each) for each in BETWEEN if each != before):
        gain = fit.score - other.score
        if gain > settings.STRONG and not (is_chosen and other.lack_of_fit):
            gains[other.problem.trials.schema.input_between] = gain
    if gains:
        best = max(gains, key=lambda each: gains[each])
        why = f"between samples: twice the log Bayes factor (2 log B) for it against {before} is {gains[best]:.3g}"
        return Step("inputs", best, why)
    why = "the evidence for no other interpolation is strong, or the law has a lack of fit with it"
    return Step("inputs", before, f"between samples: {why}")


def _fitted_with(fit: Fit, between: str) -> Fit:
    """Return the supports of a fit fitted with another interpolation of inputs."""
    problem = fit.problem
    groups = [problem.trials.of_object(name) for name in problem.trials.objects]
    models = tuple(
        replace(model, meshes=meshes(group, problem.points, input_between=between))
        for model, group in zip(problem.models, groups, strict=True)
    )
    changed = replace(problem, trials=with_interpolation(problem.trials, between), models=models)
    changed = changed.with_errors(problem.noise, problem.errors, problem.noise_reason)
    return fit_supports(changed, fit.supports, ANY_ERROR)


def resolved(pool: Pool, progress: ProgressCallback) -> Pool:
    """Return a pool whose best is on a mesh that is fine enough.

    Plain terms are chosen again there, together with all that is plausible.
    """

    def again(fit: Fit) -> Fit:
        if fit.problem.solver is None:
            return fit
        progress("choosing terms again on a finer mesh")
        return refine_support(fit.problem, fit.supports, fit.estimates, fit.model_error).with_alternatives_of(fit)

    fit, done = pool.best, set[bytes]()
    while True:
        fit = best_of([rescale_noise(until_resolved(fit, again))])
        if fit.problem.solver is None:
            return pool.with_best(fit)
        done.add(fit.supports.tobytes())
        best = recompared(fit)
        if best.supports.tobytes() in done:  # Each of two may be the better one under the noise that the other leaves
            return pool.with_best(best)
        progress("fitting more plausible candidates")
        fit = best


def few_of(problem: SearchProblem, prepared: Callable[..., SearchProblem]) -> list[SearchProblem]:
    """Return the problems of some of the samples or objects, none where there are few of both.

    That of so many samples is `prepared`, see `prepare`.
    """
    objects, (size, count) = len(problem.models), settings.OBJECT_GROUPS
    groups = [range(first, objects, objects // size) for first in range(count)] if objects > size * count else []
    most = settings.FEW_SAMPLES * objects // size if groups else settings.FEW_SAMPLES
    if sum(map(len, problem.trials)) > 2 * most:
        fewer = prepared(most_samples=most)
        return [fewer.of_objects(each) for each in groups] or [fewer]
    return [problem.of_objects(each) for each in groups]


def search_by_few(problem: SearchProblem, few: Sequence[SearchProblem], progress: ProgressCallback) -> list[Fit]:
    """Return what a search finds, see `search`, where `few` are some of the samples or objects.

    Where the measurements depart from all laws by more than their noise, in few or in all, the size of that decides
    with the supports: these are sought in all then.
    """
    show = part(progress, 0.0, 0.7) if len(few) == 1 else lambda _: None
    pays = threads_pay(problem.models)
    best = [fits[0] for fits in in_parallel(lambda each: search(each, show), few, pays=pays)]
    if not any(fit.has_model_error for fit in best):
        progress(Stage("re-evaluating candidates on all samples", 0.7))
        distinct = {fit.supports.tobytes(): fit for fit in best}.values()
        ways = in_parallel(lambda each: _chosen_again(problem, each), distinct, pays=pays)
        weighed = [fit for way in ways for fit in way]
        if all(fit.is_usable for fit in weighed):
            weighed = with_close_neighbours(weighed)
            if not weighed[0].has_model_error:
                return weighed
    return search(problem, progress, proposals=[fit.supports for fit in best] if len(few) > 1 else [])


def _chosen_again(problem: SearchProblem, fit: Fit) -> list[Fit]:
    """Return a law that some show with a model error, and without one chosen again by all."""
    large, _ = settings.SCHEDULES[1]
    if len(fit.estimates) == len(problem.starts):
        first = fit_with(problem, fit.supports, large, problem.starts_with(fit.estimates))
    else:
        first = fit_supports(problem, fit.supports, (large,))
    return [first, refine_support(problem, fit.supports, first.estimates or None, NO_ERROR)]
