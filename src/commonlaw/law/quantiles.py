"""Quantiles of what is not known exactly: Student's t distributions, and mixtures of them with values that are certain.

Where noise was estimated from few measurements, errors divided by it follow Student's t distribution, with as many
degrees of freedom as the estimate has; where it was given they are normal.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError

_HALVINGS = 50
"""Of the interval that a quantile is in: to the last digits of its width."""


def two_sided(level: float, degrees_of_freedom: ArrayLike = np.inf) -> Floats:
    """Return how many standard errors on both sides hold this share, of the shape of the degrees of freedom.

    >>> two_sided(0.95, [np.inf, 30, 5]).round(2).tolist()
    [1.96, 2.04, 2.57]
    """
    if not 0 < level < 1:
        raise CommonlawError("level-range", level=level)
    return _quantile((1 + level) / 2, np.asarray(degrees_of_freedom, dtype=np.float64))


def mixture_interval(
    weights: Floats, centers: Floats, scales: Floats, degrees_of_freedom: ArrayLike, level: float
) -> tuple[Floats, Floats]:
    """Return the ends between which this share of a mixture lies, as much below as above, each of shape (...).

    Weights, centers, scales and degrees of freedom of the parts, Student's t distributions, broadcast to (k, ...). A
    part of scale zero is a certain value; one without weight may be NaN. A coefficient that is 2.0 ± 0.1, and zero
    with a probability of one tenth:

    >>> low, high = mixture_interval(np.array([0.9, 0.1]), np.array([2.0, 0.0]), np.array([0.1, 0.0]), np.inf, 0.95)
    >>> print(low.round(2), high.round(2))
    0.0 2.19
    """
    reach = two_sided(level, degrees_of_freedom)
    shape = np.broadcast_shapes(np.shape(weights), centers.shape, scales.shape, reach.shape)
    given = (np.broadcast_to(each, shape) for each in (weights, centers, scales, degrees_of_freedom))
    share, center, scale, degrees = given
    there = share > 0
    center, scale = np.where(there, center, np.nan), np.where(there, scale, 0.0)

    def below(values: Floats) -> Floats:
        """Return the share of the mixture at and below values, shape (...)."""
        with np.errstate(invalid="ignore", divide="ignore"):
            far = np.where(scale > 0, (values - center) / scale, np.where(values >= center, np.inf, -np.inf))
        return np.asarray(np.sum(np.where(there, share * _cumulative(far, degrees), 0.0), axis=0))

    half, alone = reach * scale, there.sum(axis=0) == 1
    ends = []
    for sign in (-1.0, 1.0):
        # A quantile of the mixture lies between those of its parts
        own = center + sign * half
        low, high = np.fmin.reduce(own), np.fmax.reduce(own)
        wanted = (1 + sign * level) / 2
        found = high if alone.all() else np.where(alone, high, _bisected(below, low, high, wanted))
        certain = np.where(scale > 0, np.nan, center)
        near = abs(certain - found) <= 1e-9 * (high - low)
        with np.errstate(invalid="ignore"):
            ends.append(np.where(near.any(axis=0), np.nansum(np.where(near, certain, 0.0), axis=0), found))
    return ends[0], ends[1]


def upper_bound(center: ArrayLike, scale: ArrayLike, degrees_of_freedom: ArrayLike, level: float) -> Floats:
    """Return what the size of a number stays below with this probability, by Student's t about an estimate.

    >>> upper_bound([0.0, 5.0], 1.0, np.inf, 0.95).round(2).tolist()
    [1.96, 6.64]
    """
    reach = two_sided(level, degrees_of_freedom)
    middle, width, degrees = np.broadcast_arrays(np.asarray(center), np.asarray(scale), degrees_of_freedom)
    if not np.any(width):
        return np.asarray(np.abs(middle))

    def below(values: Floats) -> Floats:
        return _cumulative((values - middle) / width, degrees) - _cumulative((-values - middle) / width, degrees)

    return _bisected(below, np.zeros_like(middle, dtype=np.float64), np.abs(middle) + reach * width, level)


def _bisected(below: Callable[[Floats], Floats], low: Floats, high: Floats, wanted: float) -> Floats:
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        less = below(middle) < wanted
        low, high = np.where(less, middle, low), np.where(less, high, middle)
    return np.asarray((low + high) / 2)


def _quantile(share: float, degrees: Floats) -> Floats:
    from scipy.special import ndtri, stdtrit

    finite = np.where(np.isfinite(degrees), degrees, 1.0)
    return np.asarray(np.where(np.isfinite(degrees), stdtrit(finite, share), ndtri(share)))


def _cumulative(values: Floats, degrees: Floats) -> Floats:
    from scipy.special import ndtr, stdtr

    if np.isinf(degrees).all():
        return np.asarray(ndtr(values))
    finite = np.where(np.isfinite(degrees), degrees, 1.0)
    return np.asarray(np.where(np.isfinite(degrees), stdtr(finite, values), ndtr(values)))
