"""Coefficients of objects that learn from each other, drawn to their mean as far as the objects are alike."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.hierarchy import informative, shrink
from commonlaw.law.provenance import Step
from commonlaw.law.uncertainty import ObjectEstimates, Uncertainty
from commonlaw.outcomes import Outcome, note
from commonlaw.wording import shown

_ALIKE, _OWN = 0.9, 0.1
"""Shrinkage above which coefficients count as alike in words, and below which as specific to the object."""


def partially_pooled(
    coefficients: Floats, uncertainty: Uncertainty, support: Bools, universal: Bools | None, others: bool
) -> tuple[Floats, Uncertainty, Floats, Bools] | None:
    """Return coefficients drawn to their means over objects; None where nothing is to be drawn.

    Beside them their uncertainty, how far each was drawn, from 0 to 1, shape (equations, terms), and which objects were
    pooled, shape (objects,): objects whose trials say nothing of any coefficient, such as blanks among cultures, keep
    their own. The arguments are those of `Law.partial_pooling`.
    """
    covariance = uncertainty.known_covariance()
    if uncertainty.shared_factor is not None:
        raise CommonlawError("already-pooled")
    shared = np.zeros_like(support) if universal is None else universal
    # What is known, or what an object does not have, has no variance
    free = np.all(np.diagonal(covariance, axis1=1, axis2=2) > 0, axis=0)
    if len(coefficients) == 1 or not free.any() or not (others or shared.any()):
        return None
    indices = np.argwhere(support)[free].T
    told: Bools = np.ones(len(coefficients), dtype=np.bool_)
    if not shared.any():
        variances = np.diagonal(covariance, axis1=1, axis2=2)[:, free]
        told = np.asarray(informative(coefficients[:, *indices], variances).any(axis=1))
    variances = np.where(shared[support][free], 0.0, np.nan if others else np.inf)
    if told.sum() < 2:
        return None
    found = shrink(coefficients[told][:, *indices], covariance[told][:, free][:, :, free], variances)
    pooled, errors, factor = coefficients.copy(), covariance.copy(), np.zeros_like(covariance)
    inner = np.ix_(told, free, free)
    pooled[np.flatnonzero(told)[:, np.newaxis], *indices] = found.estimates
    errors[inner], factor[inner] = found.covariances, found.shared_factors
    shrinkage = np.zeros(support.shape)
    shrinkage[*indices] = found.shrinkage
    own = ObjectEstimates(coefficients[:, support], covariance)
    return (
        pooled,
        replace(uncertainty, covariance=errors, shared_factor=factor, unpooled=own, pooled=None),
        shrinkage,
        told,
    )


def pooling_step(equations: Sequence[str], terms: Sequence[str], support: Bools, shrinkage: Floats) -> Step:
    """Return what was drawn how far, for the history of a law; names, and arrays of shape (equations, terms)."""
    words = []
    for equation, term in np.argwhere(support):
        share = shrinkage[equation, term]
        how = "alike" if share > _ALIKE else "specific to the object" if share < _OWN else "partly alike"
        words.append(f"{terms[term]} in {equations[equation]}: {how} ({share:.2f})")
    reason = "how far each object's coefficient is drawn to the mean of all, by how much these scatter beyond errors"
    return Step("pooling", "; ".join(words), reason)


def not_pooled(objects: Sequence[str], told: Bools) -> tuple[Outcome, ...]:
    """Return that objects were not pooled, as their trials say nothing of their coefficients."""
    left = [name for name, own in zip(objects, told, strict=True) if not own]
    if not left:
        return ()
    return (note("not-pooled", objects=shown(left, "object")),)
