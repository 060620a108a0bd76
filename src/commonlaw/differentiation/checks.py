"""What the methods ask of their parameters and of a trial's samples."""

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.validation import check_whole_number


def check_window(window: int) -> None:
    """Refuse a window that is not an odd number of samples, three or more: it has to have a sample in its middle.

    Raises
    ------
    CommonlawError
        If the window is none.
    """
    check_whole_number("window", window, 3)
    if window % 2 == 0:
        raise CommonlawError(f"window is {window}, an even number: give an odd one, such as {window + 1}")


def need_samples(count: int, needed: int, method: str) -> None:
    """Refuse a trial of fewer samples than the method's formula takes.

    Raises
    ------
    CommonlawError
        If there are fewer than `needed`.
    """
    if count < needed:
        raise CommonlawError(
            f"{count} samples are fewer than the {needed} that {method} take; drop the trial or choose another method"
        )


def fit_window(count: int, window: int) -> None:
    """Refuse a trial of fewer samples than the window.

    Raises
    ------
    CommonlawError
        If there are fewer; the message has the largest window that fits.
    """
    if count < window:
        largest = count - 1 + count % 2
        way_out = f"choose a window of at most {largest}" if largest >= 3 else "drop the trial"
        raise CommonlawError(f"{count} samples are fewer than the window of {window}; {way_out}")


def check_uniform(times: Floats, tolerance: float, method: str) -> None:
    """Refuse times with a step that differs from the median step by more than `tolerance` of it.

    Raises
    ------
    CommonlawError
        If there is such a step; the message names the first one.
    """
    steps = np.diff(times)
    median = np.median(steps)
    far = np.flatnonzero(np.abs(steps - median) > tolerance * median)
    if len(far):
        i = int(far[0])
        raise CommonlawError(
            f"the step from sample {i + 1} to sample {i + 2} is {steps[i]:g}, the median step {median:g}: {method} "
            f"assumes uniform sampling (steps within {tolerance:.0%} of the median); cut the trial there, resample it, "
            "or choose a method for any grid, such as 'finite' or 'spline'"
        )
