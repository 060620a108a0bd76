"""Sequentially thresholded least squares, each object by itself."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from commonlaw.errors import CommonlawError
from commonlaw.formulation import System
from commonlaw.solvers.base import AbstractSolver, Fit
from commonlaw.solvers.thresholding import threshold_sequentially


@dataclass(frozen=True)
class STLSQ(AbstractSolver):
    """Sequentially thresholded least squares: every object has its own support (Brunton, Proctor, Kutz 2016).

    Least squares and dropping of the terms whose coefficient is smaller than the threshold are repeated until no
    term is dropped.

    Parameters
    ----------
    threshold
        Smallest magnitude of a coefficient that stays, in the coefficients' own units.
    ridge
        Weight of the squared norm of the coefficients in each least-squares problem.
    max_iterations
        At most so many sweeps; a support that still changes then is an outcome of the fit.
    normalize
        Compare coefficients of columns that are scaled to unit norm, so that the threshold does not depend on units.
    """

    threshold: float = 0.1
    ridge: float = 0.0
    max_iterations: int = 10
    normalize: bool = False

    def __post_init__(self) -> None:
        check_settings(self.threshold, self.ridge, self.max_iterations)

    def solve(self, systems: Sequence[System], candidates: NDArray[np.bool_]) -> Fit:
        """Return each object's own support and coefficients."""
        return threshold_sequentially(
            systems,
            candidates,
            lambda magnitudes: (magnitudes >= self.threshold, magnitudes.max(axis=2, initial=0.0)),
            ridge=self.ridge,
            max_iterations=self.max_iterations,
            normalize=self.normalize,
        )


def check_settings(threshold: float, ridge: float, max_iterations: int) -> None:
    """Refuse settings that no thresholding solver can work with."""
    for name, value, least in (("threshold", threshold, 0), ("ridge", ridge, 0), ("max_iterations", max_iterations, 1)):
        if isinstance(value, str) or not np.isfinite(value) or value < least:
            raise CommonlawError(f"{name} {value!r} does not fit: give a number of at least {least}")
