"""Irregular ends: frames at the end of a trial that were not taken when they were due."""

from collections.abc import Sequence

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.trial import Trial


def regular_length(times: Floats, tolerance: float) -> int:
    """Return the number of samples, from the first, that clipping at the last irregular frame keeps.

    With steps dt = diff(t), a frame i is irregular if abs(dt[i] - median(dt)) > tolerance; the samples up to the last
    such frame are kept.

    Parameters
    ----------
    times
        Sample times, shape (n,).
    tolerance
        How far a step may be from the median step, in the unit of the times.
    """
    if len(times) < 2:
        return len(times)
    steps = np.diff(times)
    irregular = np.flatnonzero(np.abs(steps - np.median(steps)) > tolerance)
    return int(irregular[-1]) + 1 if len(irregular) else len(times)


def clip_irregular(trials: Sequence[Trial], tolerance: float) -> tuple[list[Trial], str]:
    """Return the trials, each clipped at its last irregular frame, and a note of which and how far; empty if none.

    Parameters
    ----------
    trials
        The trials.
    tolerance
        How far a step may be from the trial's median step, in the unit of the times.

    Raises
    ------
    CommonlawError
        If the tolerance is not positive.
    """
    if not tolerance > 0:
        raise CommonlawError(f"the tolerance of a step is {tolerance}, and must be a positive time such as 0.005")
    kept = [trial.cut(regular_length(trial.times, tolerance)) for trial in trials]
    clipped = [
        f"{before.label} from {len(before)} to {len(after)} samples"
        for before, after in zip(trials, kept, strict=True)
        if len(after) < len(before)
    ]
    if not clipped:
        return kept, ""
    reason = f"irregular frame, a step more than {tolerance:g} off the trial's median step"
    return kept, f"clipped {'; '.join(clipped)}: {reason}"
