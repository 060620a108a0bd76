"""Forward selection: the term that explains most enters next."""

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
class ForwardSelection(AbstractSolver):
    """Orthogonal least squares: the term that lowers the squared residuals most enters next (FROLS).

    Chen, Billings, Luo (1989), Int. J. Control 50, 1873; Billings (2013), Nonlinear System Identification, section 3.2:
    candidate columns are kept orthogonal to those that entered, and the one with the largest error reduction ratio
    follows. The objects' ratios are added, each relative to its object's residual variance, see `Stack`.

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
        """Return the first `terms` that enter, and their coefficients."""
        return Sized(_choose, self.shared).solve(problems, candidates, self.terms)

    def path(self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools) -> tuple[Candidate, ...]:
        """Return one candidate for each number of terms, from all to none."""
        return Sized(_choose, self.shared).path(problems, target, allowed)


def entered(stack: Stack, terms: int) -> Indices:
    """Return the places of the first terms that enter, in their order."""
    directions, order = stack.entering(), np.zeros(0, dtype=np.intp)
    while len(order) < terms:
        index = int(np.argmax(directions.gains))
        order = np.append(order, directions.indices[index])
        directions = directions.take(index)
    return order


def _choose(stack: Stack, sizes: Sequence[int]) -> dict[int, Choice]:
    order = entered(stack, max(sizes))
    return {size: Choice(order[:size]) for size in sizes}
