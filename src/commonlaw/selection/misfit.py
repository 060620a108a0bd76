"""Sums of squares of one equation, from systems."""

import numpy as np
from numpy.typing import NDArray

from commonlaw.formulation import System

Floats = NDArray[np.float64]

ROUNDING = 1e-20
"""Share of a target's sum of squares below which a residual is rounding: ten digits of the target agree."""


def misfit(system: System, target: int, coefficients: Floats) -> float:
    """Return the sum of squared residuals of one equation for coefficients of shape (terms,)."""
    left = system.factor[:, : system.terms] @ coefficients - system.factor[:, system.terms + target]
    return float(left @ left)


def size(system: System, target: int) -> float:
    """Return the sum of squares of one target."""
    return misfit(system, target, np.zeros(system.terms))
