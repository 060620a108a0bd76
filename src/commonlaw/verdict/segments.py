"""The segments of trials that a law is judged on, and what it forecasts there."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.law import Law
from commonlaw.trials import Trial, Trials

SHARE = 0.35
"""Share of each trial, its end, that a law is judged on where nothing was held out."""

_BEFORE, _LEAST_BEFORE = 0.2, 5
"""Share of a held-out trial, its beginning, that tells where its forecast starts, and how many samples at least."""

_MOST_BEFORE = 200
"""So many samples before a segment tell where its forecast starts, as more take long and add little."""

_TOLERANCE = 1e-6
"""Relative error of a step, far below that of any measurement."""


class Kind(StrEnum):
    """Where a segment comes from."""

    TRIAL = "trials that were held out"
    LATER = "later samples that were held out"
    SEEN = f"the last {100 * SHARE:.0f} % of trials"


@dataclass(frozen=True, eq=False)
class Segment:
    """A trial, without samples in which nothing was measured, and the index of the first one that is judged."""

    trial: Trial
    first: int
    kind: Kind


@dataclass(frozen=True, eq=False)
class SegmentErrors:
    """What the forecast of a segment was off.

    Parameters
    ----------
    leads
        How far ahead of the last sample before the segment, shape (n,).
    errors
        Forecast less measured states, shape (n, states): infinite after a divergence, NaN where nothing was measured.
    persistence
        The same of the last values that were measured before the segment.
    inside
        1 where the 95 % band held the measurement, 0 where it did not, NaN where there is none, shape (n, states).
    noise
        Standard deviation of the measurements without errors that have a memory, shape (n, states); NaN where unknown.
    diverged
        Whether the forecast ran away.
    """

    leads: Floats
    errors: Floats
    persistence: Floats
    inside: Floats
    noise: Floats
    diverged: bool


def segments(trials: Trials, learned: Trials | None) -> list[Segment]:
    """Return what was held out of learning, trials or later samples; if nothing was, the end of each trial."""
    if learned is not None:
        held_out = list(_held_out(trials, learned))
        if held_out:
            return held_out
    measured = [trial.measured() for trial in trials]
    return [Segment(each, int(np.ceil((1 - SHARE) * len(each))), Kind.SEEN) for each in measured]


def samples_before(count: int) -> int:
    """Return how many of the samples of a trial tell where its forecast starts."""
    return max(_LEAST_BEFORE, int(np.ceil(_BEFORE * count)))


def _held_out(trials: Trials, learned: Trials) -> Iterator[Segment]:
    ends = {(each.object, each.name): each.measured().times[-1] for each in learned}
    for trial in trials:
        measured, end = trial.measured(), ends.get((trial.object, trial.name))
        if end is None:
            yield Segment(measured, samples_before(len(measured)), Kind.TRIAL)
        elif measured.times[-1] > end:
            yield Segment(measured, int(np.searchsorted(measured.times, end, side="right")), Kind.LATER)


def forecast_errors(law: Law, trials: Trials, segment: Segment) -> SegmentErrors:
    """Return what the law's forecast of a segment of the only trial is off, from a start fitted to the samples before.

    Raises
    ------
    CommonlawError
        If it cannot be forecast.
    """
    trial, first, states = segment.trial, segment.first, len(law.states)
    fits = law.order > 0 and law.noise is not None
    forecast = law.predict(
        trials,
        start=_MOST_BEFORE if fits and first > _MOST_BEFORE else None,
        from_time=float(trial.times[first]),
        return_std=law.has_std,
        tolerance=_TOLERANCE,
    )
    ahead, measured = forecast.ahead[0], trial.states[first:]
    errors = forecast.trajectories[0].states[ahead, :states] - measured
    diverged = bool(forecast.outcomes)
    errors[np.isnan(errors) & np.isfinite(measured)] = np.inf
    inside, noise = np.full((2, *errors.shape), np.nan)
    if forecast.std is not None:
        noise = np.where(np.isfinite(measured), forecast.measurement_std(white=True)[0][ahead], np.nan)
        low, high = (end[ahead] for end in forecast.bands(measured=True)[0])
        held = (low <= measured) & (measured <= high)
        inside = np.where(np.isfinite(high - low) & np.isfinite(errors), held, np.nan)
    leads = trial.times[first:] - trial.times[first - 1]
    return SegmentErrors(leads, errors, _last(trial.states[:first]) - measured, inside, noise, diverged)


def _last(states: Floats) -> Floats:
    """Return the last measured value of each state, shape (states,); NaN where there is none."""
    found = [column[np.isfinite(column)] for column in states.T]
    return np.array([column[-1] if len(column) else np.nan for column in found])
