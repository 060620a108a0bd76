"""Subsampling of long trials, up to the sample limit of the trajectory likelihood.

Where samples are much closer than what the states do between them, fewer of them tell a law as well if they reach as
far, and its rates and frequencies better than a part of the time would; so samples are thinned first. They are not
thinned further than their differences still tell noise from motion, as everything begins with a curve through them. If
more are left than can be carried, the rest is segments that are spread over the trials of each object.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Floats, evenly_spaced
from commonlaw.differentiation import noise_level
from commonlaw.inference import settings
from commonlaw.likelihood import MAX_MESH_SAMPLES
from commonlaw.text import counted
from commonlaw.trials import Trial, Trials


@dataclass(frozen=True, eq=False)
class FittedSamples:
    """The trials that are fitted, and in words what of all samples these are; nothing if they are all."""

    trials: Trials
    words: str = ""


def as_many_as_are_carried(trials: Trials, noise: Floats, most: int = settings.MAX_SAMPLES) -> FittedSamples:
    """Return the trials, or if they have more samples than are carried, what of them is fitted.

    Parameters
    ----------
    trials
        What was measured.
    noise
        Standard deviation of each state's measurement noise, by all samples, shape (states,).
    most
        Samples that are carried.
    """
    total = sum(map(len, trials))
    if total <= most:
        return FittedSamples(trials)
    wanted = -(-total // most)
    # Between samples that are left out, inputs may do anything
    stride = 1 if trials.schema.inputs else _stride(list(trials), noise, wanted)
    thinned = [each.rows(slice(None, None, stride)) for each in trials]
    groups = [[each for each in thinned if each.object == name] for name in trials.objects]
    share = max(_share([sum(map(len, group)) for group in groups], most), settings.MAX_CURVE_POINTS)
    fitted = [segment for group in groups for segment in _spread_segments(group, share)]
    kept = sum(map(len, fitted))
    how = [f"every {_ordinal(stride)}"] if stride > 1 else []
    if kept < sum(map(len, thinned)):
        how.append(f"in {counted(len(fitted), 'segment')} spread over the trials")
    return FittedSamples(trials.with_trials(fitted), f"{kept} of {total}: {', '.join(how)}" if how else "")


def can_be_carried(trials: Trials) -> bool:
    """Whether no object must lose so many samples that few are left of it."""
    of_objects = Counter[str]()
    for trial in trials:
        of_objects[trial.object] += len(trial)
    return sum(min(count, settings.MAX_CURVE_POINTS) for count in of_objects.values()) <= settings.MAX_SAMPLES


def _stride(trials: Sequence[Trial], noise: Floats, wanted: int) -> int:
    """Return the stride that thins samples, at most as wanted: much finer than one that still tells the noise."""
    longest, coarse = max(trials, key=len), 1
    # From fine to coarse: samples once in a turn look slow
    while coarse < settings.MIN_RESOLUTION * wanted and _tells_noise(longest, noise, 2 * coarse):
        coarse *= 2
    return max(min(wanted, coarse // settings.MIN_RESOLUTION), 1)


def _tells_noise(trial: Trial, noise: Floats, stride: int) -> bool:
    around = max(0, len(trial) // 2 - stride * settings.MAX_SCREENED_SAMPLES // 2)
    looked_at = trial.rows(slice(around, around + stride * settings.MAX_SCREENED_SAMPLES, stride))
    for column, level in zip(looked_at.states.T, noise, strict=True):
        known = np.isfinite(column)
        if known.sum() < settings.MIN_SAMPLES_OF_MANY:
            return False
        if (
            noise_level(looked_at.times[known], column[known, np.newaxis])[0]
            > (1 + 2 / np.sqrt(2 * settings.MIN_SAMPLES_OF_MANY)) * level
        ):
            return False
    return True


def _share(counts: Sequence[int], most: int) -> int:
    """Return how many samples an object may have so that all of them have together at most so many."""
    left = float(most)
    for done, count in enumerate(ordered := sorted(counts)):
        if count * (len(ordered) - done) > left:
            return int(left // (len(ordered) - done))
        left -= count
    return max(counts)


def _spread_segments(trials: Sequence[Trial], share: int) -> list[Trial]:
    """Return segments of an object's trials of so many samples together, spread evenly; all if they have no more."""
    if sum(map(len, trials)) <= share:
        return list(trials)
    longest = min(MAX_MESH_SAMPLES, max(share // settings.MAX_OBJECTS, min(share, settings.MAX_CURVE_POINTS)))
    segments = list[Trial]()
    for trial in trials:
        count = -(-len(trial) // longest)
        ends = [len(trial) * i // count for i in range(count + 1)]
        segments += (
            [trial]
            if count == 1
            else [
                replace(trial.rows(slice(first, stop)), name=f"{trial.name}, samples {first + 1} to {stop}")
                for first, stop in pairwise(ends)
            ]
        )
    count = max(1, int(share / np.mean([len(each) for each in segments])))
    return [segments[i] for i in evenly_spaced(len(segments), count)]


def _ordinal(number: int) -> str:
    """Return the number as one counts.

    >>> [_ordinal(each) for each in (2, 3, 11, 21)]
    ['2nd', '3rd', '11th', '21st']
    """
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"
