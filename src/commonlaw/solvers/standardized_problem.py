"""One equation of all objects, brought to scales on which its terms and its objects compare."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.formulation import LeastSquaresProblem, explained

_RIDGE = 1e-11
"""Parts columns of unit norm that depend on each other, so that five digits of their directions remain."""

_MIN_NORM = 1e-14
"""What is left of a unit vector, of which no digit is right."""


@dataclass(frozen=True, eq=False)
class StandardizedProblem:
    """The least-squares problems of one equation, one for each object, and the terms that may enter.

    Columns have unit norm. Each object's squared residuals are divided by its residual variance with all terms
    (generalized least squares with fixed variances), so that no object dominates because it is large or noisy; with no
    more rows than terms the mean square of its target is taken.

    `columns` are upper triangular factors, shape (objects, p, p), `right` is the target in the same basis, shape
    (objects, p), `rest` the residual of all terms, summed over objects, and `variance` has shape (objects,).
    """

    columns: Floats
    right: Floats
    rest: float
    variance: Floats

    @classmethod
    def of(cls, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools) -> "StandardizedProblem":
        """Return the problem of all objects from theirs; dependent columns are parted by a small ridge."""
        size = int(allowed.sum())
        factors = np.array([problem.factor for problem in problems])
        norms = np.array([problem.norms[allowed] for problem in problems])
        columns = factors[:, :, : problems[0].terms][:, :, allowed] / np.where(norms > 0, norms, 1.0)[:, np.newaxis]
        right = factors[:, :, problems[0].terms + target, np.newaxis]
        ridge = np.broadcast_to(np.eye(size, size + 1) * _RIDGE, (len(problems), size, size + 1))
        stacked = np.concatenate([np.concatenate([columns, right], axis=2), ridge], axis=1)
        reduced = np.asarray(np.linalg.qr(stacked, mode="r"))
        rest = reduced[:, size, size] ** 2
        rows = np.array([problem.rows for problem in problems])
        mean = np.sum(right[..., 0] ** 2, axis=1) / np.maximum(rows, 1)
        variance = np.where(rows > size, rest / np.maximum(rows - size, 1), mean)
        variance = np.maximum(variance, 1e-20 * mean)  # Smaller ones tell the ridge and rounding, and not the noise
        variance = np.where(variance > 0, variance, 1.0)
        scaled = reduced[:, :size, size] / np.sqrt(variance)[:, np.newaxis]
        return cls(reduced[:, :size, :size], scaled, float(np.sum(rest / variance)), variance)

    @property
    def size(self) -> int:
        """Number of terms that may enter."""
        return int(self.right.shape[1])

    @property
    def rounding(self) -> float:
        """The size of what the ridge and rounding add to a sum of squared residuals."""
        return float(_RIDGE**2 * np.sum(self.right**2))

    @cached_property
    def entering(self) -> "Directions":
        """What each term explains when it enters alone."""
        return Directions.of(self.columns.transpose(0, 2, 1), self.right, np.arange(self.size))

    @cached_property
    def leaving(self) -> "Directions":
        """What each term's leaving of the full equation costs.

        The columns are ``Q R``. Leaving out the terms D adds to the squared residuals the squared projection of ``Q'
        target`` onto the span of those rows of ``R^-1``: terms leave by the same steps by which they enter.
        """
        return Directions.of(np.asarray(np.linalg.inv(self.columns)), self.right, np.arange(self.size))

    def residual(self, indices: Sequence[int] | Indices) -> float:
        """Return the sum over objects of scaled squared residuals of least squares on these of the allowed terms."""
        return self.rest + float(self._explained(indices)[-1])

    def best_entering(self, inside: Sequence[int] | Indices) -> int:
        """Return which of the other terms explains most when it enters in addition to those inside."""
        found = self._explained(inside)[:-1]
        found[np.asarray(inside, dtype=np.intp)] = -np.inf
        return int(np.argmax(found))

    def _explained(self, inside: Sequence[int] | Indices) -> Floats:
        return explained(self._rows, np.asarray(inside, dtype=np.intp), _MIN_NORM**2)

    @cached_property
    def _rows(self) -> Floats:
        return np.concatenate([self.columns, self.right[..., np.newaxis]], axis=2)


@dataclass(frozen=True, eq=False)
class Directions:
    """Unit directions of terms, shape (objects, terms, p), and the vectors projected on them, (objects, p)."""

    units: Floats
    left: Floats
    indices: Indices

    @classmethod
    def of(cls, vectors: Floats, left: Floats, indices: Indices) -> "Directions":
        """Scale vectors to unit norm; what is rounding compared with a unit becomes zero."""
        norms = np.sqrt(np.einsum("otp,otp->ot", vectors, vectors))
        scale = np.divide(1.0, norms, out=np.zeros_like(norms), where=norms > _MIN_NORM)
        return cls(vectors * scale[..., np.newaxis], left, indices)

    @property
    def error_reductions(self) -> Floats:
        """Squared projections onto each term's direction, summed over the objects, shape (terms,)."""
        projections = np.matmul(self.units, self.left[..., np.newaxis])[..., 0]
        return np.asarray(np.einsum("ot,ot->t", projections, projections))

    def take(self, index: int) -> "Directions":
        """Return the others, with this one projected out (a step of modified Gram-Schmidt)."""
        axis = self.units[:, index]
        others = np.delete(self.units, index, axis=1)
        others -= np.matmul(others, axis[..., np.newaxis]) * axis[:, np.newaxis]
        left = self.left - np.sum(self.left * axis, axis=1, keepdims=True) * axis
        return Directions.of(others, left, np.delete(self.indices, index))

    def drop(self, index: int) -> "Directions":
        """Return the others as they are."""
        return Directions(np.delete(self.units, index, axis=1), self.left, np.delete(self.indices, index))

    def pair_error_reductions(self) -> Floats:
        """Squared projections onto the span of every pair, summed over the objects, shape (terms, terms).

        Sum and difference of two unit vectors are an orthogonal basis of their span.
        """
        cosines = np.matmul(self.units, self.units.transpose(0, 2, 1))
        projections = np.matmul(self.units, self.left[..., np.newaxis])[..., 0]
        own, other = projections[:, :, np.newaxis], projections[:, np.newaxis]
        total = np.zeros(cosines.shape[1:])
        for sign in (1.0, -1.0):
            squares = 2 + 2 * sign * cosines
            near = np.nonzero(squares < 1e-6)
            squares[near] = np.sum((self.units[near[0], near[1]] + sign * self.units[near[0], near[2]]) ** 2, axis=-1)
            both = (own + sign * other) ** 2
            total += np.divide(both, squares, out=np.zeros_like(both), where=squares > _MIN_NORM**2).sum(axis=0)
        return total
