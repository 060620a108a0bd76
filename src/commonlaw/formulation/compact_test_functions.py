"""Smooth test functions of compact support, and their integrals against sampled functions."""

from dataclasses import dataclass
from math import sqrt
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Bools, Floats

if TYPE_CHECKING:
    from scipy.sparse import csr_array


MIN_RADIUS = 14
"""In samples. The trapezoidal rule errs by the transform of a test function's derivative at the sampling rate, which is
below 1e-9 from here on."""

_POWER = 16
_WIDTH = sqrt(2 * _POWER + 3)
"""Radii in a test function's standard deviation."""

_UNEVEN = 1e-6
"""Share of the step by which the times of a regular grid may be off."""

_DEGREE = 9
"""Of the polynomial that is fitted to the samples nearest to a step of an irregular grid."""


@dataclass(frozen=True, eq=False)
class CompactTestFunctions:
    """Functions ``(1 - s^2)^16`` with ``s = (t - centre) / radius``, zero outside ``|s| < 1``, in order of centres.

    They are nearly normal curves (standard deviation radius / 5.9) with fifteen continuous derivatives, so that sums
    over a regular grid are integrals to many digits (Messenger and Bortz 2021, "Weak SINDy for partial differential
    equations", section 3). Centres and radii are in units of time, shape (k,).
    """

    centres: Floats
    radii: Floats

    @classmethod
    def over(cls, times: Floats, radius: float, narrowest: float) -> "CompactTestFunctions":
        """Return test functions of a radius, in mean steps, all over a trial but for gaps.

        Toward the ends radii shrink to the narrowest; the trial has at least ``2 * min(radius, narrowest) + 1``
        samples. Centres are a standard deviation of the test function apart, and at least a step: then sums of test
        functions span all slower functions (at the band's edge transforms are a hundredth of the largest), and closer
        ones add nothing.
        """
        last = len(times) - 1
        margin = min(radius, narrowest)
        grid = np.linspace(margin, last - margin, 8 * len(times))
        radii = np.minimum(radius, np.minimum(grid, last - grid))
        density = np.minimum(_WIDTH / radii, 1)
        passed = np.append(0, np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(grid)))
        centres = np.interp((np.arange(int(passed[-1]) + 1) + passed[-1] % 1 / 2), passed, grid)
        radii = np.minimum(radius, np.minimum(centres, last - centres))
        step = (times[-1] - times[0]) / last
        return cls(times[0] + step * centres, step * radii)._without_gaps(times)

    def joined(self, other: "CompactTestFunctions") -> "CompactTestFunctions":
        """Return the test functions of both."""
        centres, radii = np.append(self.centres, other.centres), np.append(self.radii, other.radii)
        order = np.argsort(centres, kind="stable")
        return CompactTestFunctions(centres[order], radii[order])

    def weights(self, times: Floats, highest: int) -> "list[csr_array]":
        """Return weights, shape (k, n), that integrate samples against test functions and their derivatives up to 2.

        On a regular grid they are the trapezoidal rule, whose error falls faster than any power of the step if the test
        function is not too narrow. Otherwise a polynomial of degree 9 through the 10 samples nearest to each step, on
        irregular grids fitted to the nearest 16, is integrated with the test function by Gauss quadrature: at 100
        samples an oscillation to 1e-8, without the amplified noise of interpolation at random times.
        """
        from scipy.sparse import vstack

        step = (times[-1] - times[0]) / (len(times) - 1)
        even = bool(np.abs(np.diff(times) - step).max() <= _UNEVEN * step)
        wide = (self.radii > (MIN_RADIUS - _UNEVEN) * step) & even
        steps = np.full(len(times), step)
        summed = [self._take(wide)._values(times, steps, each) for each in range(highest + 1)]
        if wide.all():
            return summed
        nodes, gauss = np.polynomial.legendre.leggauss(8)
        halves = np.diff(times)[:, np.newaxis] / 2
        points = times[:-1, np.newaxis] + halves * (1 + nodes)
        fit = _interpolation(times, points, _DEGREE + 1 if even else 16)
        narrow, factors = self._take(~wide), (halves * gauss).ravel()
        fitted = [narrow._values(points.ravel(), factors, each) @ fit for each in range(highest + 1)]
        indices = np.argsort(np.append(np.flatnonzero(wide), np.flatnonzero(~wide)))
        return [vstack(pair, format="csr")[indices] for pair in zip(summed, fitted, strict=True)]

    def _take(self, chosen: Bools) -> "CompactTestFunctions":
        return CompactTestFunctions(self.centres[chosen], self.radii[chosen])

    def _without_gaps(self, times: Floats) -> "CompactTestFunctions":
        """Return the test functions none of whose steps is longer than half of their radius."""
        steps = np.diff(times)
        first = np.maximum(np.searchsorted(times, self.centres - self.radii, side="right") - 1, 0)
        last = np.minimum(np.searchsorted(times, self.centres + self.radii), len(steps))
        widest = np.array([steps[i:j].max() for i, j in zip(first, last, strict=True)])
        return self._take(widest <= self.radii / 2)

    def _values(self, points: Floats, factors: Floats, derivative: int) -> "csr_array":
        """Return a derivative of the functions at increasing points, times a factor for each, shape (k, points)."""
        from scipy.sparse import csr_array

        first = np.searchsorted(points, self.centres - self.radii, side="right")
        counts = np.searchsorted(points, self.centres + self.radii) - first
        starts = np.append(0, np.cumsum(counts))
        function = np.repeat(np.arange(len(counts)), counts)
        index = np.arange(starts[-1]) + np.repeat(first - starts[:-1], counts)
        s = (points[index] - self.centres[function]) / self.radii[function]
        values = _derivative(s, derivative) / self.radii[function] ** derivative * factors[index]
        return csr_array((values, index, starts), shape=(len(counts), len(points)))


def corner_radius(times: Floats, states: Floats, noise: Floats) -> float:
    """Return the radius in samples of test functions that pass what is slower than the corner of the states' spectrum.

    Beyond the corner there is only noise (Messenger and Bortz 2021, section 4.2). It is at the number K of sine modes
    of least error by Mallows' Cp, their residual plus ``2 K noise^2``, of the state less the line through its ends; of
    several states, shape (n, d), the fastest counts. The radius puts the corner at two standard deviations of the test
    function's transform ``exp(-(omega radius / 5.9)^2 / 2)``. It is at least `MIN_RADIUS`, below which sums are no
    integrals, and otherwise at most a quarter of the trial.
    """
    from scipy.fft import dst

    last = len(times) - 1
    grid = np.linspace(times[0], times[-1], len(times))
    modes = 1
    for state, deviation in zip(states.T, noise, strict=True):
        even = np.interp(grid, times, state)
        bent = (even - np.linspace(even[0], even[-1], len(even)))[1:-1]
        gained = np.cumsum(dst(bent, type=1, norm="ortho") ** 2 - 2 * deviation**2)
        modes = max(modes, int(np.argmax(gained)) + 1)
    radius = 2 * _WIDTH * last / (np.pi * modes)
    return float(np.clip(radius, MIN_RADIUS, max(MIN_RADIUS, last / 4)))


def _derivative(s: Floats, derivative: int) -> Floats:
    inside, p = 1 - s**2, _POWER
    if derivative == 0:
        return np.asarray(inside**p)
    if derivative == 1:
        return np.asarray(-2 * p * s * inside ** (p - 1))
    return np.asarray(2 * p * inside ** (p - 2) * ((2 * p - 1) * s**2 - 1))


def _interpolation(times: Floats, points: Floats, size: int) -> "csr_array":
    """Return the matrix, ((n - 1) m, n), from samples to values at points of each step, (n - 1, m)."""
    from scipy.sparse import csr_array

    size = min(size, len(times))
    first = np.clip(np.arange(len(times) - 1) - size // 2 + 1, 0, len(times) - size)
    indices = first[:, np.newaxis] + np.arange(size)
    near = times[indices]
    middle, half = (near[:, [-1]] + near[:, [0]]) / 2, (near[:, [-1]] - near[:, [0]]) / 2
    powers = np.arange(min(_DEGREE, size - 1) + 1)
    samples, wanted = (((each - middle) / half)[:, :, np.newaxis] ** powers for each in (near, points))
    weights = wanted @ np.linalg.pinv(samples)
    columns = np.broadcast_to(indices[:, np.newaxis, :], weights.shape)
    starts = np.arange(0, weights.size + 1, size)
    return csr_array((weights.ravel(), columns.ravel(), starts), shape=(points.size, len(times)))
