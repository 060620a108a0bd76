"""How far off rates from noisy heights are, on a fall whose rates are known."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.datasets import linear_drag
from commonlaw.differentiation import (
    AbstractDifferentiator,
    AbstractSmoother,
    CenteredDifference,
    ForwardDifference,
    SavitzkyGolay,
    SmoothedDifference,
)
from studies.falling_balls.settings import STUDIED_DRAWS, STUDIED_FALL, STUDIED_NOISES, WINDOWS

ORDERS: Mapping[int, str] = {1: "velocity", 2: "acceleration"}

Medians = Mapping[int, Mapping[str, Floats]]
"""Of relative errors over draws, by order and method, each of shape (levels,)."""

LARGEST = SavitzkyGolay(WINDOWS[-1], 3)
"""The smoothing that the paper settles on."""

METHODS: Mapping[str, AbstractDifferentiator] = {
    "forward": ForwardDifference(),
    "centred": CenteredDifference(),
    "smoothed forward": SmoothedDifference(LARGEST, ForwardDifference()),
    "smoothed centred": SmoothedDifference(LARGEST, CenteredDifference()),
}

BEST = "smoothed centred"
"""The method that the paper settles on."""

WINDOW_METHODS: Mapping[str, AbstractDifferentiator] = {
    str(window): SmoothedDifference(SavitzkyGolay(window, 3), CenteredDifference()) for window in WINDOWS
}


@dataclass(frozen=True, eq=False)
class NoisyFall:
    """One fall, measured with noise at many levels.

    Parameters
    ----------
    times, heights
        Of the fall itself, each of shape (n,).
    rates
        Its exact velocity and acceleration, each of shape (n,).
    levels
        Standard deviations of the noise, m, shape (levels,).
    measured
        Heights with noise, shape (n, levels, draws).
    """

    times: Floats
    heights: Floats
    rates: tuple[Floats, Floats]
    levels: Floats
    measured: Floats

    @classmethod
    def simulated(cls, seed: int) -> "NoisyFall":
        """Return the fall of the paper; the same draws of noise, scaled, serve all levels."""
        (fall,) = linear_drag(**STUDIED_FALL, trials=1, noise=0.0)
        heights, (drag, gravity) = fall.states[:, 0], (STUDIED_FALL[name] for name in ("drag", "gravity"))
        rates = gravity * np.expm1(drag * fall.times) / drag, gravity * np.exp(drag * fall.times)
        levels = np.geomspace(*STUDIED_NOISES)
        normals = np.random.default_rng(seed).standard_normal((len(heights), 1, STUDIED_DRAWS))
        measured = heights[:, np.newaxis, np.newaxis] + levels[:, np.newaxis] * normals
        return cls(fall.times, heights, rates, levels, measured)

    def errors(self, method: AbstractDifferentiator) -> dict[int, Floats]:
        """Return the relative errors of the velocity (1) and the acceleration (2), each of shape (levels, draws)."""
        flat = self.measured.reshape(len(self.times), -1)
        found = method.differentiate(self.times, flat, max(ORDERS)).derivatives
        return {
            order: relative(rate, exact[:, np.newaxis]).reshape(self.measured.shape[1:])
            for order, rate, exact in zip(ORDERS, found, self.rates, strict=True)
        }

    def derivative_errors(self, method: AbstractDifferentiator, level: float) -> dict[int, Floats]:
        """Return the errors of the derivatives at the level nearest to this one, each of shape (n, draws)."""
        index = int(np.argmin(np.abs(self.levels - level)))
        found = method.differentiate(self.times, self.measured[:, index], max(ORDERS)).derivatives
        return {
            order: rate - exact[:, np.newaxis] for order, rate, exact in zip(ORDERS, found, self.rates, strict=True)
        }

    def changes(self, smoother: AbstractSmoother) -> Floats:
        """Return by how much smoothing changes the heights, relatively, shape (levels, draws)."""
        flat = self.measured.reshape(len(self.times), -1)
        return relative(smoother.smooth(self.times, flat), flat).reshape(self.measured.shape[1:])

    def mean_change(self, smoother: AbstractSmoother) -> tuple[float, float]:
        """Return the sum of squares that smoothing takes from the fall itself, and its mean for noise of level one.

        Smoothing is linear: with noise of level s it takes the first plus s^2 times the second, in the mean.
        """
        lost = smoother.smooth(self.times, self.heights[:, np.newaxis])[:, 0] - self.heights
        unit = np.eye(len(self.times))
        return float(np.sum(lost**2)), float(np.sum((smoother.smooth(self.times, unit) - unit) ** 2))


def relative(found: Floats, exact: Floats) -> Floats:
    """Return the l2 norm of each column's difference over that of the exact column."""
    return np.asarray(np.linalg.norm(found - exact, axis=0) / np.linalg.norm(exact, axis=0))


def medians(errors: Mapping[str, Mapping[int, Floats]]) -> dict[int, dict[str, Floats]]:
    """Return by order and method the median over draws at each level, shape (levels,)."""
    return {order: {method: np.median(error[order], axis=1) for method, error in errors.items()} for order in ORDERS}


def at(levels: Floats, values: Floats, level: float) -> float:
    """Return a positive quantity at one noise level; between levels it runs straight on logarithmic axes."""
    return float(np.exp(np.interp(np.log(level), np.log(levels), np.log(values))))
