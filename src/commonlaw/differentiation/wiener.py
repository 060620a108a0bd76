"""Wiener smoothing."""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from commonlaw.array_types import Floats
from commonlaw.differentiation.base import AbstractSmoother
from commonlaw.differentiation.checks import check_window, fit_window


@dataclass(frozen=True)
class WienerFilter(AbstractSmoother):
    """Each sample moves toward its window's mean, the more so the less the window varies (Lim 1990, p. 548).

    ``mean + (x - mean) max(0, 1 - noise / variance)`` with the window's mean and variance, and for the noise the
    average of these variances over the trial. It is the formula of `scipy.signal.wiener` but for the ends: SciPy puts
    zeros beyond them, which drags the ends of a state toward zero and counts the drop as noise. Here the state is
    reflected through its end points, so straight lines pass unchanged and the two end samples stay as they are.

    Assumes white noise of one level over the trial. The variance of a window includes the state's own slope: where it
    is steep the noise stays in. Takes any grid, as it looks only at the order of samples.

    Parameters
    ----------
    window
        Number of samples in the window, odd.

    Raises
    ------
    CommonlawError
        If `window` is not an odd number of at least 3, or a trial is shorter than it.
    """

    window: int = 5

    def __post_init__(self) -> None:
        check_window(self.window)

    @property
    def half_window(self) -> int | None:
        return None

    def smooth(self, times: Floats, states: Floats) -> Floats:
        fit_window(len(times), self.window)
        half = self.window // 2
        padded = np.pad(states, ((half, half), (0, 0)), mode="reflect", reflect_type="odd")
        windows = sliding_window_view(padded, self.window, axis=0)
        mean, variance = windows.mean(axis=-1), windows.var(axis=-1)
        noise = variance.mean(axis=0)
        gain = 1 - noise / np.maximum(variance, noise + (noise == 0))  # no noise at all: the mean is the state
        return np.asarray(mean + (states - mean) * gain)
