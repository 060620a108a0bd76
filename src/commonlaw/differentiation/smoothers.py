"""Smoothing in windows, and differences of what is smoothed."""

from dataclasses import dataclass, field

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from commonlaw.array_types import Floats
from commonlaw.differentiation.base import AbstractDifferentiator, AbstractSmoother, Rates, check_uniform
from commonlaw.differentiation.differences import CenteredDifference
from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import check_whole_number


@dataclass(frozen=True)
class SavitzkyGolay(AbstractSmoother):
    """Each sample becomes the value of a polynomial fitted to the window around it (Savitzky and Golay 1964).

    The first and last half window take the polynomials of the first and last whole window. Polynomials up to the
    given degree pass unchanged.

    Assumes uniform sampling (steps within 50 % of the median; small jitter is passed over), white noise, and states
    that a polynomial of the given degree follows over one window.

    Raises `CommonlawError` if a parameter does not fit, a trial is shorter than the window, or its sampling is not
    uniform.

    Parameters
    ----------
    window
        Number of samples in the window, odd.
    polynomial
        Degree of the polynomial, less than `window`.
    """

    window: int = 35
    polynomial: int = 3

    def __post_init__(self) -> None:
        _check_window(self.window)
        check_whole_number("polynomial", self.polynomial, 0)
        if self.polynomial >= self.window:
            limit = self.window - 1
            raise CommonlawError("polynomial-fills-window", degree=self.polynomial, window=self.window, limit=limit)

    @property
    def half_window(self) -> int | None:
        return self.window // 2

    def smooth(self, times: Floats, states: Floats) -> Floats:
        from scipy.linalg import lstsq
        from scipy.ndimage import convolve1d  # scipy.signal has this filter, too, but takes half a second to load

        _check_fit(len(times), self.window)
        check_uniform(times, 0.5, "Savitzky-Golay smoothing")
        half, count = self.window // 2, len(times)
        powers = np.arange(half, -half - 1.0, -1.0) ** np.arange(self.polynomial + 1)[:, np.newaxis]
        weights = lstsq(powers, np.eye(self.polynomial + 1)[0])[0]
        smoothed = convolve1d(np.asarray(states, dtype=np.float64), weights, axis=0, mode="constant")
        # At the ends, the polynomials of the first and the last window
        window = np.arange(self.window)
        for first, inner in ((0, window[:half]), (count - self.window, window[half + 1 :])):
            fitted = np.polyfit(window, states[first : first + self.window], self.polynomial)
            smoothed[first + inner] = np.polynomial.polynomial.polyval(inner, fitted[::-1]).T
        return smoothed


@dataclass(frozen=True)
class MedianFilter(AbstractSmoother):
    """Each sample becomes the median of the window around it (Tukey 1977, chapter 7).

    Beyond the ends the first and last sample are repeated: a monotone state passes unchanged, and nothing pulls the
    ends toward zero. An outlier in the very first or last sample stays.

    Assumes rare, large outliers, fewer than half of any window; against ordinary noise it does little, and its steps
    show in the rates. Takes any grid, as it looks only at the order of samples.

    Raises `CommonlawError` if `window` is not an odd number of at least 3, or a trial is shorter than it.

    Parameters
    ----------
    window
        Number of samples in the window, odd.
    """

    window: int = 5

    def __post_init__(self) -> None:
        _check_window(self.window)

    @property
    def half_window(self) -> int | None:
        return self.window // 2

    def smooth(self, times: Floats, states: Floats) -> Floats:
        from scipy.ndimage import median_filter

        _check_fit(len(times), self.window)
        return np.asarray(median_filter(states, size=(self.window, 1), mode="nearest"))


@dataclass(frozen=True)
class WienerFilter(AbstractSmoother):
    """Each sample moves toward its window's mean, the more so the less the window varies (Lim 1990, p. 548).

    ``mean + (x - mean) max(0, 1 - noise / variance)`` with the window's mean and variance, and for the noise the
    average of these variances over the trial. It is the formula of `scipy.signal.wiener` but for the ends: SciPy puts
    zeros beyond them, which drags the ends of a state toward zero and counts the drop as noise. Here the state is
    reflected through its end points, so straight lines pass unchanged and the two end samples stay as they are.

    Assumes white noise of one level over the trial. The variance of a window includes the state's own slope: where it
    is steep the noise stays in. Takes any grid, as it looks only at the order of samples.

    Raises `CommonlawError` if `window` is not an odd number of at least 3, or a trial is shorter than it.

    Parameters
    ----------
    window
        Number of samples in the window, odd.
    """

    window: int = 5

    def __post_init__(self) -> None:
        _check_window(self.window)

    def smooth(self, times: Floats, states: Floats) -> Floats:
        _check_fit(len(times), self.window)
        half = self.window // 2
        padded = np.pad(states, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
        windows = sliding_window_view(padded, self.window, axis=0)
        mean, variance = windows.mean(axis=-1), windows.var(axis=-1)
        noise = variance.mean(axis=0)
        gain = 1 - noise / np.maximum(variance, noise + (noise == 0))  # no noise at all: the mean is the state
        return np.asarray(mean + (states - mean) * gain)


@dataclass(frozen=True)
class SmoothedDifference(AbstractDifferentiator):
    """Smoothing before every difference (de Silva et al. 2020, "Numerical differentiation").

    The falling-ball paper's rule. With smoother S and difference D: states ``S(x)``, rate ``v = D(S(x))``, second
    derivative ``a = D(S(v))``. The rate is smoothed once more before it is differentiated; the rate that is returned is
    not.

    Assumes what its smoother and its difference assume.

    Raises `CommonlawError` if the smoother or the difference refuses the trial.

    Parameters
    ----------
    smoother
        S.
    difference
        D; only its first derivative is used.
    """

    smoother: AbstractSmoother = field(default_factory=SavitzkyGolay)
    difference: AbstractDifferentiator = field(default_factory=CenteredDifference)

    def reach(self, order: int) -> int | None:
        half, step = self.smoother.half_window, self.difference.reach(1)
        return None if half is None or step is None else order * (half + step)

    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        smoothed = self.smoother.smooth(times, states)
        derivatives: list[Floats] = []
        for k in range(order):
            current = self.smoother.smooth(times, derivatives[-1]) if k else smoothed
            derivatives += self.difference.differentiate(times, current, 1).derivatives
        return Rates(smoothed, tuple(derivatives))


def _check_window(window: int) -> None:
    """Refuse a window that is not an odd number of samples, three or more: it has to have a sample in its middle."""
    check_whole_number("window", window, 3)
    if window % 2 == 0:
        raise CommonlawError("window-even", window=window, odd=window + 1)


def _check_fit(count: int, window: int) -> None:
    if count < window:
        largest = count - 1 + count % 2
        way_out = f"choose a window of at most {largest}" if largest >= 3 else "drop the trial"
        raise CommonlawError("window-too-long", count=count, window=window, remedy=way_out)
