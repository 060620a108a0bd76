"""Compressed least-squares problems: merged, solved on any support, and factorised from rows."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.runtime.forking import cached_property


def explained(factors: Floats, inside: Indices, near: float, *, bound: bool = False) -> Floats:
    """Return by how much columns lower the residual sum of squares of those inside, and last that sum, (columns,).

    Factors are rows ``[columns | target]`` of each object, shape (objects, rows, columns). Columns of which those
    inside leave a smaller share of the squares than `near` have too few digits: they explain nothing, or with `bound`
    everything, which bounds the residual from below.
    """
    basis, _ = np.linalg.qr(factors[:, :, inside])
    rest = factors - np.matmul(basis, np.matmul(basis.transpose(0, 2, 1), factors))
    before, after = np.sum(factors**2, axis=1), np.sum(rest**2, axis=1)
    inner, residual = np.einsum("opt,op->ot", rest, rest[..., -1]), after[:, -1:]
    clear = after > near * before
    clear[:, inside] = False
    lowered = np.divide(inner**2, after, out=np.zeros_like(inner), where=clear)
    reductions = np.where(clear, lowered, residual if bound else 0.0)
    return np.asarray(np.append(reductions[:, :-1].sum(axis=0), residual.sum()))


BLOCK = 1024
"""Rows that are absorbed together."""

_SINGULAR = 1e-14
"""Columns, scaled to unit norm, whose reciprocal condition is below this depend on each other."""


@dataclass(frozen=True, eq=False)
class LeastSquaresProblem:
    """Regression rows ``[library | targets]`` compressed to their triangular factor.

    Least squares on it equals least squares on all rows to rounding, for every subset of the terms: rows are ``Q @
    factor`` with orthonormal ``Q``, so inner products of columns are those of the factor (Golub and Van Loan, Matrix
    Computations, section 5.3). Householder reflections keep errors small column by column, so that badly scaled
    libraries lose nothing. Problems of the same library merge with ``+``.

    Parameters
    ----------
    factor
        Upper triangular factor of the rows, shape (terms + targets, terms + targets).
    terms
        Number of library columns; the rest are targets, one for each equation.
    rows
        Number of rows that were compressed.

    Examples
    --------
    >>> import numpy as np
    >>> library, targets = np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]), np.array([[1.0], [3.0], [5.0]])
    >>> LeastSquaresProblem.of(library, targets).least_squares(np.array([True, True]), target=0).round(6)
    array([1., 2.])
    """

    factor: Floats
    terms: int
    rows: int

    @classmethod
    def of(cls, library: Floats, targets: Floats, weights: Floats | None = None) -> "LeastSquaresProblem":
        """Compress library rows, shape (n, terms), targets, (n, targets), and how often each counts, (n,)."""

        def blocks() -> Iterator[Floats]:
            for some in (slice(i, i + BLOCK) for i in range(0, len(library), BLOCK)):
                rows = np.asfortranarray(np.concatenate([library[some], targets[some]], axis=1))
                if weights is not None:
                    rows *= np.sqrt(weights[some])[:, np.newaxis]
                yield rows

        return cls.of_blocks(blocks(), library.shape[1], library.shape[1] + targets.shape[1])

    @classmethod
    def of_blocks(cls, blocks: Iterable[Floats], terms: int, columns: int) -> "LeastSquaresProblem":
        """Compress rows in blocks of shape (n, columns), in memory that does not grow with their number.

        A block ``[library | targets]`` is used as workspace: its values are lost.
        """
        factor, rows = np.zeros((columns, columns), order="F"), 0
        for block in blocks:
            factor, rows = _absorb(factor, block, workspace=True), rows + len(block)
        return cls(factor, terms, rows)

    def __add__(self, other: "LeastSquaresProblem") -> "LeastSquaresProblem":
        return merge((self, other))

    @property
    def targets(self) -> int:
        """Number of equations."""
        return int(self.factor.shape[1]) - self.terms

    @cached_property
    def norms(self) -> Floats:
        """Euclidean norms of the library columns over all rows, shape (terms,)."""
        return column_norms(self.factor[:, : self.terms])

    def weighted(self, weight: float) -> "LeastSquaresProblem":
        """Return the problem in which each row counts `weight` times."""
        return LeastSquaresProblem(self.factor * np.sqrt(weight), self.terms, self.rows)

    def restrict(self, indices: Sequence[int]) -> "LeastSquaresProblem":
        """Return the problem of the terms at these indices only."""
        kept = [*indices, *range(self.terms, len(self.factor))]
        return LeastSquaresProblem(_absorb(np.zeros((len(kept),) * 2), self.factor[:, kept]), len(indices), self.rows)

    def least_squares(self, support: Bools, target: int, ridge: float = 0.0) -> Floats:
        """Return the coefficients that minimize ``||library c - target||^2 + ridge ||c||^2``.

        Collinear columns get the coefficients of least norm, for columns of unit norm (see `condition`). Only terms in
        `support`, shape (terms,), are used, all others get zero; `target` is the equation.
        """
        from scipy.linalg import lapack

        coefficients = np.zeros(self.terms)
        indices = np.flatnonzero(support)
        if not len(indices):
            return coefficients
        last = indices[-1] + 1  # Rows below are zero in all of these columns
        matrix, right = self.factor[:last, indices], self.factor[:last, self.terms + target]
        norms = self.norms[indices]
        scales = np.where(norms > 0, norms, 1.0)
        matrix /= scales
        if ridge:
            matrix = np.concatenate([matrix, np.diag(np.sqrt(ridge) / scales)])
            right = np.concatenate([right, np.zeros(len(scales))])
        reduced = np.column_stack([matrix, right])
        if ridge or len(indices) < last:  # Else it is triangular
            reduced, _, _, _ = lapack.dgeqrf(reduced)
        triangle = reduced[: len(scales)]
        if lapack.dtrcon(triangle[:, :-1])[0] > _SINGULAR:
            coefficients[indices] = lapack.dtrtrs(triangle[:, :-1], triangle[:, -1])[0] / scales
        else:
            coefficients[indices] = np.linalg.lstsq(matrix, right, rcond=_SINGULAR)[0] / scales
        return coefficients

    def condition(self, support: Bools) -> float:
        """Return the 2-norm condition number of the columns of `support`, each scaled to unit norm."""
        norms = self.norms[support]
        matrix = self.factor[:, : self.terms][:, support] / np.where(norms > 0, norms, 1.0)
        return float(np.linalg.cond(matrix)) if matrix.shape[1] else 1.0

    def rss(self, coefficients: Floats, target: int) -> float:
        """Return the sum of squared residuals of one equation for its coefficients, shape (terms,)."""
        residuals = self.factor[:, : self.terms] @ coefficients - self.factor[:, self.terms + target]
        return float(residuals @ residuals)

    def tss(self, target: int) -> float:
        """Return the total sum of squares of one target."""
        return self.rss(np.zeros(self.terms), target)

    def subtract(self, coefficients: Floats) -> "LeastSquaresProblem":
        """Return the problem whose targets are what these coefficients, shape (targets, terms), leave unexplained."""
        factor = self.factor.copy()
        factor[:, self.terms :] -= factor[:, : self.terms] @ coefficients.T
        return LeastSquaresProblem(factor, self.terms, self.rows)


def least_squares_of_each(problems: Sequence[LeastSquaresProblem], support: Bools, target: int) -> Floats:
    """Return the coefficients of several problems on one support, see `least_squares`, shape (problems, terms)."""
    columns = np.append(np.flatnonzero(support), problems[0].terms + target)
    if len(problems) > 1 and len(columns) > 1:
        rows = np.array([problem.factor[:, columns] for problem in problems])
        norms = column_norms(rows[:, :, :-1])
        scales = np.where(norms > 0, norms, 1.0)
        rows[:, :, :-1] /= scales[:, np.newaxis]
        reduced = np.asarray(np.linalg.qr(rows, mode="r"))[:, : len(columns) - 1]
        triangles = reduced[:, :, :-1]
        if np.all(np.linalg.cond(triangles, 1) * _SINGULAR < 1):
            result = np.zeros((len(problems), len(support)))
            result[:, support] = np.linalg.solve(triangles, reduced[:, :, -1:])[..., 0] / scales
            return result
    return np.array([problem.least_squares(support, target) for problem in problems])


SQUARED_RANGE = 1e-140, 1e150
"""Between these norms the squares of columns neither overflow nor lose digits."""


def column_scales(columns: Floats) -> Floats:
    """Return what columns, shape (n, k), are divided by to have unit norm, shape (k,): 1 where all values are zero."""
    norms = column_norms(columns)
    return np.where(norms == 0, 1.0, norms)


def symmetric_root(matrices: Floats) -> Floats:
    """Return R with ``C = R R'`` for a covariance or information C, both of shape (..., p, p).

    It is D S with the standard deviations D and the symmetric root S of the correlations, so that units of the numbers
    do not matter, nor the signs of eigenvectors, which differ between processors. What rounding leaves of eigenvalues
    below zero, or next to it, is zero.
    """
    std = np.sqrt(np.maximum(np.diagonal(matrices, axis1=-2, axis2=-1), 0.0))
    scales = np.where(std > 0, std, 1.0)
    values, vectors = np.linalg.eigh(matrices / scales[..., np.newaxis] / scales[..., np.newaxis, :])
    values = np.where(values > 1e-14 * values.max(axis=-1, initial=0.0, keepdims=True), values, 0.0)
    roots = (vectors * np.sqrt(values)[..., np.newaxis, :]) @ np.swapaxes(vectors, -1, -2)
    return np.asarray(std[..., np.newaxis] * roots)


def inverse_information(rows: Floats) -> Floats:
    """Return the pseudoinverse of ``rows' rows``, shape (p, p), of columns in any units."""
    scales = column_scales(rows)
    return np.asarray(np.linalg.pinv((rows / scales).T @ (rows / scales)) / scales / scales[:, np.newaxis])


def column_norms(columns: Floats) -> Floats:
    """Return the Euclidean norms of columns, from shape (..., n, k) to (..., k), also where their squares overflow."""
    with np.errstate(over="ignore"):
        norms = np.asarray(np.linalg.norm(columns, axis=-2))
    largest = np.abs(columns).max(axis=-2, initial=0.0)
    extreme = (largest > 0) & np.isfinite(largest) & ~((norms > SQUARED_RANGE[0]) & (norms < SQUARED_RANGE[1]))
    if extreme.any():
        with np.errstate(over="ignore"):  # In the columns whose norms are kept
            scaled = np.linalg.norm(columns / np.where(extreme, largest, 1.0)[..., np.newaxis, :], axis=-2)
        norms[extreme] = (largest * scaled)[extreme]
    return norms


def merge(problems: Iterable[LeastSquaresProblem]) -> LeastSquaresProblem:
    """Return the problem of the rows of all of these, of which there is at least one."""
    first, *others = problems
    factor, together = first.factor, max(1, BLOCK // len(first.factor))
    for i in range(0, len(others), together):
        factor = _absorb(factor, np.concatenate([problem.factor for problem in others[i : i + together]]))
    return LeastSquaresProblem(factor, first.terms, first.rows + sum(problem.rows for problem in others))


def redrawn(problems: Sequence[LeastSquaresProblem], counts: Floats) -> LeastSquaresProblem:
    """Return the problem with so many copies of each of several problems, shape (problems,)."""
    drawn = merge(problem.weighted(count) for problem, count in zip(problems, counts, strict=True) if count)
    return replace(drawn, rows=int(counts @ [problem.rows for problem in problems]))


def _absorb(factor: Floats, rows: Floats, *, workspace: bool = False) -> Floats:
    """Return the triangular factor of a triangular factor above more rows, by blocked Householder reflections."""
    from scipy.linalg import lapack

    merged, *_ = lapack.dtpqrt(0, min(8, len(factor)), factor, rows, overwrite_a=workspace, overwrite_b=workspace)
    return np.asarray(merged)
