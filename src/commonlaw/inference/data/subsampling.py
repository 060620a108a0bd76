"""Subsampling of long trials, up to the sample limit of the trajectory likelihood.

Samples are first thinned by a stride, as coefficients and frequencies are better identified by a long trial than by
many samples. The stride is at most 1/`MIN_RESOLUTION` of that up to which differences of samples still estimate the
noise. If too many samples remain, segments that are evenly spaced over the trials of each object are kept.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Floats, evenly_spaced
from commonlaw.differentiation import noise_level
from commonlaw.inference import settings
from commonlaw.inference.data.segments import segment
from commonlaw.likelihood import MAX_MESH_SAMPLES
from commonlaw.runtime.fit_options import FitOptions
from commonlaw.text import counted
from commonlaw.trials import Trial, Trials


def subsample(trials: Trials, noise: Floats, most: int) -> tuple[Trials, str]:
    """Return the trials with at most `most` samples, and a description of the subsample, empty if these are all.

    The noise of each state by all samples has shape (states,).
    """
    total = sum(map(len, trials))
    if total <= most:
        return trials, ""
    wanted = -(-total // most)
    longest, coarse, most_coarse = max(trials, key=len), 1, settings.MIN_RESOLUTION * wanted
    if not trials.schema.inputs:  # Inputs between omitted samples would be lost
        # Samples once in a cycle are aliased
        while coarse < most_coarse and _resolves_noise(longest, noise, 2 * coarse):
            coarse *= 2
    stride = max(min(wanted, coarse // settings.MIN_RESOLUTION), 1)
    thinned = [trial.rows(slice(None, None, stride)) for trial in trials]
    groups = [[trial for trial in thinned if trial.object == name] for name in trials.objects]
    share = max(_share([sum(map(len, group)) for group in groups], most), settings.MAX_CURVE_POINTS)
    fitted = [segment for group in groups for segment in _evenly_spaced_segments(group, share)]
    kept = sum(map(len, fitted))
    how = [f"every {_ordinal(stride)}"] if stride > 1 else []
    if kept < sum(map(len, thinned)):
        how.append(f"in {counted(len(fitted), 'segment')} spread over the trials")
    return trials.with_trials(fitted), f"{kept} of {total}: {', '.join(how)}" if how else ""


def can_be_subsampled(trials: Trials) -> bool:
    """Return whether all objects keep enough samples in a subsample."""
    counts = (sum(map(len, trials.of_object(name))) for name in trials.objects)
    return sum(min(count, settings.MAX_CURVE_POINTS) for count in counts) <= FitOptions.max_samples


def _resolves_noise(trial: Trial, noise: Floats, stride: int) -> bool:
    """Return whether differences at a stride estimate the noise, not larger by two standard errors, of all states."""
    around = max(0, len(trial) // 2 - stride * settings.MAX_SCREENED_SAMPLES // 2)
    thinned = trial.rows(slice(around, around + stride * settings.MAX_SCREENED_SAMPLES, stride))
    most = (1 + 2 / np.sqrt(2 * settings.MIN_SAMPLES_OF_MANY)) * noise
    known = np.isfinite(thinned.states).T
    return all(
        seen.sum() >= settings.MIN_SAMPLES_OF_MANY
        and noise_level(thinned.times[seen], column[seen, np.newaxis])[0] <= level
        for column, seen, level in zip(thinned.states.T, known, most, strict=True)
    )


def _share(counts: Sequence[int], most: int) -> int:
    """Return the limit of samples of each object at which all objects have together at most so many (water-filling)."""
    rest = float(most)
    for done, count in enumerate(ordered := sorted(counts)):
        if count * (len(ordered) - done) > rest:
            return int(rest // (len(ordered) - done))
        rest -= count
    return max(counts)


def _evenly_spaced_segments(trials: Sequence[Trial], share: int) -> list[Trial]:
    """Return evenly spaced segments of the trials of an object, of `share` samples together."""
    if sum(map(len, trials)) <= share:
        return list(trials)
    longest = min(MAX_MESH_SAMPLES, max(share // settings.MAX_OBJECTS, min(share, settings.MAX_CURVE_POINTS)))
    segments = list[Trial]()
    for trial in trials:
        count = -(-len(trial) // longest)
        for first, stop in pairwise(len(trial) * i // count for i in range(count + 1)):
            segments.append(trial if count == 1 else segment(trial, first, stop))
    count = max(1, int(share / np.mean([len(segment) for segment in segments])))
    return [segments[i] for i in evenly_spaced(len(segments), count)]


def _ordinal(number: int) -> str:
    """Return the ordinal of a number.

    >>> [_ordinal(n) for n in (2, 3, 11, 21)]
    ['2nd', '3rd', '11th', '21st']
    """
    ending = "th" if number % 100 in (11, 12, 13) else {1: "st", 2: "nd", 3: "rd"}.get(number % 10, "th")
    return f"{number}{ending}"
