"""How sure coefficients and terms are."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from commonlaw.inference.objects import Objects
from commonlaw.inference.search import Found
from commonlaw.likelihood import expand

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]
Rivals = Sequence[Sequence[tuple[Bools, float]]]


def covariances(objects: Objects, law: Found) -> Floats:
    """Return each object's covariance of its coefficients, shape (objects, parameters, parameters).

    Parameters are the coefficients that are not zero for some object, in the order of `numpy.argwhere`. Those that are
    known, or zero for an object, have no variance (inverse of Fisher's information, with free initial states).
    """
    coefficients = np.array([each.coefficients for each in law.estimates])
    support = np.any(coefficients != 0, axis=0)
    found = np.zeros((len(law.estimates), support.sum(), support.sum()))
    for o, (problem, estimate) in enumerate(zip(objects.problems, law.estimates, strict=True)):
        free = (estimate.coefficients != 0) & np.isnan(objects.known[o])
        places = np.flatnonzero(free[support])
        system = expand(problem, estimate, law.finest).system.restrict(np.flatnonzero(free).tolist())
        found[o][np.ix_(places, places)] = _inverse(system.factor[:, :-1])
    return found


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
