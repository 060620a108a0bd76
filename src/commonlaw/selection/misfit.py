"""Sums of squares of one equation, from systems."""

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.formulation import LeastSquaresProblem

ROUNDING = 1e-20
"""Share of a target's sum of squares below which a residual is rounding: ten digits of the target agree."""


def misfit(problem: LeastSquaresProblem, target: int, coefficients: Floats) -> float:
    """Return the sum of squared residuals of one equation for coefficients of shape (terms,)."""
    left = problem.factor[:, : problem.terms] @ coefficients - problem.factor[:, problem.terms + target]
    return float(left @ left)


def size(problem: LeastSquaresProblem, target: int) -> float:
    """Return the sum of squares of one target."""
    return misfit(problem, target, np.zeros(problem.terms))
