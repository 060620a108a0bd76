"""Sparse relaxed regularised regression."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.solvers.base import AbstractSolver, groups, threshold_path
from commonlaw.solvers.candidate import Candidate, least_squares
from commonlaw.solvers.settings import check_setting, check_shared


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

    hyperparameter_name = "threshold"

    def __post_init__(self) -> None:
        check_setting("threshold", self.threshold, 0, optional=True)
        check_setting("nu", self.nu, 0, above=True)
        check_setting("max_iterations", self.max_iterations, 1, whole=True)
        check_shared(self.shared)

    @property
    def hyperparameter(self) -> float | None:
        return self.threshold

    def path(
        self,
        problems: Sequence[LeastSquaresProblem],
        target: int,
        allowed: Bools,
        values: Sequence[float] | None = None,
    ) -> tuple[Candidate, ...]:
        scale = np.sqrt(np.mean([problem.norms**2 for problem in problems], axis=0))
        scale = np.where(allowed & (scale > 0), scale, 1.0)
        by_group = [self._relaxation(group, target, allowed, scale) for group in groups(problems, self.shared)]

        def candidate_at(threshold: float) -> Candidate:
            return Candidate.join([self._relax(each, threshold) for each in by_group])

        if values is not None:
            return tuple(candidate_at(value) for value in values)
        path = threshold_path(candidate_at)
        return path[:1] + tuple(each for last, each in pairwise(path) if not np.array_equal(last.support, each.support))

    def _relaxation(
        self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools, scale: Floats
    ) -> "_Relaxation":
        terms = problems[0].terms
        columns = np.array([problem.factor[:, :terms] * allowed for problem in problems]) / scale
        right = np.array([problem.factor[:, terms + target] for problem in problems])
        inverse = np.linalg.inv(np.matmul(columns.transpose(0, 2, 1), columns) + np.eye(terms) / self.nu)
        pulled = np.matmul(inverse, np.einsum("oqt,oq->ot", columns, right)[..., np.newaxis])[..., 0]
        unit = np.ones(terms) if self.normalize else scale
        return _Relaxation(problems, target, allowed, scale, unit, inverse, pulled)

    def _relax(self, relaxation: "_Relaxation", threshold: float) -> Candidate:
        """Iterate from the least-squares coefficients of all allowed terms."""
        problems, target, allowed = relaxation.problems, relaxation.target, relaxation.allowed
        everything = np.repeat(allowed[np.newaxis], len(problems), axis=0)
        sparse, converged = least_squares(problems, target, everything) * relaxation.scale, False
        for _ in range(self.max_iterations):
            dense = relaxation.dense(sparse, self.nu)
            sizes = np.linalg.norm(np.abs(dense) / relaxation.unit, axis=0)
            support = allowed & (sizes >= threshold)
            following = np.where(support, dense, 0.0)
            change, sparse = np.abs(following - sparse).max(initial=0.0), following
            converged = bool(change <= 1e-10 * np.abs(sparse).max(initial=0.0))
            if converged:
                break
        supports = np.repeat(support[np.newaxis], len(problems), axis=0)
        return Candidate(
            supports,
            least_squares(problems, target, supports),
            threshold,
            converged=converged,
            largest=float(sizes[allowed].max(initial=0.0)),
            smallest=float(sizes[support].min(initial=np.inf)),
        )


@dataclass(frozen=True, eq=False)
class _Relaxation:
    """What the iteration for some objects needs, whatever the threshold.

    Parameters
    ----------
    problems, target, allowed
        As in `AbstractSolver.path`.
    scale
        What columns are divided by, shape (terms,).
    unit
        What scaled coefficients are divided by for the threshold, shape (terms,).
    inverse
        Of the normal equations of b, shape (objects, terms, terms).
    pulled
        The b that would follow from w = 0, shape (objects, terms).
    """

    problems: Sequence[LeastSquaresProblem]
    target: int
    allowed: Bools
    scale: Floats
    unit: Floats
    inverse: Floats
    pulled: Floats

    def dense(self, sparse: Floats, nu: float) -> Floats:
        """Return the coefficients b that fit, given the sparse ones w near which they stay, shape (objects, terms)."""
        return np.asarray(self.pulled + np.matmul(self.inverse, sparse[..., np.newaxis])[..., 0] / nu)
