"""Intervals: quantiles of Student's t distributions and mixtures of them, and of functions of coefficients.

Where noise was estimated from few measurements, errors divided by it follow Student's t distribution, with as many
degrees of freedom as the estimate has; where it was given they are normal.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation import symmetric_root


def two_sided(level: float, degrees_of_freedom: ArrayLike = np.inf) -> Floats:
    """Return how many standard errors on both sides hold this share, of the shape of the degrees of freedom.

    >>> two_sided(0.95, [np.inf, 30, 5]).round(2).tolist()
    [1.96, 2.04, 2.57]
    """
    if not 0 < level < 1:
        raise CommonlawError("level-range", level=level)
    from scipy.special import ndtri, stdtrit

    degrees, share = np.asarray(degrees_of_freedom, dtype=np.float64), (1 + level) / 2
    finite = np.where(np.isfinite(degrees), degrees, 1.0)
    return np.asarray(np.where(np.isfinite(degrees), stdtrit(finite, share), ndtri(share)))


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
    given = (np.broadcast_to(part, shape) for part in (weights, centers, scales, degrees_of_freedom))
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
        quantiles = center + sign * half
        low, high = np.fmin.reduce(quantiles), np.fmax.reduce(quantiles)
        wanted = (1 + sign * level) / 2
        quantile = high if alone.all() else np.where(alone, high, _bisected(below, low, high, wanted))
        certain = np.where(scale > 0, np.nan, center)
        with np.errstate(invalid="ignore"):  # Infinite where a forecast diverges
            near = abs(certain - quantile) <= 1e-9 * (high - low)
        with np.errstate(invalid="ignore"):
            ends.append(np.where(near.any(axis=0), np.nansum(np.where(near, certain, 0.0), axis=0), quantile))
    return ends[0], ends[1]


def upper_bound(center: ArrayLike, scale: ArrayLike, degrees_of_freedom: ArrayLike, level: float) -> Floats:
    """Return what the size of a number stays below with this probability, by Student's t about an estimate.

    >>> [upper_bound([0.0, -5.0], scale, np.inf, 0.95).round(2).tolist() for scale in (1.0, 0.0)]
    [[1.96, 6.64], [0.0, 5.0]]
    """
    reach = two_sided(level, degrees_of_freedom)
    middle, width, degrees = np.broadcast_arrays(np.asarray(center), np.asarray(scale), degrees_of_freedom)
    if not np.any(width):
        return np.asarray(np.abs(middle))

    def below(values: Floats) -> Floats:
        return _cumulative((values - middle) / width, degrees) - _cumulative((-values - middle) / width, degrees)

    return _bisected(below, np.zeros_like(middle, dtype=np.float64), np.abs(middle) + reach * width, level)


def _bisected(below: Callable[[Floats], Floats], low: Floats, high: Floats, wanted: float) -> Floats:
    # To the last digits of the width
    for _ in range(50):
        middle = (low + high) / 2
        less = below(middle) < wanted
        low, high = np.where(less, middle, low), np.where(less, high, middle)
    return np.asarray((low + high) / 2)


def _cumulative(values: Floats, degrees: Floats) -> Floats:
    from scipy.special import ndtr, stdtr

    if np.isinf(degrees).all():
        return np.asarray(ndtr(values))
    finite = np.where(np.isfinite(degrees), degrees, 1.0)
    return np.asarray(np.where(np.isfinite(degrees), stdtr(finite, values), ndtr(values)))


Function = Callable[[Floats], Floats]
"""Takes coefficients, shape (n, p), and returns values, shape (n,), NaN outside of its domain."""


class Estimate(NamedTuple):
    """A value with its standard error and the ends of its interval; an end is infinite where there is none."""

    value: float
    error: float
    low: float
    high: float


def propagated(function: Function, coefficients: Floats, covariance: Floats | None, reach: float) -> Estimate:
    r"""Return the value of a function of coefficients, with its standard error and interval.

    The error is that of the delta method, the root of :math:`g^T C g` with the gradient g. The interval has the values
    that the function takes in the ellipsoid :math:`(\theta - \hat\theta)^T C^{-1} (\theta - \hat\theta) \le z^2`: of a
    ratio those of Fieller (1954, J. R. Stat. Soc. B 16, 175-185), which have no end where the denominator may be zero,
    and for functions that are nearly linear those of the delta method. z is the `reach` in standard errors.

    Parameters
    ----------
    coefficients, covariance
        Shapes (p,) and (p, p); without covariance only the value is known.
    """
    value = float(function(coefficients[np.newaxis])[0])
    if covariance is None or not np.isfinite(value):
        return Estimate(value, np.nan, np.nan, np.nan)
    root = symmetric_root(covariance)
    root = root[:, root.any(axis=0)]

    def of(steps: Floats) -> Floats:
        with np.errstate(all="ignore"):
            return function(coefficients + steps @ root.T)

    error = float(np.linalg.norm(_gradient(of, np.zeros(root.shape[1]))))
    low = -_largest(lambda steps: -of(steps), root.shape[1], reach)
    return Estimate(value, error, low, _largest(of, root.shape[1], reach))


def _gradient(function: Function, at: Floats) -> Floats:
    step = 1e-3  # In standard errors: that of central differences is a millionth of the third derivative
    steps = step * np.eye(len(at))
    values = function(np.concatenate([at + steps, at - steps]))
    return np.asarray((values[: len(at)] - values[len(at) :]) / (2 * step))


def _largest(function: Function, size: int, reach: float) -> float:
    """Return the largest value within a ball about zero, infinite if there is a pole in it.

    At growing radii the point of the sphere in the direction of the gradient there is taken, which is the maximum of a
    function that is nearly linear, and a stationary point of any.
    """
    point = np.zeros(size)
    largest = float(function(point[np.newaxis])[0])
    for radius in np.linspace(0.0, reach, 9)[1:]:
        before = point
        for _ in range(3):
            slope = _gradient(function, point)
            length = np.linalg.norm(slope)
            if not (np.isfinite(length) and length > 0):
                break
            point = radius * slope / length
        segment = before + np.linspace(0.0, 1.0, 5)[:, np.newaxis] * (point - before)
        values = function(segment)
        far = np.abs(values) >= np.abs(values[0])
        turned = (values[:-1] > 0) & (values[1:] < 0) & far[:-1]
        breaks = np.flatnonzero(~np.isfinite(values[1:]) | turned) + 1
        end = int(breaks[0]) if len(breaks) else None
        if end is not None:
            return _at_break(function, segment[end - 1], segment[end], max(largest, float(np.nanmax(values[:end]))))
        largest = max(largest, float(values.max()))
    return largest


def _at_break(function: Function, inside: Floats, outside: Floats, largest: float) -> float:
    """Return the limit of a function where its domain ends between two points, infinite at a pole."""
    first = float(function(inside[np.newaxis])[0])
    for _ in range(40):
        middle = (inside + outside) / 2
        value = float(function(middle[np.newaxis])[0])
        if np.isfinite(value) and (value > 0 or first <= 0):
            inside = middle
        else:
            outside = middle
    last = float(function(inside[np.newaxis])[0])
    return np.inf if last > 1e3 * max(abs(largest), abs(first)) else max(largest, last)
