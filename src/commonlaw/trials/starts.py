"""States that nobody measured, by where trials start in them: a dose, the size of a population."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.property_inputs import number_of
from commonlaw.trials.trial import Start, Trial
from commonlaw.trials.trials import Trials


def with_starts(trials: Trials, starts: Mapping[str, Start], at: float | None = None) -> Trials:
    """Return trials with further states, of which each trial has one value: where it starts, in its first sample.

    Parameters
    ----------
    trials
        What was measured.
    starts
        By state: a number, the name of a property of the objects, or a number for each object by its name; None for
        states that start where nobody knows, which have no value. States that the trials have are passed over; the
        others have the unit of the property, unless they have one.
    at
        The time of the starts, if that is not the first sample: trials that begin later get a sample there, at which
        nothing else was measured, and inputs are as in their first one.

    Raises
    ------
    CommonlawError
        If there is no such property, a start is no finite number for some object, or a trial begins before the time.
    """
    new = {name: start for name, start in starts.items() if name not in trials.schema.states}
    if not new:
        return trials
    values = {
        owner: np.array([_of_object(name, start, owner, trials) for name, start in new.items()])
        for owner in trials.objects
    }
    schema = trials.schema
    units = {name: schema.units[str(start)] for name, start in new.items() if str(start) in schema.units}
    schema = replace(
        schema,
        states=(*schema.states, *new),
        starts={**schema.starts, **new},
        starts_at=at,
        units={**units, **schema.units},
    )
    changed = tuple(_with_first(trial, values[trial.object], at) for trial in trials)
    return replace(trials, trials=changed, schema=schema)


def _of_object(state: str, start: Start, owner: str, trials: Trials) -> float:
    if start is None:
        return np.nan
    if isinstance(start, str):
        return number_of(start, owner, trials)
    value = start.get(owner, np.nan) if isinstance(start, Mapping) else start
    if not np.isfinite(value):
        raise CommonlawError("initial-value-not-finite", state=state, value=value, object=owner)
    return float(value)


def _with_first(trial: Trial, values: Floats, at: float | None) -> Trial:
    """Return a trial with further states, which have these values in its first sample, and none in others."""
    columns = [trial.times[:, np.newaxis], trial.states, trial.inputs, trial.noise]
    if at is not None and trial.times[0] < at:
        raise CommonlawError("initial-time-late", trial=trial.label, time=trial.times[0], initial_time=at)
    if at is not None and trial.times[0] > at:
        unknown = np.full((1, trial.states.shape[1]), np.nan)
        before = np.array([[at]]), unknown, trial.inputs[:1], unknown
        columns = [np.concatenate(pair) for pair in zip(before, columns, strict=True)]
    times, states, inputs, noise = columns
    unknown = np.full((len(times), len(values)), np.nan)
    starts = unknown.copy()
    starts[0] = values
    repeats = trial.repeats and trial.repeats.placed(np.arange(len(times) - len(trial), len(times)), len(times))
    return replace(
        trial,
        repeats=repeats and repeats.wider(len(values)),
        times=times[:, 0],
        states=np.column_stack([states, starts]),
        inputs=inputs,
        noise=np.column_stack([noise, unknown]),
    )
