"""Coefficients of objects that learn from each other, drawn to their mean as far as the objects are alike."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.hierarchy import shrink
from commonlaw.law.provenance import Step
from commonlaw.law.uncertainty import OwnEstimates, Uncertainty

_ALIKE, _OWN = 0.9, 0.1
"""Shrinkage above which coefficients count as alike in words, and below which as specific to the object."""


def partially_pooled(
    coefficients: Floats, uncertainty: Uncertainty, support: Bools, universal: Bools | None, others: bool
) -> tuple[Floats, Uncertainty, Floats] | None:
    """Return coefficients drawn to their means over objects; None where nothing is to be drawn.

    Beside them their uncertainty, and how far each was drawn, from 0 to 1, shape (equations, terms). The arguments are
    those of `Law.partial_pooling`.
    """
    covariance = uncertainty.known_covariance()
    if uncertainty.shared_factor is not None:
        raise CommonlawError("the coefficients of this law are pooled already")
    shared = np.zeros_like(support) if universal is None else universal
    # What is known, or what an object does not have, has no variance
    free = np.all(np.diagonal(covariance, axis1=1, axis2=2) > 0, axis=0)
    if len(coefficients) == 1 or not free.any() or not (others or shared.any()):
        return None
    indices = np.argwhere(support)[free].T
    variances = np.where(shared[support][free], 0.0, np.nan if others else np.inf)
    found = shrink(coefficients[:, *indices], covariance[:, free][:, :, free], variances)
    pooled, errors, factor = coefficients.copy(), covariance.copy(), np.zeros_like(covariance)
    inner = np.ix_(np.arange(len(coefficients)), free, free)
    pooled[:, *indices], errors[inner], factor[inner] = found.estimates, found.covariances, found.shared_factors
    shrinkage = np.zeros(support.shape)
    shrinkage[*indices] = found.shrinkage
    own = OwnEstimates(coefficients[:, support], covariance)
    return pooled, replace(uncertainty, covariance=errors, shared_factor=factor, unpooled=own), shrinkage


def pooling_step(equations: Sequence[str], terms: Sequence[str], support: Bools, shrinkage: Floats) -> Step:
    """Return what was drawn how far, for the history of a law; names, and arrays of shape (equations, terms)."""
    words = []
    for equation, term in np.argwhere(support):
        share = shrinkage[equation, term]
        how = "alike" if share > _ALIKE else "specific to the object" if share < _OWN else "partly alike"
        words.append(f"{terms[term]} in {equations[equation]}: {how} ({share:.2f})")
    reason = "how far each object's coefficient is drawn to the mean of all, by how much these scatter beyond errors"
    return Step("pooling", "; ".join(words), reason)
