"""Sums of squares of one equation, from problems."""

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.formulation import LeastSquaresProblem

ROUNDING = 1e-20
"""Share of a target's sum of squares below which a residual is rounding: ten digits of the target agree."""


def rss(problem: LeastSquaresProblem, target: int, coefficients: Floats) -> float:
    """Return the sum of squared residuals of one equation for coefficients of shape (terms,)."""
    left = problem.factor[:, : problem.terms] @ coefficients - problem.factor[:, problem.terms + target]
    return float(left @ left)


def tss(problem: LeastSquaresProblem, target: int) -> float:
    """Return the sum of squares of one target."""
    return rss(problem, target, np.zeros(problem.terms))
