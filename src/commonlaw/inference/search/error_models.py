"""Kinds of errors, each with the supports and the levels of largest evidence under it, and which of them is chosen."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.effort import unannounced
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.annealing import SCHEDULES, annealed, fit_solutions, fit_supports, fit_with, polish
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.state import SearchState, evidence_of, list_by_evidence, nearest, path
from commonlaw.inference.fit.validity import is_solved
from commonlaw.inference.search.error_levels import ErrorKind, kind_of, with_errors_of_kind
from commonlaw.likelihood import NotPositiveError
from commonlaw.progress import ProgressCallback, part
from commonlaw.solvers import AbstractSolver

WORDS: dict[ErrorKind, str] = {
    "white": "white noise",
    "proportional": "noise that grows with the states",
    "correlated": "errors of the measurements that have a memory",
    "walk": "a random walk",
    "force": "a smooth force",
}
"""What is said of each kind of errors."""

OF_LAWS: tuple[ErrorKind, ...] = ("walk", "force")
GROUPS: tuple[tuple[ErrorKind, ...], ...] = (("white",), ("proportional", "correlated"), OF_LAWS)
"""White noise, other errors of measurements, and those of laws: the best of each is sought with its own law."""

_ROUNDS = 2
"""How often supports and levels are found in turn."""

_FITTED = 4
"""Supports of largest linearised evidence that are fitted under each kind of errors, with levels of their own."""

_POOLED = 4
"""Supports that one kind of errors contributes to those that are compared under all."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A kind of errors with its levels, in a problem; the state of largest evidence under it, and others found."""

    kind: ErrorKind
    problem: SearchProblem
    state: SearchState
    found: Sequence[SearchState] = ()

    def fit(self, supports: Bools) -> tuple[SearchProblem, SearchState]:
        """Fit supports, shape (equations, terms), under errors of this kind, with levels of their own.

        Raises
        ------
        CommonlawError
            If the likelihood cannot be computed.
        """
        if self.kind == "white":
            return fit_solutions(self.problem, supports)
        state = fit_with(self.problem, supports, self.state.model_error)
        return with_errors_of_kind(self.problem, state, self.kind)

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
    """Return white noise, the best other errors of measurements, and the best of the law, each with its own law.

    The best are those of largest evidence with the supports that were found. What cannot be fitted is left out; the
    largest evidence comes first.
    """
    progress("comparing kinds of errors")
    starts = under_each_kind(problem, state.supports, kinds)
    found = []
    for number, group in enumerate(GROUPS, start=1):
        show = part(progress, number / (len(GROUPS) + 1), (number + 1) / (len(GROUPS) + 1))
        for start in sorted((each for each in starts if each.kind in group), key=lambda each: each.state.score)[:1]:
            show(f"seeking the law with {WORDS[start.kind]}")
            with suppress(CommonlawError):
                found.append(_in_turn(start, solver, show))
    return sorted(found, key=lambda each: each.state.score)


@unannounced()
def under_each_kind(problem: SearchProblem, supports: Bools, kinds: Sequence[ErrorKind]) -> list[Hypothesis]:
    """Return supports, shape (equations, terms), under each kind of errors that can be fitted, with its own levels."""
    found, white = [], problem.under_white_noise
    for begin in (white, problem) if problem.errors else (white,):
        with suppress(CommonlawError):
            solved = fit_solutions(begin, supports)
            for kind in [each for each in kinds if each != "walk"]:
                if begin is white or kind == kind_of(problem.errors):
                    with suppress(CommonlawError):
                        found.append(Hypothesis(kind, *with_errors_of_kind(*solved, kind)))
    if "walk" in kinds:
        with suppress(CommonlawError):
            found.append(Hypothesis("walk", *with_errors_of_kind(white, fit_supports(white, supports), "walk")))
    return found


def _in_turn(start: Hypothesis, solver: AbstractSolver, progress: ProgressCallback) -> Hypothesis:
    """Return a kind of errors with the supports and the levels that are found in turn."""
    kind, problem, state = start.kind, start.problem, start.state
    for _ in range(_ROUNDS):
        found = _searched(problem, state, kind, solver, progress)
        others = [each for each in found if not np.array_equal(each.supports, state.supports)]
        before = state.score
        for other in others[:1]:
            with suppress(NotPositiveError):
                changed, fitted = with_errors_of_kind(problem, other, kind)
                if fitted.score < state.score:
                    problem, state = changed, fitted
        if not state.score < before:
            break
    return Hypothesis(kind, problem, state, found)


def _searched(
    problem: SearchProblem, state: SearchState, kind: ErrorKind, solver: AbstractSolver, progress: ProgressCallback
) -> list[SearchState]:
    if kind == "walk":
        return [polish(problem, state.supports, state.estimates, state.model_error, solver)]
    found = list_by_evidence(annealed(problem, solver, progress, SCHEDULES[:1]))
    return [each for each in found if not each.has_model_error]


@unannounced()
def candidates(found: Sequence[Hypothesis], others: Sequence[Bools], solver: AbstractSolver) -> list[Hypothesis]:
    """Return the supports that were found under any kind of errors under each: those of largest evidence there."""
    most = found[0].problem.most_terms
    listed = [*(each for own in found for each in own.pool(solver)), *others]
    pool = list({each.tobytes(): each for each in listed if each.sum(axis=1).max() <= most}.values())
    compared = []
    for hypothesis in found:
        values = evidence_of(hypothesis.problem, hypothesis.state, pool)
        for i in np.argsort(values)[:_FITTED]:
            with suppress(CommonlawError):
                fitted = hypothesis.fit(pool[i])
                compared.append(replace(hypothesis, problem=fitted[0], state=fitted[1]))
    return compared


def chosen(compared: Sequence[Hypothesis], needed: float = 0.0) -> Hypothesis:
    """Return the hypothesis of largest evidence whose solutions exist along the trials that it was learned from.

    Errors other than white noise, under which coefficients are those of least squares, need so much evidence (2 log B).
    """
    listed = sorted(compared, key=lambda each: each.state.score.total + (0.0 if each.kind == "white" else needed))
    return next((each for each in listed if is_solved(each.problem, each.state)), listed[0])
