"""Total-variation regularised derivatives."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation.base import AbstractDifferentiator, Rates, need_samples
from commonlaw.differentiation.curvature import INNER, slope_bands, solve
from commonlaw.runtime.arguments import check_number

_SWEEPS = 300
_TOLERANCE = 1e-3
_ROUNDING = 1e-6


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

    def reach(self, order: int) -> int | None:
        return None

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
        weight = self.strength * len(times)
        return np.asarray(mean + scale * np.stack([_converged(steps, column, weight) for column in scaled], axis=1))


def _converged(steps: Floats, state: Floats, weight: float) -> Floats:
    """Sweep until no slope changes by more than a thousandth of the state's deviation over the trial's duration."""
    bands = slope_bands(steps)
    smoothed, slopes = state, np.diff(state) / steps
    for _ in range(_SWEEPS):
        bands[3, INNER] = -np.hypot(np.diff(slopes), _ROUNDING) / weight
        smoothed, _ = solve(bands, state)
        before, slopes = slopes, np.diff(smoothed) / steps
        if np.abs(slopes - before).max() < _TOLERANCE:
            break
    return smoothed
