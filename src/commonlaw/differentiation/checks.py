"""What the methods ask of their parameters and of a trial's samples."""

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError


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
