"""Sparse relaxed regularised regression."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers.base import AbstractSolver, Candidate, Fit
from commonlaw.solvers.settings import check_setting, check_shared
from commonlaw.solvers.sized import fit_of, refit


@dataclass(frozen=True, eq=False)
class _Relaxed:
    """Where the iteration came to rest.

    Parameters
    ----------
    support
        Shape (objects, terms).
    values
        What was compared with the threshold last, shape (objects, terms).
    converged
        Whether it came to rest.
    """

    support: Bools
    values: Floats
    converged: bool


@dataclass(frozen=True)
class SR3(AbstractSolver):
    """Sparse relaxed regularised regression with a hard threshold, then a refit.

    Zheng, Askham, Brunton, Kutz, Aravkin (2019), IEEE Access 7, 1404, algorithm 1 with the l0 penalty: coefficients b
    that fit, and sparse ones w that stay near them, are found in turns from
    ``||X b - y||^2 / 2 + ||b - w||^2 / (2 nu) + penalty ||w||_0``; w is b without what lies below the threshold. With
    a shared support the rows of w, over all objects, stay or go by their Euclidean norm. Columns are divided by their
    norm (its root mean square over the objects), so that `nu` depends neither on units nor on the number of rows.

    Parameters
    ----------
    threshold
        Smallest magnitude of a coefficient, or norm over the objects of a term's coefficients, that stays, in the
        coefficients' own units; None to have it chosen.
    nu
        How far b and w may part: towards 0 terms stay in or out as they began, large values let them come and go.
    shared
        Whether all objects have the same terms, or each object its own.
    max_iterations
        At most so many turns; coefficients that still change then are an outcome of the fit.
    normalize
        Compare coefficients of columns that are scaled to unit norm, so that the threshold does not depend on units.
    """

    threshold: float | None = None
    nu: float = 1.0
    shared: bool = True
    max_iterations: int = 1000
    normalize: bool = False

    def __post_init__(self) -> None:
        check_setting("threshold", self.threshold, 0, optional=True)
        check_setting("nu", self.nu, 0, above=True)
        check_setting("max_iterations", self.max_iterations, 1, whole=True)
        check_shared(self.shared)

    @property
    def is_set(self) -> bool:
        return self.threshold is not None

    def solve(self, problems: Sequence[LeastSquaresProblem], candidates: Bools) -> Fit:
        """Return the terms that stay, and their least-squares coefficients.

        Raises
        ------
        CommonlawError
            If there is no threshold.
        """
        if self.threshold is None:
            raise CommonlawError("the solver has no threshold: give it one, or let one be chosen from its path")
        relaxed = [self._relax(problems, target, allowed, self.threshold) for target, allowed in enumerate(candidates)]
        chosen = [refit(problems, target, each.support, self.threshold) for target, each in enumerate(relaxed)]
        largest = np.stack([each.values.max(axis=1, initial=0.0) for each in relaxed], axis=1)
        return fit_of(chosen, largest, all(each.converged for each in relaxed))

    def path(self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools) -> tuple[Candidate, ...]:
        """Return the equations of growing thresholds, from all terms to none.

        Where the iteration rests, every value that stayed is at least the threshold; it cannot rest there once the
        threshold passes the smallest, which is the next that is tried.
        """
        found: list[Candidate] = []
        threshold = 0.0
        while True:
            relaxed = self._relax(problems, target, allowed, threshold)
            if not found or not np.array_equal(found[-1].support, relaxed.support):
                found.append(refit(problems, target, relaxed.support, threshold))
            if not relaxed.support.any():
                return tuple(found)
            smallest = relaxed.values[relaxed.support].min()
            threshold = float(np.nextafter(max(smallest, threshold), np.inf))

    def _relax(
        self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools, threshold: float
    ) -> _Relaxed:
        """Iterate from the least-squares coefficients of all allowed terms."""
        norms = np.array([problem.norms for problem in problems])
        scale = np.sqrt(np.mean(norms**2, axis=0))
        scale = np.where(allowed & (scale > 0), scale, 1.0)
        size = problems[0].terms
        columns = np.array([problem.factor[:, :size] * allowed for problem in problems]) / scale
        right = np.array([problem.factor[:, size + target] for problem in problems])
        back = np.linalg.inv(np.matmul(columns.transpose(0, 2, 1), columns) + np.eye(size) / self.nu)
        pulled = np.matmul(back, np.einsum("oqt,oq->ot", columns, right)[..., np.newaxis])[..., 0]
        sparse = np.array([problem.least_squares(allowed, target) for problem in problems]) * scale
        unit = np.ones(size) if self.normalize else scale
        for _ in range(self.max_iterations):
            dense = pulled + np.matmul(back, sparse[..., np.newaxis])[..., 0] / self.nu
            sizes = np.abs(dense) / unit
            values = np.broadcast_to(np.linalg.norm(sizes, axis=0), sizes.shape) if self.shared else sizes
            support = allowed & (values >= threshold)
            following = np.where(support, dense, 0.0)
            change, sparse = np.abs(following - sparse).max(initial=0.0), following
            if change <= 1e-10 * np.abs(sparse).max(initial=0.0):
                return _Relaxed(support, np.where(allowed, values, 0.0), True)
        return _Relaxed(support, np.where(allowed, values, 0.0), False)
