"""Median smoothing."""

from dataclasses import dataclass

from commonlaw.array_types import Floats
from commonlaw.differentiation.base import AbstractSmoother
from commonlaw.differentiation.checks import check_window, fit_window


@dataclass(frozen=True)
class MedianFilter(AbstractSmoother):
    """Each sample becomes the median of the window around it (Tukey 1977, chapter 7).

    Beyond the ends the first and last sample are repeated: a monotone state passes unchanged, and nothing pulls the
    ends toward zero. An outlier in the very first or last sample stays.

    Assumes rare, large outliers, fewer than half of any window; against ordinary noise it does little, and its steps
    show in the rates. Takes any grid, as it looks only at the order of samples.

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
        return self.window // 2

    def smooth(self, times: Floats, states: Floats) -> Floats:
        from scipy.ndimage import median_filter

        fit_window(len(times), self.window)
        smoothed: Floats = median_filter(states, size=(self.window, 1), mode="nearest")
        return smoothed
