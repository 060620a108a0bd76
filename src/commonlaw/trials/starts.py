"""States that nobody measured, by where trials start in them: a dose, the size of a population."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.property_inputs import number_of
from commonlaw.trials.trial import Start, Trial
from commonlaw.trials.trials import Trials


def with_starts(trials: Trials, starts: Mapping[str, Start]) -> Trials:
    """Return trials with further states, of which each trial has one value: where it starts, in its first sample.

    Parameters
    ----------
    trials
        What was measured.
    starts
        By state: a number, the name of a property of the objects, or a number for each object by its name. States that
        the trials have are passed over; the others have the unit of the property, unless they have one.

    Raises
    ------
    CommonlawError
        If there is no such property, or a start is no finite number for some object.
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
        schema, states=(*schema.states, *new), starts={**schema.starts, **new}, units={**units, **schema.units}
    )
    return replace(trials, trials=tuple(_with_first(trial, values[trial.object]) for trial in trials), schema=schema)


def _of_object(state: str, start: Start, owner: str, trials: Trials) -> float:
    if isinstance(start, str):
        return number_of(start, owner, trials)
    value = start.get(owner, np.nan) if isinstance(start, Mapping) else start
    if not np.isfinite(value):
        raise CommonlawError(f"the start of {state} is {value} for {owner}: give a finite number for each object")
    return float(value)


def _with_first(trial: Trial, values: Floats) -> Trial:
    """Return a trial with further states, which have these values in its first sample, and none in others."""
    unknown = np.full((len(trial), len(values)), np.nan)
    states = unknown.copy()
    states[0] = values
    return replace(
        trial,
        states=np.column_stack([trial.states, states]),
        noise=np.column_stack([trial.noise, unknown]),
    )
