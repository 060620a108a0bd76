"""The forecasts that a law is judged by: where they begin, which measurements they are compared with, their errors."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.law import Law
from commonlaw.library import Order, highest_order
from commonlaw.trials import Trial, Trials

_BEFORE = 0.2
"""Share of a trial, its beginning, that tells where a forecast starts: so much averages the noise of a start, and
leaves growth that has just begun to be forecast."""

_RATES = 5
"""Samples that tell the first rates at least: fewer leave them to the noise."""

_MOST_BEFORE = 200
"""So many samples before a forecast tell where it starts, as more take long and add little."""

_TOLERANCE = 1e-6
"""Relative error of a step, far below that of any measurement."""


class Kind(StrEnum):
    """Where a segment comes from."""

    TRIAL = "held-out trials"
    LATER = "held-out later samples"
    SEEN = "whole trials"


@dataclass(frozen=True, eq=False)
class Segment:
    """A forecast to be judged.

    Parameters
    ----------
    trial
        Without samples in which nothing was measured.
    origin
        Index of the first sample that is forecast; those before tell the start.
    first
        Index of the first sample that is compared.
    kind
        Where it comes from.
    """

    trial: Trial
    origin: int
    first: int
    kind: Kind


@dataclass(frozen=True, eq=False)
class SegmentErrors:
    """The errors of the forecast of a segment.

    Parameters
    ----------
    leads
        How far ahead of the last sample before the forecast, shape (n,).
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


def segments(trials: Trials, learned: Trials | None, order: Order) -> list[Segment]:
    """Return the forecasts that judge a law: from the first samples of trials, over all that follows.

    Of what was held out of learning, trials or later samples; if nothing was, of all trials. So growth is judged while
    it grows, and where it has ended. Later samples are forecast from the end of what was learned, too.
    """
    if learned is not None:
        held_out = list(_held_out(trials, learned, order))
        if held_out:
            return held_out
    return [Segment(each, at, at, Kind.SEEN) for each in map(Trial.measured, trials) for at in origins(each, order)]


def origins(trial: Trial, order: Order) -> tuple[int, ...]:
    """Return where forecasts of a trial begin: after its first sample, if that tells a start, and its first fifth.

    One sample tells no rates: a law that has some begins after the first fifth, of five samples at least.
    """
    fifth = samples_before(len(trial), order)
    if highest_order(order) == 2:
        return (fifth,)
    seen = np.isfinite(trial.states)
    whole = np.flatnonzero((seen | ~seen.any(axis=0)).all(axis=1))
    first = int(whole[0]) + 1 if len(whole) else fifth
    return tuple(sorted({first, max(first, fifth)}))


def samples_before(count: int, order: Order) -> int:
    """Return how many of the samples of a trial tell where its forecast starts, if these average the noise."""
    return max(_RATES if highest_order(order) == 2 else 1, int(np.ceil(_BEFORE * count)))


def _held_out(trials: Trials, learned: Trials, order: Order) -> Iterator[Segment]:
    ends = {(each.object, each.name): each.measured().times[-1] for each in learned}
    for trial in trials:
        measured, end = trial.measured(), ends.get((trial.object, trial.name))
        if end is None:
            for origin in origins(measured, order):
                yield Segment(measured, origin, origin, Kind.TRIAL)
        elif measured.times[-1] > end:
            first = int(np.searchsorted(measured.times, end, side="right"))
            early = [each for each in origins(measured, order) if each < first]
            for origin in (*early, first):
                yield Segment(measured, origin, first, Kind.LATER)


def forecast_errors(law: Law, trials: Trials, segment: Segment) -> SegmentErrors:
    """Return the errors of the forecast of a segment of the only trial, its start fitted to the samples before.

    Where the law was learned from the whole trial, and one sample is before, the start is fitted to the first fifth of
    them: that sample alone may be below the noise, which says nothing of the law. The trial may have samples in which
    nothing was measured, too.

    Raises
    ------
    CommonlawError
        If it cannot be forecast.
    """
    trial, origin, first, states = segment.trial, segment.origin, segment.first, len(law.states)
    fits = law.order != 0 and law.noise is not None
    how: dict[str, Any] = {"start": _MOST_BEFORE if fits and origin > _MOST_BEFORE else None}
    how |= {"from_time": float(trial.times[origin])}
    if fits and segment.kind is Kind.SEEN and origin == 1:
        how = {"start": max(2, samples_before(len(trial), law.order))}
    forecast = law.predict(trials, return_std=law.has_std, tolerance=_TOLERANCE, **how)
    rows = np.flatnonzero(np.isfinite(forecast.trials[0].states).any(axis=1))
    compared, measured = rows[first - len(trial) :], trial.states[first:]
    errors = forecast.trajectories[0].states[compared, :states] - measured
    diverged = bool(forecast.outcomes)
    errors[np.isnan(errors) & np.isfinite(measured)] = np.inf
    inside, noise = np.full((2, *errors.shape), np.nan)
    if forecast.std is not None:
        noise = np.where(np.isfinite(measured), forecast.measurement_std(white=True)[0][compared], np.nan)
        low, high = (end[compared] for end in forecast.bands(measured=True)[0])
        held = (low <= measured) & (measured <= high)
        inside = np.where(np.isfinite(high - low) & np.isfinite(errors), held, np.nan)
    leads = trial.times[first:] - trial.times[origin - 1]
    return SegmentErrors(leads, errors, _last(trial.states[:origin]) - measured, inside, noise, diverged)


def _last(states: Floats) -> Floats:
    """Return the last measured value of each state, shape (states,); NaN where there is none."""
    found = [column[np.isfinite(column)] for column in states.T]
    return np.array([column[-1] if len(column) else np.nan for column in found])
