"""Laws of fewer objects, of their mean, and of objects that learn from each other."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.law.history import Step
from commonlaw.law.pooling import pool
from commonlaw.law.uncertainty import covariance_of

if TYPE_CHECKING:
    from commonlaw.law.law import Law


_ALIKE, _OWN = 0.9, 0.1
"""Shrinkage above which coefficients count as alike in words, and below which as each object's own."""


def average(law: "Law") -> "Law":
    """Return the law of the mean object, see `Law.average`."""
    count, covariance = len(law.objects), law.covariance
    if covariance is not None:
        own, shared = covariance.sum(axis=0), 0.0
        if law.common is not None:
            own = own - np.matmul(law.common, law.common.transpose(0, 2, 1)).sum(axis=0)
            shared = law.common.sum(axis=0) @ law.common.sum(axis=0).T
        covariance = (own + shared)[np.newaxis] / count**2
    mean = law.coefficients.mean(axis=0, keepdims=True)
    return _of_others(law, ("average",), mean, covariance, None)


def select(law: "Law", objects: Sequence[str]) -> "Law":
    """Return the law of some objects, see `Law.select`."""
    indices = [law.index(name) for name in objects]
    covariance = None if law.covariance is None else law.covariance[indices]
    common = None if law.common is None else law.common[indices]
    return _of_others(law, tuple(objects), law.coefficients[indices], covariance, common)


def pooled(law: "Law", universal: Bools | None = None, others: bool = True) -> "Law":
    """Return the law with coefficients drawn to their means, see `Law.pooled`.

    Parameters
    ----------
    law
        The law.
    universal
        Coefficients that all objects have in common, shape (equations, terms).
    others
        Whether the other coefficients are drawn to their means.

    Raises
    ------
    CommonlawError
        If the law does not know how accurate its coefficients are, or is pooled already.
    """
    covariance = covariance_of(law)
    if law.common is not None:
        raise CommonlawError("the coefficients of this law are pooled already")
    shared = np.zeros_like(law.support) if universal is None else universal
    # What is known, or what an object does not have, has no variance
    free = np.all(np.diagonal(covariance, axis1=1, axis2=2) > 0, axis=0)
    if len(law.objects) == 1 or not free.any() or not (others or shared.any()):
        return law
    indices = np.argwhere(law.support)[free].T
    variances = np.where(shared[law.support][free], 0.0, np.nan if others else np.inf)
    found = pool(law.coefficients[:, *indices], covariance[:, free][:, :, free], variances)
    coefficients, errors, common = law.coefficients.copy(), covariance.copy(), np.zeros_like(covariance)
    inner = np.ix_(np.arange(len(law.objects)), free, free)
    coefficients[:, *indices], errors[inner], common[inner] = found.estimates, found.covariances, found.common
    shrinkage = np.zeros(law.support.shape)
    shrinkage[*indices] = found.shrinkage
    step = _step(law, shrinkage)
    return replace(law, coefficients=coefficients, covariance=errors, common=common, history=(*law.history, step))


def _step(law: "Law", shrinkage: Floats) -> Step:
    words = []
    for equation, term in np.argwhere(law.support):
        share = shrinkage[equation, term]
        how = "alike" if share > _ALIKE else "each its own" if share < _OWN else "partly alike"
        words.append(f"{law.terms.names[term]} in {law.left_hand_sides[equation]}: {how} ({share:.2f})")
    reason = "how far each object's coefficient is drawn to the mean of all, by how much these scatter beyond errors"
    return Step("pooling", "; ".join(words), reason)


def _of_others(
    law: "Law", objects: tuple[str, ...], coefficients: Floats, covariance: Floats | None, common: Floats | None
) -> "Law":
    """Return a law of other objects, their covariance still for the terms that are in the given law."""
    left = np.any(coefficients != 0, axis=0)[law.support]
    covariance, common = (None if each is None else each[:, left][:, :, left] for each in (covariance, common))
    return replace(law, objects=objects, coefficients=coefficients, covariance=covariance, common=common)
