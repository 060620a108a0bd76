"""Sequentially thresholded least squares with one support for all objects."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers.base import AbstractSolver, Candidate, Fit
from commonlaw.solvers.importance import L1, AbstractImportance
from commonlaw.solvers.settings import check_setting
from commonlaw.solvers.thresholding import Thresholding


@dataclass(frozen=True)
class GroupSTLSQ(AbstractSolver):
    """Sequentially thresholded least squares with one support shared by all objects.

    De Silva, Higdon, Brunton, Kutz (2020), section 2.3.2, algorithm 1: solve least squares for every object, drop
    the terms whose coefficients, taken over all objects, have too little importance, and repeat until none is dropped.
    With one object it equals `STLSQ`.

    Parameters
    ----------
    threshold
        Smallest importance of a term that stays, in the units of the importance; None to have it chosen.
    importance
        The measure R of a row of coefficients: `L1` (the paper's), `L2`, `Mean`, `Median`, `Quantile`, `Count`.
    ridge
        Weight of the squared norm of the coefficients, in their own units also where columns are scaled for the
        threshold, in each least-squares problem.
    max_iterations
        At most so many sweeps; a support that still changes then is an outcome of the fit.
    normalize
        Compare coefficients of columns that are scaled to unit norm, so that the threshold does not depend on units.
    """

    threshold: float | None = None
    importance: AbstractImportance = L1()
    ridge: float = 0.0
    max_iterations: int = 10
    normalize: bool = False

    def __post_init__(self) -> None:
        check_setting("threshold", self.threshold, 0, optional=True)
        check_setting("ridge", self.ridge, 0)
        check_setting("max_iterations", self.max_iterations, 1, whole=True)

    @property
    def is_set(self) -> bool:
        return self.threshold is not None

    def solve(self, problems: Sequence[LeastSquaresProblem], candidates: Bools) -> Fit:
        """Return the shared support and each object's coefficients."""
        return self._method.solve(problems, candidates, self.threshold)

    def path(self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools) -> tuple[Candidate, ...]:
        """Return the equations of all thresholds, by their exact breakpoints."""
        return self._method.path(problems, target, allowed)

    @property
    def _method(self) -> Thresholding:
        def measure(magnitudes: Floats) -> Floats:
            return np.broadcast_to(self.importance.measure(magnitudes), magnitudes.shape)

        return Thresholding(measure, self.ridge, self.max_iterations, self.normalize)
