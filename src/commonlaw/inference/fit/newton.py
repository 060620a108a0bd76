"""Minima of functions of few variables that are smooth, but known to some ten digits only.

A minimum is found to more digits than the function's values have, so that it does not depend on rounding: units, signs
and where variables are counted from change a law by no more than their own digits.
"""

from collections.abc import Callable

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.inference.settings import DIFFERENCE_SPACING, MAX_ITERATIONS, ROUNDING


def minimum(value: Callable[[Floats], float], start: Floats, low: Floats, high: Floats) -> Floats:
    """Return where a function is least near a start, within bounds, by Newton's method (Nocedal and Wright 2006, 3.4).

    Derivatives are by central differences, and curvatures that are negative are turned round. The arrays have the shape
    (variables,).
    """
    found, least = start, value(start)
    for _ in range(MAX_ITERATIONS):
        step = _step(value, found, least, low, high)
        length = float(np.abs(step).max(initial=0.0))
        if length < ROUNDING:
            return np.clip(found + step, low, high)
        step *= min(1.0, 1 / length)
        for share in (1, 1 / 4, 1 / 16, 1 / 64, 1 / 256):
            tried = np.clip(found + share * step, low, high)
            if (own := value(tried)) < least:
                break
        else:
            return found
        found, least = tried, own
    return found


def _step(value: Callable[[Floats], float], at: Floats, known: float, low: Floats, high: Floats) -> Floats:
    """Return Newton's step from where the value is known, without variables that a bound holds."""
    # At a bound values are taken from its inner side
    center = np.clip(at, np.minimum(low + DIFFERENCE_SPACING, high), np.maximum(high - DIFFERENCE_SPACING, low))
    free = np.flatnonzero(high - low > 2 * DIFFERENCE_SPACING)
    middle = known if np.array_equal(center, at) else value(center)
    gradient, curvature = _derivatives(value, center, middle, free)
    outward = np.where(gradient > 0, at[free] <= low[free], (gradient < 0) & (at[free] >= high[free]))
    step, inner = np.zeros(len(at)), free[~outward]
    if len(inner):
        sizes, directions = np.linalg.eigh(curvature[np.ix_(~outward, ~outward)])
        sizes = np.maximum(np.abs(sizes), ROUNDING * np.abs(sizes).max())
        if sizes.max() > 0:
            step[inner] = -directions @ ((directions.T @ gradient[~outward]) / sizes)
    return step


def _derivatives(value: Callable[[Floats], float], at: Floats, middle: float, free: Indices) -> tuple[Floats, Floats]:
    """Return the gradient and the second derivatives by some of the variables, about a value in the middle."""
    count = len(free)
    moves = DIFFERENCE_SPACING * np.eye(len(at))[free]
    after, before = (np.array([value(at + sign * move) for move in moves]) for sign in (1, -1))
    curvature = np.diag(after + before - 2 * middle)
    for i in range(count):
        for j in range(i):
            both = value(at + moves[i] + moves[j]) + value(at - moves[i] - moves[j])
            mixed = (both - after[i] - after[j] - before[i] - before[j] + 2 * middle) / 2
            curvature[i, j] = curvature[j, i] = mixed
    return (after - before) / (2 * DIFFERENCE_SPACING), curvature / DIFFERENCE_SPACING**2
