"""Smoothing that takes gaps and that outliers do not spoil."""

from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.differentiation.base import AbstractDifferentiator, Rates
from commonlaw.differentiation.noise import MEDIAN_SIZE, OUTLIER_THRESHOLD, differences
from commonlaw.differentiation.penalized import SmoothingSpline, cross_validated, smoothing_spline
from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import check_number

_MIN_SAMPLES = 16
"""Of fewer values none can be called an outlier."""
_OUTLYING = 5.0
"""Scales beyond which a value does not fit in with its neighbours."""
_FALLING = 0.85
"""Share of what the state leaves in the differences of one order that shows it to leave less in another."""


@dataclass(frozen=True)
class RobustSpline(AbstractDifferentiator):
    """The `SmoothingSpline` through each state's measured values but its outliers, at all times.

    A state may have gaps (NaN). In them and at outliers stand the values of the spline; before the first and after the
    last value that it goes through, it goes on straight, as natural splines do.

    An outlier does not fit in with its neighbours (a difference that it is in, as in `noise_level`, is further than
    five scales from zero), and they fit in better without it. It lies further than four scales from the curve through
    the other values, and from a curve on which no value pulls harder than one at a scale and a half (Huber 1964), its
    strength cross-validated with the values so pulled in (Cantoni and Ronchetti 2001). The scale is the median size, of
    distances from a curve that in the neighbourhood if it is larger: a curve that is too stiff for a fast turn misses
    all of it.

    A state without outliers gets the curve of `SmoothingSpline` bit for bit. Assumes white noise, outliers that are
    rare, at most three in a row, and 20 samples or more for each period of the fastest oscillation: fewer hide them. An
    outlier in the very first or last sample may stay, as may some of many close together.

    Raises `CommonlawError` if `strength` is not above zero, a state has fewer than 5 measured values, or a third
    derivative is asked for.

    Parameters
    ----------
    strength
        As in `SmoothingSpline`.
    """

    takes_missing: ClassVar[bool] = True

    strength: float | None = None

    def __post_init__(self) -> None:
        check_number("strength", self.strength, 0, above=True, optional=True)

    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        columns = []
        for j, column in enumerate(states.T):
            measured = np.flatnonzero(~np.isnan(column))
            if len(measured) < 5:  # What a spline takes
                raise CommonlawError("too-few-values", state=j + 1, measured=len(measured), least=5)
            known, values = times[measured], column[measured]
            if len(times) > 2000 or order > 2:  # Remembered are curves of some hundred trials: megabytes
                columns.append(self._curve(known, values, times, order))
            else:
                columns.append(_remembered(self, known.tobytes(), values.tobytes(), times.tobytes())[: order + 1])
        smoothed, *derivatives = (np.stack(parts, axis=1) for parts in zip(*columns, strict=True))
        return Rates(smoothed, tuple(derivatives))

    def _curve(self, known: Floats, values: Floats, times: Floats, order: int) -> list[Floats]:
        """Return the curve and its derivatives of one state at `times`, each of shape (n,)."""
        kept = _without_spikes(known, values)
        kept = kept[~self._outliers(known[kept], values[kept])]
        rates = SmoothingSpline(self.strength).differentiate(known[kept], values[kept, np.newaxis], order)
        if len(kept) == len(times):
            return [column[:, 0] for column in (rates.states, *rates.derivatives)]
        return _natural(known[kept], rates.states[:, 0], times, order)

    def _outliers(self, times: Floats, values: Floats) -> Bools:
        """Return which values of one state are outliers, spikes apart, shape (n,)."""
        from scipy.ndimage import binary_opening

        outlyingness = _outlyingness(times, values)
        far = outlyingness > _OUTLYING
        if not far.any():
            return far
        distances = np.abs(values - self._bounded(times, values))
        far &= distances > OUTLIER_THRESHOLD * _scales(distances, distances)
        while far.any():
            turns = binary_opening(far, np.ones(4, dtype=np.bool_))  # More than three in a row
            before: Indices = np.cumsum(~far) - ~far
            kept = _outlyingness(times[~far], values[~far])
            around = np.maximum(kept[np.maximum(before - 1, 0)], kept[np.minimum(before, len(kept) - 1)])
            restored = turns | far & (around > np.maximum(_OUTLYING, outlyingness))
            if not restored.any():
                rates = SmoothingSpline(self.strength).differentiate(times[~far], values[~far, np.newaxis], 1)
                distances = np.abs(values - _natural(times[~far], rates.states[:, 0], times, 1)[0])
                bounds = OUTLIER_THRESHOLD * _scales(distances, distances[~far])
                bounds[(times < times[~far][0]) | (times > times[~far][-1])] *= 3  # The curve goes on straight there
                restored = far & (distances <= bounds)
            if not restored.any():
                break
            far &= ~restored
        return far

    def _bounded(self, times: Floats, values: Floats) -> Floats:
        """Return a curve on which no value pulls harder than one at a scale and a half."""
        step = (times[-1] - times[0]) / (len(times) - 1)
        steps, pulled = np.diff(times) / step, values
        for _ in range(3):
            strength = cross_validated(steps, pulled) if self.strength is None else self.strength / step**3
            for _ in range(15):
                curve, _, _ = smoothing_spline(steps, pulled, strength)
                distances = values - curve
                bounds = 1.5 * _scales(np.abs(distances), np.abs(distances))
                pulled = curve + np.clip(distances, -bounds, bounds)
        return curve


@lru_cache(maxsize=512)
def _remembered(spline: RobustSpline, known: bytes, values: bytes, times: bytes) -> list[Floats]:
    """Return a curve and both its derivatives: data checks, searches and forecasts smooth the same trials."""
    return spline._curve(np.frombuffer(known), np.frombuffer(values), np.frombuffer(times), 2)


def _without_spikes(times: Floats, values: Floats) -> Indices:
    """Return the indices of the values that are left when spikes are taken out, the largest first."""
    kept = np.arange(len(times))
    while len(kept) >= _MIN_SAMPLES:
        every, order, _ = _differences(times[kept], values[kept])
        sizes = every[order]
        peak = int(np.argmax(sizes))
        if sizes[peak] <= 2 * _OUTLYING * np.median(sizes) / MEDIAN_SIZE:
            break
        rest = np.delete(kept, peak + order // 2)
        around = slice(max(peak - order, 0), peak + order)
        if _sizes(times[rest], values[rest], order)[order][around].max() > sizes[peak] / 10:
            break
        kept = rest
    return kept


def _outlyingness(times: Floats, values: Floats) -> Floats:
    """Return how many scales the differences that a value is in are from zero at most, shape (n,)."""
    from scipy.ndimage import maximum_filter1d

    outlyingness = np.zeros(len(times))
    if len(times) < _MIN_SAMPLES:
        return outlyingness
    sizes, quietest, hidden = _differences(times, values)
    least = np.median(sizes[quietest])
    for order, size in sizes.items():
        median = np.median(size)
        if 0 < median <= least / _FALLING:
            local = maximum_filter1d(np.pad(size * MEDIAN_SIZE / median, (order, order)), order + 1)
            outlyingness = np.maximum(outlyingness, local[(order + 1) // 2 :][: len(times)])
    if hidden:
        outlyingness[:quietest] = outlyingness[-quietest:] = 0
    return outlyingness


def _differences(times: Floats, values: Floats) -> tuple[dict[int, Floats], int, bool]:
    """Return the sizes of one state's differences by their order, and the even order at which they are smallest.

    The state itself leaves least in those; it hides the noise, which is said last, if they still fall at the highest
    order.
    """
    orders = [order for order in (2, 4, 6, 8) if 4 * order <= len(times)]  # Even ones have a sample in their middle
    sizes = _sizes(times, values, orders[-1])
    medians = [float(np.median(sizes[order])) for order in orders]
    best = int(np.argmin(medians))
    hidden = best == len(orders) - 1 and medians[best] < _FALLING * medians[best - 1]
    return sizes, orders[best], hidden


def _sizes(times: Floats, values: Floats, highest: int) -> dict[int, Floats]:
    return {k: np.abs(d[:, 0]) for k, d in enumerate(differences(times, values[:, np.newaxis], highest), 1)}


def _scales(sizes: Floats, ordinary: Floats) -> Floats:
    """Return the scale of the ordinary sizes, or of the 15 around a sample if it is larger, shape (n,)."""
    from scipy.ndimage import median_filter

    near, half = median_filter(sizes, 15), 7
    near[:half], near[-half:] = near[half], near[-half - 1]
    return np.asarray(np.maximum(np.median(ordinary), near) / MEDIAN_SIZE)


def _natural(known: Floats, values: Floats, times: Floats, order: int) -> list[Floats]:
    """Return the natural cubic spline through values, straight beyond them, and its derivatives at `times`."""
    from scipy.interpolate import CubicSpline

    curve, inside = CubicSpline(known, values, bc_type="natural"), np.clip(times, known[0], known[-1])
    result: list[Floats] = [curve(inside, k) for k in range(order + 1)]
    result[0] += result[1] * (times - inside)
    return result
