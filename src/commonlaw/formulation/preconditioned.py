"""Rows compressed by Cholesky factorisation, preconditioned by the rows that came before."""

from dataclasses import dataclass, field

import numpy as np

from commonlaw.array_types import Floats

_PANEL = 64
"""Columns that are solved for together, by the inverse of their part of the factor, which is several times faster than
substitution; all else is products of matrices."""

_NARROW, _STRIP = 64, 24
"""Fewer columns have their Gram matrix by general products, of so many of them with all that follow: half of these
products are not wanted, but those of narrow matrices go twice as fast."""

_LARGEST = 1e4
"""Squared norm of a preconditioned column beyond which the rows so far become the preconditioner. The factor's error
is that much times rounding, at most; the first rows last for ten thousand times as many of their kind."""

_DEPENDENT = 1e-12
"""A column of which so little is left beside those before it, relative to its norm, depends on them."""


@dataclass
class PreconditionedGram:
    """Rows above which stands a triangular factor of earlier ones, as the Gram matrix of rows times its inverse.

    Cholesky factorisation of a Gram matrix squares the condition, unless rows are preconditioned by a factor R of rows
    like them: then the columns of A R^-1 are nearly orthogonal, and the factor of their Gram matrix times R is as
    accurate as by orthogonal transformations (Yamazaki, Tomov and Dongarra 2015, "Mixed-precision Cholesky QR
    factorization and its case studies on multicore CPU with multiple GPUs", section 3). Whether rows are alike is seen
    in the diagonal.

    Parameters
    ----------
    factor
        Upper triangular, shape (k, k), of columns none of which depends on others, see `can_precondition`.
    """

    factor: Floats
    gram: Floats = field(init=False)
    _inverses: list[Floats] = field(init=False)
    _rows: Floats = field(init=False)

    def __post_init__(self) -> None:
        from scipy.linalg import lapack

        size = len(self.factor)
        self.gram, self._rows = np.eye(size, order="F"), np.empty((0, size), order="F")
        self._inverses = [lapack.dtrtri(self.factor[panel, panel])[0] for panel in self._panels]

    def add(self, block: Floats) -> bool:
        """Add rows, shape (n, k) in Fortran order, and say whether it was possible: whether they are like the first."""
        from scipy.linalg import blas

        if self._rows.shape != block.shape:
            self._rows = np.empty(block.shape, order="F")
        rows = self._rows
        rows[:] = block
        for panel, inverse in zip(self._panels, self._inverses, strict=True):
            own, before = rows[:, panel], rows[:, : panel.start]
            if panel.start:
                blas.dgemm(-1.0, before, self.factor[: panel.start, panel], 1.0, own, overwrite_c=True)
            blas.dtrmm(1.0, inverse, own, side=1, overwrite_b=True)
        gram = _gram(rows)
        if not gram.diagonal().max() <= _LARGEST:  # NaN is not, too
            return False
        self.gram += gram
        return True

    @property
    def _panels(self) -> list[slice]:
        return [slice(begin, begin + _PANEL) for begin in range(0, len(self.factor), _PANEL)]

    @property
    def is_full(self) -> bool:
        """Whether these rows had better become the preconditioner of others."""
        return bool(self.gram.diagonal().max() > _LARGEST)

    def joined(self) -> Floats:
        """Return the factor of all rows, shape (k, k)."""
        from scipy.linalg import blas, lapack

        upper, failed = lapack.dpotrf(self.gram)
        assert not failed, "the Gram matrix is the identity and more"
        return np.asarray(blas.dtrmm(1.0, upper, self.factor))


def _gram(rows: Floats) -> Floats:
    """Return the Gram matrix of rows, shape (n, k) in Fortran order, as far as it is above the diagonal."""
    from scipy.linalg import blas

    size = rows.shape[1]
    if size >= _NARROW:
        return np.asarray(blas.dsyrk(1.0, rows, trans=1))
    gram = np.zeros((size, size), order="F")
    for begin in range(0, size, _STRIP):
        end = begin + _STRIP
        gram[begin:end, begin:] = blas.dgemm(1.0, rows[:, begin:end], rows[:, begin:], trans_a=1)
    return gram


def can_precondition(factor: Floats) -> bool:
    """Whether no column of a triangular factor depends on those before it."""
    norms = np.sqrt(np.einsum("ij,ij->j", factor, factor))
    return bool(np.all(np.abs(factor.diagonal()) > _DEPENDENT * norms))
