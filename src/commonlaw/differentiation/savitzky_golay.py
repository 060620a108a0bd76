"""Savitzky-Golay smoothing."""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation.base import AbstractSmoother
from commonlaw.differentiation.checks import check_uniform, check_window, fit_window
from commonlaw.errors import CommonlawError
from commonlaw.validation import check_whole_number


@dataclass(frozen=True)
class SavitzkyGolay(AbstractSmoother):
    """Each sample becomes the value of a polynomial fitted to the window around it (Savitzky and Golay 1964).

    The first and last half window take the polynomials of the first and last whole window. Polynomials up to the
    given degree pass unchanged.

    Assumes uniform sampling (steps within 50 % of the median; small jitter is passed over), white noise, and states
    that a polynomial of the given degree follows over one window.

    Parameters
    ----------
    window
        Number of samples in the window, odd.
    polynomial
        Degree of the polynomial, less than `window`.

    Raises
    ------
    CommonlawError
        If a parameter does not fit, a trial is shorter than the window, or its sampling is not uniform.
    """

    window: int = 35
    polynomial: int = 3

    def __post_init__(self) -> None:
        check_window(self.window)
        check_whole_number("polynomial", self.polynomial, 0)
        if self.polynomial >= self.window:
            raise CommonlawError(
                f"a polynomial of degree {self.polynomial} passes through every sample of a window of {self.window}; "
                f"choose a degree of at most {self.window - 1}"
            )

    @property
    def half_window(self) -> int | None:
        return self.window // 2

    def smooth(self, times: Floats, states: Floats) -> Floats:
        from scipy.signal import savgol_filter

        fit_window(len(times), self.window)
        check_uniform(times, 0.5, "Savitzky-Golay smoothing")
        return np.asarray(savgol_filter(states, self.window, self.polynomial, axis=0, mode="interp"))
