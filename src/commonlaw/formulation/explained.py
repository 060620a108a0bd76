"""What further columns explain of a target beside some that are there, of several objects together."""

from ctypes import CDLL

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.kernel import address, kernel


def explained(factors: Floats, inside: Indices, near: float, *, bound: bool = False) -> Floats:
    """Return by how much each column lowers the squares that columns inside leave, and last these squares, (columns,).

    Parameters
    ----------
    factors
        Of each object, any rows ``[columns | target]``, shape (objects, rows, columns).
    inside
        The columns that are there.
    near
        Columns of which those inside leave a smaller share of the squares than this, have too few digits there.
    bound
        Whether they, and those inside, count as if they explained everything, which bounds what is left from below; by
        default they explain nothing.
    """
    library = kernel()
    if library is not None:
        return _compiled(library, factors, inside, near, bound)
    basis, _ = np.linalg.qr(factors[:, :, inside])
    rest = factors - np.matmul(basis, np.matmul(basis.transpose(0, 2, 1), factors))
    before, after = np.sum(factors**2, axis=1), np.sum(rest**2, axis=1)
    inner, left = np.einsum("opt,op->ot", rest, rest[..., -1]), after[:, -1:]
    clear = after > near * before
    clear[:, inside] = False
    found = np.where(clear, np.divide(inner**2, after, out=np.zeros_like(inner), where=clear), left if bound else 0.0)
    return np.asarray(np.append(found[:, :-1].sum(axis=0), left.sum()))


def _compiled(library: CDLL, factors: Floats, inside: Indices, near: float, bound: bool) -> Floats:
    factors, found = np.ascontiguousarray(factors), np.empty(factors.shape[2])
    chosen = np.ascontiguousarray(inside, dtype=np.int64)
    failed = library.commonlaw_explained(
        *factors.shape, address(factors), len(chosen), address(chosen), near, bound, address(found)
    )
    if failed:
        raise MemoryError
    return found
