"""Laws of long trials and of many objects: supports are sought in some of them, and all weigh what is found there.

A search linearises the likelihood with all candidate terms many times; some thousand samples, of some objects, show it
the same supports as all. These choose again then, beginning with what was found, and so decide what few cannot tell.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress

from commonlaw.inference.fit.annealing import SCHEDULES, fit_supports, fit_with, polish, search, with_close_neighbours
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.state import NO_ERROR, SearchState
from commonlaw.likelihood import NotPositiveError, threads_pay
from commonlaw.parallel import in_parallel
from commonlaw.progress import ProgressCallback, Stage, part
from commonlaw.solvers import AbstractSolver

FEW_SAMPLES = 4000
"""Samples in which supports are sought first, where there are more than twice as many."""

_FEW, _GROUPS = 10, 2
"""Objects of a group, and how many groups are searched where there are more objects than in all of them. Supports of
several groups are weighed, as evidence that is linearised about one law errs for each object."""

_SEARCHED = 0.7
"""Share of the time after which that is done; it is only shown."""


def few_of(problem: SearchProblem, prepared: Callable[..., SearchProblem]) -> list[SearchProblem]:
    """Return the problems of some of the samples or objects, none where there are few of both.

    Parameters
    ----------
    problem
        Of all.
    prepared
        Returns the problem of `most_samples`, see `prepare`.
    """
    objects = len(problem.models)
    groups = [range(first, objects, objects // _FEW) for first in range(_GROUPS)] if objects > _FEW * _GROUPS else []
    most = FEW_SAMPLES * objects // _FEW if groups else FEW_SAMPLES
    if sum(map(len, problem.trials)) > 2 * most:
        fewer = prepared(most_samples=most)
        return [fewer.of_objects(each) for each in groups] or [fewer]
    return [problem.of_objects(each) for each in groups]


def search_by_few(
    problem: SearchProblem, few: Sequence[SearchProblem], solver: AbstractSolver, progress: ProgressCallback
) -> list[SearchState]:
    """Return what a search finds, see `search`, where `few` are some of the samples or objects.

    Where the measurements depart from all laws by more than their noise, in few or in all, the size of that decides
    with the supports: these are sought in all then.
    """
    tell = part(progress, 0.0, _SEARCHED) if len(few) == 1 else lambda _: None
    pays = threads_pay(problem.models)
    found = [each[0] for each in in_parallel(lambda each: search(each, solver, tell), few, pays=pays)]
    if not any(each.has_model_error for each in found):
        progress(Stage("weighing by all samples what some of them show", _SEARCHED))
        with suppress(NotPositiveError):
            weighed = _weighed(problem, found, solver)
            if not weighed[0].has_model_error:
                return weighed
    proposals = [each.supports for each in found] if len(few) > 1 else []
    return search(problem, solver, progress, proposals=proposals)


def _weighed(problem: SearchProblem, found: Sequence[SearchState], solver: AbstractSolver) -> list[SearchState]:
    """Return laws that some show, chosen again by all, the same with model errors, and close neighbours."""
    distinct = {each.supports.tobytes(): each for each in found}.values()
    pays = threads_pay(problem.models)
    ways = in_parallel(lambda each: _chosen_again(problem, each, solver), distinct, pays=pays)
    return with_close_neighbours(problem, [state for each in ways for state in each])


def _chosen_again(problem: SearchProblem, found: SearchState, solver: AbstractSolver) -> list[SearchState]:
    """Return a law that some show with a model error, and without one chosen again by all."""
    large, _ = SCHEDULES[1]
    if len(found.estimates) == len(problem.starts):
        state = fit_with(problem, found.supports, large, problem.starts_with(found.estimates))
    else:
        state = fit_supports(problem, found.supports, (large,))
    return [state, polish(problem, found.supports, state.estimates, NO_ERROR, solver)]
