"""Stepwise selection: terms enter one by one, or leave one by one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from commonlaw.array_types import Bools, Indices
from commonlaw.errors import unknown
from commonlaw.runtime.arguments import check_whole_number
from commonlaw.solvers.base import AbstractSolver, Candidates, Problems, Subset, Values, check_shared, fixed_cardinality
from commonlaw.solvers.standardized_problem import StandardizedProblem


@dataclass(frozen=True)
class StepwiseSelection(AbstractSolver):
    """Forward selection or backward elimination, one term in each step.

    Forward, the term that lowers the squared residuals most enters: orthogonal least squares (FROLS; Chen, Billings,
    Luo 1989, Int. J. Control 50, 1873; Billings 2013, Nonlinear System Identification, section 3.2). Backward, the term
    whose leaving raises them least leaves: the stepwise sparse regressor of Boninsegna, Nüske, Clementi (2018), J.
    Chem. Phys. 148, 241723, with the rise of the squared residuals after a refit, which does not depend on units, in
    place of the magnitude of the coefficient. Objects are summed relative to their residual variances, see
    `StandardizedProblem`.

    Raises `CommonlawError` if an argument does not fit.

    Parameters
    ----------
    terms
        Number of terms in each equation; None to have it chosen.
    direction
        ``"forward"`` from no terms, or ``"backward"`` from all of them.
    shared
        Whether all objects have the same terms, or each object its own.
    """

    terms: int | None = None
    direction: Literal["forward", "backward"] = "forward"
    shared: bool = True

    hyperparameter_name = "terms"

    def __post_init__(self) -> None:
        check_whole_number("terms", self.terms, 1, optional=True)
        check_shared(self.shared)
        if self.direction not in ("forward", "backward"):
            raise unknown("direction", self.direction, ("forward", "backward"))

    def path(self, problems: Problems, target: int, allowed: Bools, values: Values = None) -> Candidates:
        return fixed_cardinality(self._choose, self.shared, problems, target, allowed, values)

    def _choose(self, problem: StandardizedProblem, sizes: Sequence[int]) -> dict[int, Subset]:
        order = (
            forward_order(problem, max(sizes)) if self.direction == "forward" else backward_order(problem, min(sizes))
        )
        return {size: Subset(order[:size]) for size in sizes}


def forward_order(problem: StandardizedProblem, terms: int) -> Indices:
    """Return the indices of the first terms that enter, in their order."""
    directions, order = problem.entering, np.zeros(0, dtype=np.intp)
    while len(order) < terms:
        index = int(np.argmax(directions.error_reductions))
        order = np.append(order, directions.indices[index])
        directions = directions.take(index)
    return order


def backward_order(problem: StandardizedProblem, least: int = 0) -> Indices:
    """Return the indices of all terms, those that stay longest first, as found on the way down to `least` terms."""
    directions, gone = problem.leaving, np.zeros(0, dtype=np.intp)
    while len(directions.indices) > least:
        index = int(np.argmin(directions.error_reductions))
        gone = np.append(directions.indices[index], gone)
        directions = directions.take(index)
    return np.concatenate([directions.indices, gone])
