"""Least squares over all objects together, where they have some coefficients in common.

Of each object the columns of its own coefficients are eliminated by QR factorization (variable projection; Golub and
Pereyra 1973, SIAM J. Numer. Anal. 10, 413). What is left of the columns of shared coefficients, of all objects,
determines these.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.formulation import LeastSquaresProblem, merge
from commonlaw.likelihood import Regression


def maximum(factors: Sequence[Floats], free: Sequence[Bools], shared: Bools | None) -> list[Floats]:
    """Return the coefficients of each object that minimize the squares of all, each of the shape of a mask.

    Factors are rows ``[columns | target]`` of the `free` coefficients of an object; the `shared` ones are the same for
    all objects, shape (equations, terms).
    """
    if shared is None:
        shared = np.zeros_like(free[0])
    problems, count = list[LeastSquaresProblem](), int(shared.sum())
    for separate, common, factor in _split(factors, free, shared):
        whole = LeastSquaresProblem.of(np.column_stack([separate, common]), factor[:, -1:]).factor
        problems.append(LeastSquaresProblem(whole[separate.shape[1] :, separate.shape[1] :], count, len(factor)))
    values = merge(problems).least_squares(np.ones(count, dtype=np.bool_), 0)
    result = list[Floats]()
    for (separate, common, factor), mask in zip(_split(factors, free, shared), free, strict=True):
        rest = LeastSquaresProblem.of(separate, factor[:, -1:] - (common @ values)[:, np.newaxis])
        coefficients = np.zeros(mask.shape)
        coefficients[shared] = values
        coefficients[mask & ~shared] = rest.least_squares(np.ones(separate.shape[1], dtype=np.bool_), 0)
        result.append(np.where(mask, coefficients, 0.0))
    return result


def leverage(regressions: Sequence[Regression], free: Sequence[Bools], shared: Bools) -> Floats:
    """Return the trace of the hat matrix over the measurements of each state of each object, shape (objects, d).

    With orthonormal bases W of the columns it is ``tr(W_o' Q_o' Q_o W_o)``, see `Regression`.
    """
    triangles = [regression.factor[:-1, :-1] for regression in regressions]
    result, bases, remainders = list[Floats](), list[Floats](), list[Floats]()
    for separate, common, _ in _split(triangles, free, shared, targets=0):
        basis = _basis(separate)
        bases.append(basis)
        remainders.append(common - basis @ (basis.T @ common))
    ends = np.cumsum([len(rest) for rest in remainders])[:-1]
    in_common = np.split(_basis(np.concatenate(remainders)), ends)
    for regression, basis, of_shared in zip(regressions, bases, in_common, strict=True):
        columns = np.column_stack([basis, of_shared])
        result.append(regression.of_starts + np.einsum("pi,dpq,qi->d", columns, regression.projected, columns))
    return np.array(result)


def _split(
    factors: Sequence[Floats], free: Sequence[Bools], shared: Bools, targets: int = 1
) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Yield the columns of own and of shared coefficients of each object, zero for those it lacks, and its factor."""
    places = np.cumsum(shared).reshape(shared.shape) - 1
    for factor, mask in zip(factors, free, strict=True):
        columns, is_shared = factor[:, : factor.shape[1] - targets], shared[mask]
        common = np.zeros((len(factor), int(shared.sum())))
        common[:, places[mask & shared]] = columns[:, is_shared]
        yield columns[:, ~is_shared], common, factor


def _basis(columns: Floats) -> Floats:
    """Return an orthonormal basis of columns, without those that depend on others before them."""
    norms = np.linalg.norm(columns, axis=0)
    basis, triangle = np.linalg.qr(columns / np.where(norms > 0, norms, 1.0))
    is_new = np.abs(np.diagonal(triangle)) > 1e-10
    return np.asarray(basis[:, is_new])
