"""How sure coefficients and terms are."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.inference.objects import Objects
from commonlaw.inference.search import Found
from commonlaw.likelihood import linearize, whitened

Rivals = Sequence[Sequence[tuple[Bools, float]]]
Errors = Literal["likelihood", "bootstrap"]

_BLOCKS = 30
"""Blocks of an object's trials that are drawn: long enough to hold what errors have to do with each other."""

_RESAMPLES = 500
"""So many give standard errors to 3 %."""

_UNTOLD = 1e-12
"""Directions of columns of unit norm that are smaller say nothing."""


def covariances(objects: Objects, law: Found, errors: Errors = "likelihood") -> Floats:
    """Return each object's covariance of its coefficients, shape (objects, parameters, parameters).

    Parameters are the coefficients that are not zero for some object, in the order of `numpy.argwhere`. Those that are
    known, or zero for an object, have no variance.

    Parameters
    ----------
    objects, law
        What was measured, and the law that was found.
    errors
        ``"likelihood"``: the inverse of Fisher's information, with free initial states. ``"bootstrap"``: the scatter of
        coefficients when stretches of the trials are drawn anew, which holds for noise of other kinds too (the
        bootstrap of innovations, Stoffer and Wall 1991, in blocks, and linearised about the law).
    """
    coefficients = np.array([each.coefficients for each in law.estimates])
    support = np.any(coefficients != 0, axis=0)
    found = np.zeros((len(law.estimates), support.sum(), support.sum()))
    for o, (model, estimate) in enumerate(zip(objects.models, law.estimates, strict=True)):
        free = (estimate.coefficients != 0) & np.isnan(objects.known[o])
        indices, inner = np.flatnonzero(free[support]), np.flatnonzero(free)
        if errors == "bootstrap":
            trials = [rows for rows, _ in whitened(model, estimate, law.finest)]
            covariance = bootstrapped(trials, inner)
        else:
            rows = linearize(model, estimate, law.finest).problem
            covariance = _inverse(rows.restrict(inner.tolist()).factor[:, :-1])
        found[o][np.ix_(indices, indices)] = covariance
    return found


def bootstrapped(trials: Sequence[Floats], indices: Indices) -> Floats:
    """Return the covariance of least squares on rows whose blocks are drawn with replacement.

    Parameters
    ----------
    trials
        Rows ``[library | target]`` of each, whitened, shape (n, columns).
    indices
        The columns of the library that are used.
    """
    each = -(-_BLOCKS // len(trials))
    columns = [*indices, -1]
    blocks = [part for rows in trials for part in np.array_split(rows[:, columns], each) if len(part)]
    factors = np.array([LeastSquaresProblem.of(part[:, :-1], part[:, -1:]).factor for part in blocks])
    drawn = np.random.default_rng(0).integers(len(blocks), size=(_RESAMPLES, len(blocks)))
    stacked = factors[drawn].reshape(_RESAMPLES, -1, len(columns))
    norms = np.linalg.norm(np.concatenate(factors), axis=0)
    norms[norms == 0] = 1.0
    reduced, inner = np.asarray(np.linalg.qr(stacked / norms, mode="r")), slice(len(indices))
    # What no drawn block tells is zero
    estimates = np.matmul(np.linalg.pinv(reduced[:, inner, inner], rcond=_UNTOLD), reduced[:, inner, -1:])[..., 0]
    return np.atleast_2d(np.cov(estimates * (norms[-1] / norms[:-1]), rowvar=False))


def inclusion(rivals: Rivals) -> Floats:
    """Return the probability that a term is in its equation, among the supports listed, shape (equations, terms)."""
    supports = ([support for support, _ in listed] for listed in rivals)
    rows = [probabilities(listed) @ np.array(own) for listed, own in zip(rivals, supports, strict=True)]
    return np.clip(rows, 0.0, 1.0)


def probabilities(listed: Sequence[tuple[Bools, float]]) -> Floats:
    """Return how probable each support is among those listed, by its evidence (Kass and Raftery 1995)."""
    lost = np.array([above for _, above in listed])
    weights = np.exp((lost.min() - lost) / 2)
    return np.asarray(weights / weights.sum())


def _inverse(factor: Floats) -> Floats:
    """Return the inverse of ``factor' factor``, shape (k, k), from the factor, whose digits it keeps."""
    norms = np.linalg.norm(factor, axis=0)
    norms[norms == 0] = 1.0
    inverse = np.linalg.pinv(factor / norms, rcond=1e-14) / norms[:, np.newaxis]
    return np.asarray(inverse @ inverse.T)
