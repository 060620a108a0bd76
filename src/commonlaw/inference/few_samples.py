"""Laws of long trials: supports are sought in some of the samples, and what is found there is weighed by all of them.

A search linearises the likelihood with all candidate terms many times; some thousand samples show it the same supports
as all. These choose again then, beginning with what was found, and so decide what few samples cannot tell.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from commonlaw.inference.search import (
    NO_ERROR,
    SCHEDULES,
    SearchState,
    fit_with,
    polish,
    search,
    with_close_neighbours,
)
from commonlaw.inference.search_problem import SearchProblem
from commonlaw.likelihood import Estimate, NotPositiveError
from commonlaw.progress import ProgressCallback, Stage, part
from commonlaw.solvers import AbstractSolver

FEW_SAMPLES = 4000
"""Samples in which supports are sought first, where there are more than twice as many."""

_SEARCHED = 0.7
"""Share of the time after which that is done; it is only shown."""


def search_by_few(
    problem: SearchProblem, few: SearchProblem, solver: AbstractSolver, progress: ProgressCallback
) -> list[SearchState]:
    """Return what a search finds, see `search`, where `few` are some of the samples.

    Where the measurements depart from all laws by more than their noise, in few samples or in all, the size of that
    decides with the supports: these are sought in all samples then.
    """
    found = search(few, solver, part(progress, 0.0, _SEARCHED))
    if not found[0].has_model_error:
        progress(Stage("weighing by all samples what some of them show", _SEARCHED))
        with suppress(NotPositiveError):
            weighed = _weighed(problem, found[0], solver)
            if not weighed[0].has_model_error:
                return weighed
    return search(problem, solver, progress)


def _weighed(problem: SearchProblem, found: SearchState, solver: AbstractSolver) -> list[SearchState]:
    """Return a law that some samples show, chosen again by all, the same with model errors, and close neighbours."""
    pairs = zip(problem.starts, found.estimates, strict=True)
    start: Sequence[Estimate] = tuple(replace(own, coefficients=each.coefficients) for own, each in pairs)
    states = []
    for model_error in SCHEDULES[1]:
        if model_error:
            states.append(fit_with(problem, found.supports, model_error, start))
        else:
            states.append(polish(problem, found.supports, start, NO_ERROR, solver))
        start = states[-1].estimates
    return with_close_neighbours(problem, states)
