"""The evidence for terms that objects share: what their coefficients cost, given how alike they are.

A coefficient that every object has is seen as drawn from a normal distribution over objects, whose mean and standard
deviation are estimated with it (empirical Bayes; Efron and Morris 1973). Terms whose coefficients are all alike, such
as gravity, then cost little more than one number; terms whose coefficients scatter cost one number for each object.
For a single object the evidence is the BIC.
"""

from math import lgamma

import numpy as np

from commonlaw.array_types import Floats, Indices

_VARIANCES = np.concatenate([[0.0], 10.0 ** np.arange(-4, 2.1, 0.5)])
"""Variances over objects that are tried, relative to the mean square of a coefficient."""

_SWEEPS = 2
"""How often each variance is chosen again, given the others."""

_NEAR = 1e-12
"""Columns whose square is less than this share outside the span of others have too few digits there."""

_RIDGE = 1e-12
"""Of a mean that the data do not tell, relative to the others."""


def log_evidence(factors: Floats, indices: Indices, measured: int, least: float = np.inf) -> float:
    """Return minus twice the logarithm of the evidence for a support of one equation that all objects share.

    Parameters
    ----------
    factors
        The triangular factor of each object's system, which has one target and residuals of unit variance, shape
        (objects, terms + 1, terms + 1).
    indices
        The terms of the support.
    measured
        How many numbers were measured on all objects; a mean costs the logarithm of that, and a variance the logarithm
        of the number of objects (the BIC of the hierarchy).
    least
        Supports that do not come below this get a lower bound of theirs, which takes less time.
    """
    size = len(indices)
    reduced = np.asarray(np.linalg.qr(factors[:, :, [*indices, -1]], mode="r"))
    floor = float(np.sum(reduced[:, size:, size] ** 2)) + price(size, len(factors), measured)
    if not size or floor >= least:
        return floor
    norms = np.sqrt(np.mean(np.sum(reduced[:, :size, :size] ** 2, axis=1), axis=0))
    columns = reduced[:, :size, :size] / np.where(norms > 0, norms, 1.0)
    try:
        estimates = np.linalg.solve(columns, reduced[:, :size, size:])[..., 0]
        return floor + _scatter(np.matmul(columns.transpose(0, 2, 1), columns), estimates)
    except np.linalg.LinAlgError:
        return np.inf


def price(size: int, objects: int, measured: int) -> float:
    """Return what the means and variances of so many coefficients cost, see `log_evidence`."""
    return float(size * (np.log(measured) + np.log(objects)))


def residuals(factors: Floats, indices: Indices) -> Floats:
    """Return the sums of squared residuals of a support with each one of the other terms, and last with none.

    Shape (terms + 1,). Where a term is inside, or so near to those inside that the sum would not be exact, this is
    zero, a lower bound.
    """
    basis, _ = np.linalg.qr(factors[:, :, indices])
    rest = factors - np.matmul(basis, np.matmul(basis.transpose(0, 2, 1), factors))
    before, after = np.sum(factors**2, axis=1), np.sum(rest**2, axis=1)
    inner = np.einsum("opt,op->ot", rest, rest[..., -1])
    inner[:, -1] = 0.0
    clear = after > _NEAR * before
    left = after[:, -1:] - np.divide(inner**2, after, out=np.zeros_like(inner), where=clear)
    return np.asarray(np.sum(np.where(clear, left, 0.0), axis=0))


def log_choices(library: int, size: int) -> float:
    """Return the logarithm of the number of ways to choose so many terms from a library (as in the EBIC)."""
    return lgamma(library + 1) - lgamma(size + 1) - lgamma(library - size + 1)


def _scatter(information: Floats, estimates: Floats) -> float:
    """Return what coefficients cost: the least over the variances, coefficient by coefficient.

    Parameters
    ----------
    information
        On each object's coefficients, shape (objects, k, k).
    estimates
        Of the coefficients, shape (objects, k).
    """
    scale = np.maximum(np.mean(estimates**2, axis=0), np.finfo(float).tiny)
    variances, best = scale.copy(), np.inf
    for _ in range(_SWEEPS if len(estimates) > 1 else 0):
        before = variances.copy()
        for j in range(len(scale)):
            tried = np.tile(variances, (len(_VARIANCES), 1))
            tried[:, j] = _VARIANCES * scale[j]
            costs = _costs(information, estimates, tried)
            variances, best = tried[np.argmin(costs)], float(np.min(costs))
        if np.array_equal(before, variances):
            break
    return best if len(estimates) > 1 else 0.0


def _costs(information: Floats, estimates: Floats, variances: Floats) -> Floats:
    """Return minus twice the log-evidence of estimates for several variances, shape (several, k), at the best means."""
    size = estimates.shape[1]
    spread = np.sqrt(variances)[:, np.newaxis]
    right = information * spread[:, :, np.newaxis, :]
    inner = np.eye(size) + spread[..., np.newaxis] * right
    factor = np.linalg.cholesky((inner + inner.swapaxes(-1, -2)) / 2)
    volume = 2 * np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(axis=(-1, -2))
    precision = information - np.matmul(right, np.linalg.solve(inner, right.swapaxes(-1, -2)))
    pulled = np.matmul(precision, estimates[..., np.newaxis])[..., 0]
    total, pull = precision.sum(axis=1), pulled.sum(axis=1)
    total = total + _RIDGE * np.trace(total, axis1=1, axis2=2)[:, np.newaxis, np.newaxis] * np.eye(size) / size
    means = np.linalg.solve(total, pull[..., np.newaxis])[..., 0]
    return np.asarray(np.einsum("ok,mok->m", estimates, pulled) - np.einsum("mk,mk->m", means, pull) + volume)
