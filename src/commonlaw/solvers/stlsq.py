"""Sequentially thresholded least squares, each object by itself."""

from collections.abc import Sequence
from dataclasses import dataclass

from commonlaw.array_types import Bools
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers.base import AbstractSolver, Candidate, Fit
from commonlaw.solvers.settings import check_setting
from commonlaw.solvers.thresholding import Thresholding


@dataclass(frozen=True)
class STLSQ(AbstractSolver):
    """Sequentially thresholded least squares: every object has its own support (Brunton, Proctor, Kutz 2016).

    Least squares and dropping of the terms whose coefficient is smaller than the threshold are repeated until no
    term is dropped.

    Parameters
    ----------
    threshold
        Smallest magnitude of a coefficient that stays, in the coefficients' own units; None to have it chosen.
    ridge
        Weight of the squared norm of the coefficients, in their own units also where columns are scaled for the
        threshold, in each least-squares problem.
    max_iterations
        At most so many sweeps; a support that still changes then is an outcome of the fit.
    normalize
        Compare coefficients of columns that are scaled to unit norm, so that the threshold does not depend on units.
    """

    threshold: float | None = None
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
        """Return each object's own support and coefficients."""
        return self._method.solve(problems, candidates, self.threshold)

    def path(self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools) -> tuple[Candidate, ...]:
        """Return the equations of all thresholds, by their exact breakpoints."""
        return self._method.path(problems, target, allowed)

    @property
    def _method(self) -> Thresholding:
        return Thresholding(lambda magnitudes: magnitudes, self.ridge, self.max_iterations, self.normalize)
