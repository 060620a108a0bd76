"""Smoothing splines."""

from dataclasses import dataclass
from functools import lru_cache
from hashlib import blake2b

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation.base import AbstractDifferentiator, Rates, need_samples
from commonlaw.differentiation.curvature import INNER, Factors, slope_bands
from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import check_number


@dataclass(frozen=True)
class SmoothingSpline(AbstractDifferentiator):
    """The natural cubic spline f that minimises ``sum (x - f)^2 + strength * integral f''^2`` (Reinsch 1967).

    With D the changes of slope and R the Gram matrix of hat functions, ``f + strength D' c = x`` and ``D f = R c`` are
    solved for the values f and the second derivatives c at the samples; the rates are those of the spline. Work is
    linear in the number of samples.

    Takes any grid. Assumes white noise of one level over the trial and a state of one roughness. The spline is
    natural: its second derivative is zero at both ends, which ruins laws of second order near them; prefer
    `SmoothedDifference` there.

    Raises `CommonlawError` if `strength` is not above zero, a trial has fewer than 5 samples, or a third derivative is
    asked for.

    Parameters
    ----------
    strength
        Weight of the roughness, in time units cubed. None chooses it for each state by generalised cross-validation
        (Craven and Wahba 1979), from one fifty-thousandth of the step cubed up to a straight line, on a logarithmic
        scale and in units of the step, so that the choice does not depend on the unit of time (that of
        `scipy.interpolate.make_smoothing_spline` does).
    """

    strength: float | None = None

    def __post_init__(self) -> None:
        check_number("strength", self.strength, 0, above=True, optional=True)

    def reach(self, order: int) -> int | None:
        return None

    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        need_samples(len(times), 5, "smoothing splines")
        if order > 2:
            raise CommonlawError("spline-order", order=order)
        step = (times[-1] - times[0]) / (len(times) - 1)
        steps = np.diff(times) / step
        columns = []
        for column in states.T:
            strength = cross_validated(steps, column) if self.strength is None else self.strength / step**3
            columns.append(smoothing_spline(steps, column, strength))
        smoothed, rate, curvature = (np.stack(parts, axis=1) for parts in zip(*columns, strict=True))
        return Rates(smoothed, (rate / step, curvature / step**2)[:order])


def smoothing_spline(steps: Floats, state: Floats, strength: float) -> tuple[Floats, Floats, Floats]:
    """Return the spline's values, first and second derivatives at the samples, each of shape (n,)."""
    smoothed, multipliers = _Systems.of(steps).factors(strength).solve(state)
    curvature = multipliers / strength
    slopes = np.diff(smoothed) / steps
    rate = slopes - steps * (2 * curvature[:-1] + curvature[1:]) / 6
    last = slopes[-1] + steps[-1] * curvature[-2] / 6
    return smoothed, np.append(rate, last), curvature


@dataclass(frozen=True, eq=False)
class _Systems:
    """The systems of the spline at all strengths, of which most does not depend on the strength.

    Parameters
    ----------
    bands
        Of the changes of slope alone, shape (7, 2 n).
    diagonal, off_diagonal
        The Gram matrix of the hat functions, times -3 on its diagonal and times -6 next to it.
    """

    bands: Floats
    diagonal: Floats
    off_diagonal: Floats

    @classmethod
    def of(cls, steps: Floats) -> "_Systems":
        return cls(slope_bands(steps), -(steps[:-1] + steps[1:]), -steps[1:-1])

    def factors(self, strength: float) -> Factors:
        bands = self.bands.copy()
        bands[3, INNER] = self.diagonal / (3 * strength)
        bands[1, 5:-1:2] = bands[5, 3:-3:2] = self.off_diagonal / (6 * strength)
        return Factors.of(bands)

    def trace(self, logarithm: float) -> float:
        """Return the trace of 1 - A, A being the matrix from the measured to the smoothed state.

        It is n - 2 and the derivative of the system's log determinant by the logarithm of the strength.
        """
        low, high = (self.factors(np.exp(logarithm + shift)).log_determinant for shift in (-0.01, 0.01))
        return len(self.diagonal) + (high - low) / 0.02


_KEPT = 4096
"""Strengths that are remembered, of some hundred bytes each."""

_strengths: dict[bytes, float] = {}
"""Chosen strengths by a digest of steps and state: data checks, searches and forecasts smooth the same trials."""


def cross_validated(steps: Floats, state: Floats) -> float:
    """Return the strength, in units of the mean step cubed, with the least generalised cross-validation score."""
    digest = blake2b(steps.tobytes() + state.tobytes(), digest_size=32).digest()
    if digest not in _strengths:
        from scipy.optimize import minimize_scalar

        systems, grid = _Systems.of(steps), _grid(len(state))
        traces = _traces(steps.tobytes())
        best = int(np.argmin([_score(each, systems, state, trace) for each, trace in zip(grid, traces, strict=True)]))
        bounds = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        found = float(np.exp(minimize_scalar(_score, bounds=bounds, args=(systems, state), method="bounded").x))
        while len(_strengths) >= _KEPT:
            _strengths.pop(next(iter(_strengths)), None)
        _strengths[digest] = found
        return found
    return _strengths[digest]


def _grid(samples: int) -> Floats:
    """Return the logarithms of the strengths that are tried first."""
    return np.linspace(np.log(2e-5), 4 * np.log(samples), 40)


@lru_cache(maxsize=16)
def _traces(steps: bytes) -> tuple[float, ...]:
    """Return the traces on the grid, which are the same for all states that are measured at the same times."""
    systems = _Systems.of(np.frombuffer(steps))
    return tuple(systems.trace(each) for each in _grid(len(systems.diagonal) + 2))


def _score(logarithm: float, systems: _Systems, state: Floats, trace: float | None = None) -> float:
    """Return ``n RSS / trace(1 - A)^2``, A being the matrix from the measured to the smoothed state."""
    smoothed, _ = systems.factors(np.exp(logarithm)).solve(state)
    trace = systems.trace(logarithm) if trace is None else trace
    return float(len(state) * np.sum((state - smoothed) ** 2) / trace**2)
