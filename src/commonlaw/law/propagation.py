"""From the covariance of coefficients to standard errors and intervals of functions of them."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats

Function = Callable[[Floats], Floats]
"""Takes coefficients, shape (n, p), and returns values, shape (n,), NaN outside of its domain."""

_STEP = 1e-3
"""Of central differences, in standard errors: their error is a millionth of the third derivative."""
_RADII = 8
"""Steps from the estimate to the boundary of the confidence ellipsoid."""
_POINTS = 5
"""Points of a segment that is searched for a pole."""


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
    scales, vectors = np.linalg.eigh(covariance)
    kept = scales > scales.max(initial=0.0) * 1e-14
    root = vectors[:, kept] * np.sqrt(scales[kept])

    def of(steps: Floats) -> Floats:
        with np.errstate(all="ignore"):
            return function(coefficients + steps @ root.T)

    error = float(np.linalg.norm(_gradient(of, np.zeros(root.shape[1]))))
    low = -_largest(lambda steps: -of(steps), root.shape[1], reach)
    return Estimate(value, error, low, _largest(of, root.shape[1], reach))


def _gradient(function: Function, at: Floats) -> Floats:
    steps = _STEP * np.eye(len(at))
    values = function(np.concatenate([at + steps, at - steps]))
    return np.asarray((values[: len(at)] - values[len(at) :]) / (2 * _STEP))


def _largest(function: Function, size: int, reach: float) -> float:
    """Return the largest value within a ball about zero, infinite if there is a pole in it.

    At growing radii the point of the sphere in the direction of the gradient there is taken, which is the maximum of a
    function that is nearly linear, and a stationary point of any.
    """
    point = np.zeros(size)
    largest = float(function(point[np.newaxis])[0])
    for radius in np.linspace(0.0, reach, _RADII + 1)[1:]:
        before = point
        for _ in range(3):
            slope = _gradient(function, point)
            length = np.linalg.norm(slope)
            if not (np.isfinite(length) and length > 0):
                break
            point = radius * slope / length
        segment = before + np.linspace(0.0, 1.0, _POINTS)[:, np.newaxis] * (point - before)
        values = function(segment)
        end = _first_break(values)
        if end is not None:
            return _at_break(function, segment[end - 1], segment[end], max(largest, float(np.nanmax(values[:end]))))
        largest = max(largest, float(values.max()))
    return largest


def _first_break(values: Floats) -> int | None:
    """Return the first point at which a function has no value, or has changed its sign as it does at a pole."""
    far = np.abs(values) >= np.abs(values[0])
    turned = (values[:-1] > 0) & (values[1:] < 0) & far[:-1]
    breaks = np.flatnonzero(~np.isfinite(values[1:]) | turned) + 1
    return int(breaks[0]) if len(breaks) else None


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
