"""Kinds of errors, each with the supports and the levels of largest evidence under it."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.inference.error_search import ErrorKind, with_errors_of_kind
from commonlaw.inference.search import (
    SCHEDULES,
    SearchState,
    fit_solutions,
    fit_supports,
    fit_with,
    nearest,
    path,
    polish,
    search,
)
from commonlaw.inference.search_problem import SearchProblem
from commonlaw.likelihood import Estimate, NotPositiveError
from commonlaw.progress import ProgressCallback
from commonlaw.solvers import AbstractSolver

OF_MEASUREMENTS: tuple[ErrorKind, ...] = ("white", "proportional", "correlated")
OF_LAWS: tuple[ErrorKind, ...] = ("walk", "force")

_ROUNDS = 2
"""How often supports and levels are found in turn."""

_POOLED = 4
"""Supports that one kind of errors contributes to those that are compared under all."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A kind of errors with its levels, in a problem; the state of largest evidence under it, and others found."""

    kind: ErrorKind
    problem: SearchProblem
    state: SearchState
    found: Sequence[SearchState]

    def fit(
        self, problem: SearchProblem, supports: Bools, start: Sequence[Estimate] | None = None
    ) -> tuple[SearchProblem, SearchState]:
        """Fit supports, shape (equations, terms), under these errors to a problem that has them.

        White noise is enlarged until it explains what the supports leave. The start is that of `fit_with`.

        Raises
        ------
        CommonlawError
            If the likelihood cannot be computed.
        """
        if self.kind == "white":
            return fit_solutions(problem, supports, start)
        return problem, fit_with(problem, supports, self.state.fitted_model_error, start)

    def pool(self, solver: AbstractSolver) -> Iterator[Bools]:
        """Yield the supports of large evidence under these errors, and those on the solver's path from few terms."""
        yield self.state.supports
        yield from (each.supports for each in self.found[:_POOLED])
        yield from nearest(self.problem, self.state, _POOLED)
        yield from path(self.problem, self.state, solver)


def hypotheses(
    problem: SearchProblem,
    state: SearchState,
    kinds: Sequence[ErrorKind],
    solver: AbstractSolver,
    progress: ProgressCallback,
) -> list[Hypothesis]:
    """Return the kinds of errors that can be fitted, each with its own law, the largest evidence first."""
    found = []
    for kind in kinds:
        progress(f"seeking the law with {_WORDS[kind]}")
        with suppress(CommonlawError, NotPositiveError):
            found.append(_hypothesis(problem, state, kind, solver, progress))
    return sorted(found, key=lambda each: each.state.value)


_WORDS: dict[ErrorKind, str] = {
    "white": "white noise",
    "proportional": "noise that grows with the states",
    "correlated": "errors of the measurements that have a memory",
    "walk": "a random walk",
    "force": "a smooth force",
}


def _hypothesis(
    problem: SearchProblem, state: SearchState, kind: ErrorKind, solver: AbstractSolver, progress: ProgressCallback
) -> Hypothesis:
    """Return a kind of errors with the supports and the levels that are found in turn."""
    if kind != "walk":
        problem, state = fit_solutions(problem, state.supports)
    elif not state.has_model_error:
        state = fit_supports(problem, state.supports)
    problem, state = with_errors_of_kind(problem, state, kind)
    for _ in range(_ROUNDS):
        found = _searched(problem, state, kind, solver, progress)
        others = [each for each in found if not np.array_equal(each.supports, state.supports)]
        before = state.value
        for other in others[:1]:
            with suppress(NotPositiveError):
                changed, fitted = with_errors_of_kind(problem, other, kind)
                if fitted.value < state.value:
                    problem, state = changed, fitted
        if not state.value < before:
            break
    return Hypothesis(kind, problem, state, found)


def _searched(
    problem: SearchProblem, state: SearchState, kind: ErrorKind, solver: AbstractSolver, progress: ProgressCallback
) -> list[SearchState]:
    if kind == "walk":
        return [polish(problem, state.supports, state.estimates, state.model_error, solver)]
    return [each for each in search(problem, solver, progress, SCHEDULES[:1]) if not each.has_model_error]
