"""Solvers whose setting is the number of terms."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.errors import CommonlawError
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers.base import Candidate, Fit
from commonlaw.solvers.stack import Stack


@dataclass(frozen=True, eq=False)
class Choice:
    """The places that were chosen for one number of terms, and whether they are proved to be the best."""

    indices: Indices
    proven: bool = False


@dataclass(frozen=True)
class Sized:
    """From a choice of terms for each number of terms to candidates and fits.

    Parameters
    ----------
    choose
        From a stack and numbers of terms to the choice for each.
    shared
        Whether one choice is made for all objects, or each object's own, of equal number.
    exact
        Whether a choice that is not proven is a search that did not come to its end.
    """

    choose: Callable[[Stack, Sequence[int]], Mapping[int, Choice]]
    shared: bool
    exact: bool = False

    def path(self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools) -> tuple[Candidate, ...]:
        """Return one candidate for each number of terms, from all to none."""
        return self._candidates(problems, target, allowed, range(int(allowed.sum()), -1, -1))

    def solve(self, problems: Sequence[LeastSquaresProblem], candidates: Bools, terms: int | None) -> Fit:
        """Return the fit with so many terms in each equation, or with all where fewer are allowed.

        Raises
        ------
        CommonlawError
            If there is no number of terms.
        """
        if terms is None:
            raise CommonlawError("the solver has no number of terms: give it one, or let one be chosen from its path")
        sizes = np.minimum(terms, candidates.sum(axis=1))
        chosen = [
            self._candidates(problems, target, allowed, [int(size)])[0]
            for target, (allowed, size) in enumerate(zip(candidates, sizes, strict=True))
        ]
        largest = np.repeat(candidates.sum(axis=1)[np.newaxis].astype(np.float64), len(problems), axis=0)
        return fit_of(chosen, largest, not self.exact or all(each.proven for each in chosen))

    def _candidates(
        self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools, sizes: Sequence[int]
    ) -> tuple[Candidate, ...]:
        groups = [problems] if self.shared else [[problem] for problem in problems]
        choices = [self.choose(Stack.of(group, target, allowed), sizes) for group in groups]
        return tuple(
            refit(
                problems,
                target,
                np.array([_support(allowed, own[size].indices) for own in choices]),
                float(size),
                all(own[size].proven for own in choices),
            )
            for size in sizes
        )


def refit(
    problems: Sequence[LeastSquaresProblem], target: int, support: Bools, setting: float, proven: bool = False
) -> Candidate:
    """Return the candidate of a support, shape (objects or 1, terms), with its least-squares coefficients."""
    support = np.repeat(support, len(problems) // len(support), axis=0)
    rows = zip(problems, support, strict=True)
    coefficients = np.array([problem.least_squares(terms, target) for problem, terms in rows])
    return Candidate(support, coefficients, setting, proven)


def fit_of(candidates: Sequence[Candidate], largest: Floats, converged: bool) -> Fit:
    """Return the fit that one candidate for each equation makes."""
    return Fit(
        np.stack([each.coefficients for each in candidates], axis=1),
        np.stack([each.support for each in candidates], axis=1),
        largest,
        converged,
    )


def _support(allowed: Bools, indices: Indices) -> Bools:
    support = np.zeros(len(allowed), dtype=bool)
    support[np.flatnonzero(allowed)[indices]] = True
    return support
