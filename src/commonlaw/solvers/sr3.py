"""Sparse relaxed regularised regression."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.runtime.arguments import check_number, check_types, check_whole_number
from commonlaw.solvers.base import (
    AbstractSolver,
    Candidate,
    Candidates,
    Problems,
    Values,
    check_shared,
    each_support_once,
    least_squares,
    threshold_path,
)


@dataclass(frozen=True)
class SR3(AbstractSolver):
    """Sparse relaxed regularized regression with a hard threshold, then a refit.

    Zheng, Askham, Brunton, Kutz, Aravkin (2019), IEEE Access 7, 1404, algorithm 1 with the l0 penalty: coefficients b
    that fit and sparse ones w alternate on ``||X b - y||^2 / 2 + ||b - w||^2 / (2 nu) + penalty ||w||_0``; w is b above
    the threshold. With a shared support the rows of w, over all objects, are thresholded by their Euclidean norm.
    Columns are divided by their norm (root mean square over the objects), so that `nu` depends neither on units nor on
    the number of rows.

    Raises `CommonlawError` if an argument does not fit.

    Parameters
    ----------
    threshold
        Smallest magnitude of a coefficient, or norm over the objects, that stays, in the coefficients' own units; None
        to have it chosen.
    nu
        Relaxation: towards 0 terms stay in or out as they began, large values let them come and go.
    shared
        Whether all objects have the same terms, or each object its own.
    max_iterations
        At most so many alternations; without convergence the fit has an outcome.
    normalize
        Threshold the coefficients of columns of unit norm, so that it does not depend on units.
    """

    threshold: float | None = None
    nu: float = 1.0
    shared: bool = True
    max_iterations: int = 1000
    normalize: bool = False

    hyperparameter_name = "threshold"

    def __post_init__(self) -> None:
        check_number("threshold", self.threshold, 0, optional=True)
        check_number("nu", self.nu, 0, above=True)
        check_whole_number("max_iterations", self.max_iterations, 1)
        check_shared(self.shared)
        check_types(SR3, vars(self))

    def path(self, problems: Problems, target: int, allowed: Bools, values: Values = None) -> Candidates:
        norms, terms = np.array([problem.norms for problem in problems]), problems[0].terms
        scale = np.sqrt(np.mean(norms**2, axis=0))
        scale = np.where(allowed & (scale > 0), scale, 1.0)
        unit = np.ones(terms) if self.normalize else scale
        columns = np.array([problem.factor[:, :terms] * allowed for problem in problems]) / scale
        right = np.array([problem.factor[:, terms + target] for problem in problems])
        # Of the normal equations of b, and the b that follows from w = 0
        inverse = np.linalg.inv(np.matmul(columns.transpose(0, 2, 1), columns) + np.eye(terms) / self.nu)
        pulled = np.matmul(inverse, np.einsum("oqt,oq->ot", columns, right)[..., np.newaxis])[..., 0]
        start = least_squares(problems, target, np.repeat(allowed[np.newaxis], len(problems), axis=0)) * scale

        def candidate_at(threshold: float) -> Candidate:
            """Let all objects take their turns together, also those with own terms: one product of arrays for all."""
            sparse, converged = start, False
            for _ in range(self.max_iterations):
                dense = pulled + np.matmul(inverse, sparse[..., np.newaxis])[..., 0] / self.nu
                sizes = np.abs(dense) / unit
                compared = np.broadcast_to(np.linalg.norm(sizes, axis=0), sizes.shape) if self.shared else sizes
                support = allowed & (compared >= threshold)
                following = np.where(support, dense, 0.0)
                change, sparse = np.abs(following - sparse).max(initial=0.0), following
                converged = bool(change <= 1e-10 * np.abs(sparse).max(initial=0.0))
                if converged:
                    break
            coefficients, stayed = least_squares(problems, target, support), compared[support].min(initial=np.inf)
            largest = float(compared[:, allowed].max(initial=0.0))
            return Candidate(support, coefficients, threshold, False, converged, largest, float(stayed))

        path = threshold_path(candidate_at, values)
        return each_support_once(path) if values is None else path
