"""Backward elimination: the term that explains least leaves next."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Indices
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers.base import AbstractSolver, Candidate, Fit
from commonlaw.solvers.settings import check_setting, check_shared
from commonlaw.solvers.sized import Choice, Sized
from commonlaw.solvers.stack import Stack


@dataclass(frozen=True)
class BackwardElimination(AbstractSolver):
    """Stepwise elimination: the term whose leaving raises the squared residuals least leaves next.

    The stepwise sparse regressor of Boninsegna, Nüske, Clementi (2018), J. Chem. Phys. 148, 241723, with the rise of
    the squared residuals after a refit, which does not depend on units, in place of the magnitude of the coefficient.
    The rises of the objects are added, each relative to its object's residual variance, see `Stack`.

    Parameters
    ----------
    terms
        Number of terms in each equation; None to have it chosen.
    shared
        Whether all objects have the same terms, or each object its own.
    """

    terms: int | None = None
    shared: bool = True

    def __post_init__(self) -> None:
        check_setting("terms", self.terms, 1, whole=True, optional=True)
        check_shared(self.shared)

    @property
    def is_set(self) -> bool:
        return self.terms is not None

    def solve(self, problems: Sequence[LeastSquaresProblem], candidates: Bools) -> Fit:
        """Return the last `terms` that stay, and their coefficients."""
        return Sized(_choose, self.shared).solve(problems, candidates, self.terms)

    def path(self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools) -> tuple[Candidate, ...]:
        """Return one candidate for each number of terms, from all to none."""
        return Sized(_choose, self.shared).path(problems, target, allowed)


def left(stack: Stack, least: int = 0) -> Indices:
    """Return the places of all terms, those that stay longest first, as found on the way down to `least` terms."""
    directions, gone = stack.leaving(), np.zeros(0, dtype=np.intp)
    while len(directions.indices) > least:
        index = int(np.argmin(directions.gains))
        gone = np.append(directions.indices[index], gone)
        directions = directions.take(index)
    return np.concatenate([directions.indices, gone])


def _choose(stack: Stack, sizes: Sequence[int]) -> dict[int, Choice]:
    order = left(stack, min(sizes))
    return {size: Choice(order[:size]) for size in sizes}
