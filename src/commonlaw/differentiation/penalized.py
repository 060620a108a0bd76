"""Smoothing by penalties on changes of slope: splines, and total variation of the rate.

``D z`` lists the changes of slope, at the inner samples, of the polygon through z. A state x is smoothed by solving
``z + D' y = x``, ``D z - C y = 0`` for z and the multipliers y; methods differ in C alone. In the order z0, y0, z1,
y1, ... the matrix has three bands on either side; the first and the last y are idle. Work and memory are linear in the
number of samples, and digits last for 50 000 samples, where the equation for z alone has lost them all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from hashlib import blake2b

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.differentiation.base import AbstractDifferentiator, Rates, need_samples
from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import check_number

_BANDS = 3
"""On either side."""

INNER = slice(3, -1, 2)
"""Where the multipliers of the inner samples stand."""


def slope_bands(steps: Floats) -> Floats:
    """Return the system's bands without C, shape (7, 2 n), as SciPy's banded solvers take them."""
    bands = np.zeros((7, 2 * len(steps) + 2))
    bands[3] = 1
    bands[3, INNER] = 0
    multipliers = np.arange(bands.shape[1])[INNER]
    before, after = 1 / steps[:-1], 1 / steps[1:]
    for shift, slope in ((-3, before), (-1, -(before + after)), (1, after)):
        bands[3 - shift, multipliers + shift] = bands[3 + shift, multipliers] = slope
    return bands


@dataclass(frozen=True, eq=False)
class Factors:
    """The factors of a system, with which it is solved and its determinant taken."""

    triangular: Floats
    pivots: Indices

    @classmethod
    def of(cls, bands: Floats) -> "Factors":
        """Factor the system of these bands, shape (7, 2 n)."""
        from scipy.linalg.lapack import dgbtrf

        room = np.zeros((_BANDS + len(bands), bands.shape[1]), order="F")
        room[_BANDS:] = bands
        triangular, pivots, _ = dgbtrf(room, _BANDS, _BANDS, overwrite_ab=True)
        return cls(triangular, pivots)

    def solve(self, state: Floats) -> tuple[Floats, Floats]:
        """Return z and y, each of shape (n,), for a state of shape (n,)."""
        from scipy.linalg.lapack import dgbtrs

        if not self.triangular[2 * _BANDS].all():
            raise np.linalg.LinAlgError("singular matrix")
        known = np.zeros(2 * len(state))
        known[::2] = state
        solution, _ = dgbtrs(self.triangular, _BANDS, _BANDS, known, self.pivots, overwrite_b=True)
        return solution[::2], solution[1::2]

    @property
    def log_determinant(self) -> float:
        """The logarithm of the absolute determinant of the system."""
        return float(np.log(np.abs(self.triangular[2 * _BANDS])).sum())


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
    return smoothed, np.append(rate, slopes[-1] + steps[-1] * curvature[-2] / 6), curvature


@dataclass(frozen=True, eq=False)
class _Systems:
    """The systems of the spline at all strengths, of which most does not depend on the strength.

    Bands are those of the changes of slope alone, shape (7, 2 n); the Gram matrix of the hat functions is times -3 on
    its diagonal and times -6 next to it.
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


_strengths: dict[bytes, float] = {}
"""Chosen strengths by a digest of steps and state: data checks, searches and forecasts smooth the same trials."""


def cross_validated(steps: Floats, state: Floats) -> float:
    """Return the strength, in units of the mean step cubed, with the least generalised cross-validation score.

    Of more than `_MANY` samples stretches all over them are enough, unless a line through each of these is smoother.
    """
    digest = blake2b(steps.tobytes() + state.tobytes(), digest_size=32).digest()
    if digest not in _strengths:
        result, is_line = _of_least_score([(steps, state)] if len(state) <= _MANY else _stretches(steps, state))
        if is_line and len(state) > _MANY:
            result, _ = _of_least_score([(steps, state)])
        while len(_strengths) >= 4096:  # Of some hundred bytes each
            _strengths.pop(next(iter(_strengths)), None)
        _strengths[digest] = result
        return result
    return _strengths[digest]


_MANY = 4096
"""Samples that suffice for the choice of a strength."""
_LONG = 1024
"""Samples of a stretch."""


def _stretches(steps: Floats, state: Floats) -> list[tuple[Floats, Floats]]:
    """Return steps and values of stretches of a state, evenly spaced, `_MANY` samples in all."""
    starts = np.linspace(0, len(state) - _LONG, _MANY // _LONG).astype(np.int64)
    return [(steps[first : first + _LONG - 1], state[first : first + _LONG]) for first in starts.tolist()]


def _of_least_score(stretches: Sequence[tuple[Floats, Floats]]) -> tuple[float, bool]:
    """Return the strength of least score over stretches, and whether it is the largest, a line."""
    from scipy.optimize import minimize_scalar

    grid = _grid(len(stretches[0][1]))
    parts = [(_Systems.of(steps), state) for steps, state in stretches]
    traces = np.sum([_traces(steps.tobytes()) for steps, _ in stretches], axis=0)
    pairs = zip(grid, traces, strict=True)
    best = int(np.argmin([_score(logarithm, parts, trace) for logarithm, trace in pairs]))
    bounds = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
    result = minimize_scalar(_score, bounds=bounds, args=(parts,), method="bounded").x
    return float(np.exp(result)), best == len(grid) - 1


def _grid(samples: int) -> Floats:
    """Return the logarithms of the strengths that are tried first."""
    return np.linspace(np.log(2e-5), 4 * np.log(samples), 40)


@lru_cache(maxsize=64)
def _traces(steps: bytes) -> tuple[float, ...]:
    """Return the traces on the grid, which are the same for all states that are measured at the same times."""
    systems = _Systems.of(np.frombuffer(steps))
    return tuple(systems.trace(logarithm) for logarithm in _grid(len(systems.diagonal) + 2))


def _score(logarithm: float, parts: Sequence[tuple[_Systems, Floats]], trace: float | None = None) -> float:
    """Return ``n RSS / trace(1 - A)^2``, A being the matrix from the measured to the smoothed states."""
    residuals = [state - systems.factors(np.exp(logarithm)).solve(state)[0] for systems, state in parts]
    trace = sum(systems.trace(logarithm) for systems, _ in parts) if trace is None else trace
    return float(sum(map(len, residuals)) * np.sum(np.concatenate(residuals) ** 2) / trace**2)


@dataclass(frozen=True)
class TotalVariationDerivative(AbstractDifferentiator):
    """The rate u that minimises ``1/2 mean (x0 + integral u - x)^2 + strength * TV(u)`` (Chartrand 2011).

    States are taken in units of their standard deviation and times in units of the trial's duration, so `strength`
    is a pure number that means the same for every state, unit and sampling rate. The rate is constant between samples
    and the start x0 is free. The unknown is the integral z of the rate: with D its changes of slope, the lagged
    diffusivity sweep ``z + strength n D' diag(1 / |D z|) D z = x``, with the last sweep's slopes in the diagonal, costs
    work linear in the number of samples. Each sweep lowers the objective; at most 300 are made. The states are z and
    the rates its centred differences. Higher derivatives repeat the method on the rate.

    Takes any grid. Assumes a rate that is constant but for jumps, and white noise. Smooth rates come out as stairs and
    extremes are clipped; then prefer `SmoothingSpline`.

    Raises `CommonlawError` if `strength` is not above zero, or a trial has fewer than 3 samples.

    Parameters
    ----------
    strength
        Weight of the total variation; between 1e-6 (light) and 1e-2 (heavy) for most trials.
    """

    strength: float

    def __post_init__(self) -> None:
        check_number("strength", self.strength, 0, above=True)

    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        need_samples(len(times), 3, "total-variation derivatives")
        smoothed, derivatives = self._smooth(times, states), list[Floats]()
        for k in range(order):
            current = self._smooth(times, derivatives[-1]) if k else smoothed
            derivatives.append(np.gradient(current, times, axis=0))
        return Rates(smoothed, tuple(derivatives))

    def _smooth(self, times: Floats, states: Floats) -> Floats:
        steps = np.diff(times) / (times[-1] - times[0])
        mean, deviation = states.mean(axis=0), states.std(axis=0)
        scale = np.where(deviation > 0, deviation, 1)
        scaled = ((states - mean) / scale).T
        bands, columns = slope_bands(steps), list[Floats]()
        for state in scaled:
            smoothed, slopes = state, np.diff(state) / steps
            for _ in range(300):
                bands[3, INNER] = -np.hypot(np.diff(slopes), 1e-6) / (self.strength * len(times))
                smoothed, _ = Factors.of(bands).solve(state)
                before, slopes = slopes, np.diff(smoothed) / steps
                if np.abs(slopes - before).max() < 1e-3:  # Of the state's deviation over the trial's duration
                    break
            columns.append(smoothed)
        return np.asarray(mean + scale * np.stack(columns, axis=1))
