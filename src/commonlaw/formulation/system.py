"""The sufficient statistics of a least-squares problem."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class System:
    """Regression rows ``[library | targets]`` compressed to their triangular factor.

    Least squares on a System equals least squares on all of its rows to rounding, for every subset of the terms:
    the rows are ``Q @ factor`` with orthonormal ``Q``, so all inner products of columns are those of the factor
    (Golub and Van Loan, Matrix Computations, section 5.3). Systems of the same library merge with ``+``.

    Parameters
    ----------
    factor
        Upper triangular factor of the rows, shape (at most terms + targets, terms + targets).
    terms
        Number of library columns; the rest are targets, one for each equation.
    rows
        Number of rows that were compressed.
    """

    factor: Floats
    terms: int
    rows: int

    @classmethod
    def of(cls, library: Floats, targets: Floats) -> "System":
        """Compress rows.

        Parameters
        ----------
        library
            Values of the candidate terms, shape (n, terms).
        targets
            Values to be explained, shape (n, targets).
        """
        return cls(_triangle(np.concatenate([library, targets], axis=1)), library.shape[1], len(library))

    def __add__(self, other: "System") -> "System":
        """Return the system of both sets of rows."""
        return System(_triangle(np.concatenate([self.factor, other.factor])), self.terms, self.rows + other.rows)

    @property
    def targets(self) -> int:
        """Number of equations."""
        return int(self.factor.shape[1]) - self.terms

    @cached_property
    def norms(self) -> Floats:
        """Euclidean norms of the library columns over all rows, shape (terms,)."""
        return np.asarray(np.linalg.norm(self.factor[:, : self.terms], axis=0))

    def least_squares(self, support: Bools, target: int, ridge: float = 0.0) -> Floats:
        """Return the coefficients that minimise ``||library c - target||^2 + ridge ||c||^2``.

        Columns are scaled to unit norm before factoring; where they depend on each other the scaled coefficients
        of least norm are returned (`condition` tells).

        Parameters
        ----------
        support
            Which terms may be used, shape (terms,); all others get zero.
        target
            The equation.
        ridge
            Weight of the squared norm of the coefficients.
        """
        coefficients = np.zeros(self.terms)
        matrix, scales = self._scaled(support)
        right = self.factor[:, self.terms + target]
        if ridge:
            matrix = np.concatenate([matrix, np.diag(np.sqrt(ridge) / scales)])
            right = np.concatenate([right, np.zeros(len(scales))])
        if len(scales):
            coefficients[support] = np.linalg.lstsq(matrix, right, rcond=None)[0] / scales
        return coefficients

    def condition(self, support: Bools) -> float:
        """Return the 2-norm condition number of the columns of `support`, each scaled to unit norm."""
        matrix, _ = self._scaled(support)
        return float(np.linalg.cond(matrix)) if matrix.shape[1] else 1.0

    def residual(self, coefficients: Floats) -> Floats:
        """Return the sums of squared residuals, shape (targets,), for coefficients of shape (targets, terms)."""
        left = self.factor[:, : self.terms] @ coefficients.T - self.factor[:, self.terms :]
        return np.asarray(np.sum(left**2, axis=0))

    def subtract(self, coefficients: Floats) -> "System":
        """Return the system whose targets are what these coefficients, shape (targets, terms), leave unexplained."""
        factor = self.factor.copy()
        factor[:, self.terms :] -= factor[:, : self.terms] @ coefficients.T
        return System(factor, self.terms, self.rows)

    def _scaled(self, support: Bools) -> tuple[Floats, Floats]:
        norms = self.norms[support]
        scales = np.where(norms > 0, norms, 1.0)
        return self.factor[:, : self.terms][:, support] / scales, scales


def _triangle(rows: Floats) -> Floats:
    """Return the triangular factor of rows by Householder reflections."""
    return np.asarray(np.linalg.qr(rows, mode="r"))
