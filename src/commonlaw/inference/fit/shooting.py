"""Coefficients and starts of a trial's states by least squares on solutions of a law (single shooting).

It is slower than fitting states with coefficients, and loses its way where trajectories are chaotic, but goes on where
coefficients that nearly fit lie in a narrow bent valley, as those of states that nobody measured do.
"""

from collections.abc import Callable, Sequence

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference.settings import MAX_ITERATIONS, ROUNDING, SAME_DEVIANCE

Solutions = Callable[[Floats, Floats], Sequence[Floats]]
"""From coefficients, shape (m, equations, terms), and starts, (m, trials, states), to states, each (m, n, states)."""

_DAMPED = 10.0 ** np.arange(-6, 4)
"""Shares of the diagonal that are added to the information (Levenberg and Marquardt)."""


def shot(
    solutions: Solutions,
    measured: Sequence[Floats],
    noise: Floats,
    coefficients: Floats,
    free: Bools,
    starts: Floats,
    free_starts: Bools,
) -> tuple[float, Floats, Floats]:
    """Return the sum of squares, over the noise, that solutions of a law leave, coefficients and starts.

    Parameters
    ----------
    solutions
        Of the law.
    measured
        States of each trial, shape (n, states), NaN where they were not measured.
    noise
        Shape (states,).
    coefficients, free
        To begin with, and which of them are to be found, shape (equations, terms).
    starts, free_starts
        The same of the starts of each trial, shape (trials, states).
    """
    seen = [np.isfinite(each) for each in measured]
    own = int(free.sum())
    sizes = np.concatenate([np.abs(coefficients[free]), np.maximum(np.abs(starts), noise)[free_starts]])
    sizes = np.where(sizes > 0, sizes, 1.0)

    def left(moved: Floats) -> Floats:
        """Return residuals, shape (m, measurements), from what is found in its units, shape (m, parameters)."""
        values = moved * sizes
        found = np.tile(coefficients, (len(values), 1, 1))
        begin = np.tile(starts, (len(values), 1, 1))
        found[:, free], begin[:, free_starts] = values[:, :own], values[:, own:]
        pairs = zip(solutions(found, begin), measured, seen, strict=True)
        with np.errstate(all="ignore"):
            parts = [((states - data) / noise)[:, there] for states, data, there in pairs]
        return np.nan_to_num(np.concatenate(parts, axis=1), nan=np.inf, posinf=np.inf, neginf=np.inf)

    now = np.concatenate([coefficients[free], starts[free_starts]]) / sizes
    residuals = left(now[np.newaxis])[0]
    squares = float(residuals @ residuals)
    for _ in range(MAX_ITERATIONS):
        if not np.isfinite(squares):
            break
        slopes = ((left(now + ROUNDING * np.eye(len(now))) - residuals) / ROUNDING).T
        if not np.isfinite(slopes).all():
            break
        moved = np.array([now + each for each in _directions(slopes, residuals)])
        tried = left(moved)
        with np.errstate(over="ignore"):
            sums = np.sum(tried**2, axis=1)
        best = int(np.argmin(sums))
        if not sums[best] < squares - SAME_DEVIANCE:
            break
        now, residuals, squares = moved[best], tried[best], float(sums[best])
    found, begin = coefficients.copy(), starts.copy()
    found[free], begin[free_starts] = (now * sizes)[:own], (now * sizes)[own:]
    return squares, found, begin


def _directions(slopes: Floats, residuals: Floats) -> list[Floats]:
    """Return steps towards less, from hardly damped ones to short ones."""
    information, gradient = slopes.T @ slopes, slopes.T @ residuals
    diagonal = np.diag(np.maximum(np.diag(information), np.finfo(float).tiny))
    return [-np.linalg.lstsq(information + each * diagonal, gradient)[0] for each in _DAMPED]
