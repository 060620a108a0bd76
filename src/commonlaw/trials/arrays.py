"""Trials from arrays."""

import itertools
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from commonlaw.errors import CommonlawError
from commonlaw.text import shown
from commonlaw.trials.dates import Elapsed, elapsed
from commonlaw.trials.grouping import are_used, inputs_before, repeats_in_words
from commonlaw.trials.headers import joined_units
from commonlaw.trials.identifiers import label
from commonlaw.trials.properties import given_properties
from commonlaw.trials.trial import PropertyTable, Schema, Trial, TrialData, as_numbers, check_measured


def trials_from_arrays(
    times: Sequence[Any] | NDArray[Any],
    states: ArrayLike,
    object: object,
    trial: object,
    inputs: ArrayLike | None,
    noise: ArrayLike | None,
    names: Sequence[str] | None,
    units: Mapping[str, str] | None,
    properties: str | os.PathLike[str] | PropertyTable | Any,
) -> TrialData:
    """Return the trials in arrays, see `Trials.from_arrays`."""
    single = _is_one(times)
    runs, clock = _elapsed([times] if single else list(times))
    count = len(runs)
    objects = [label(each) for each in _per_trial("objects", object, count)]
    labels = _counted(objects) if trial is None else _per_trial("trial labels", trial, count)
    all_states = _per_trial("arrays of states", [states] if single else states, count)
    all_inputs = _per_trial("arrays of inputs", [inputs] if single else inputs, count)
    all_noise = _per_trial("arrays of standard deviations", [noise] if single else noise, count)
    parts = list(zip(objects, labels, runs, all_states, all_inputs, all_noise, strict=True))
    if not parts:
        raise CommonlawError("no-times")
    empty = [_empty(at, values, own) for _, _, at, values, own, _ in parts]
    made = tuple(_trial(gaps, *part) for gaps, part in zip(empty, parts, strict=True))
    columns = _columns(made[0], names)
    check_measured(made, columns[0])
    known = given_properties(properties, "object", list(dict.fromkeys(objects)))
    used = ["t", *columns[0], *columns[1], *known.names]
    noisy = {} if noise is None else {name: f"{name} noise" for name in columns[0]}
    headers = {**known.units, **({"t": clock.unit} if clock else {})}
    schema = Schema(*columns, units=joined_units(headers, units, used, used), noise_columns=noisy)
    gaps = [
        f"{each.label}: {shown([f'sample {here[0] + 1}', *(str(i + 1) for i in here[1:])])}"
        for each, here in zip(made, empty, strict=True)
        if len(here)
    ]
    notes = [f"t: dates taken as time in {clock.since}"] if clock else []
    notes += [f"samples without a measured state left out: {'; '.join(gaps)}"] if gaps else []
    return TrialData(
        made, schema, known.values, (*known.notes, *notes, *repeats_in_words(made)), set(objects) == {"object"}
    )


def _elapsed(runs: list[Any]) -> tuple[list[Any], Elapsed | None]:
    """Return times that are dates or durations as numbers, from the earliest of all trials on, and what they are in."""
    import pandas as pd

    kinds = {np.asarray(each).dtype.kind for each in runs}
    if kinds <= set("iufb") or not kinds <= set("mMO"):
        return runs, None
    whole = pd.Series([each for run in runs for each in run]).infer_objects()
    if whole.dtype.kind == "m":
        found = Elapsed(np.asarray(whole.dt.total_seconds(), dtype=np.float64), "s", "seconds")
    elif whole.dtype.kind == "M":
        found = elapsed(whole)
    else:
        return runs, None
    return np.split(found.values, np.cumsum([len(each) for each in runs])[:-1]), found


def _empty(times: Any, states: Any, inputs: Any) -> NDArray[np.int64]:
    """Return the indices of samples that say nothing, see `are_used`; none where `Trial` refuses the arrays."""
    try:
        values = states if type(states) is np.ndarray and states.dtype == np.float64 else as_numbers(states)
    except CommonlawError:
        return np.empty(0, dtype=np.int64)
    is_fit = values.size and values.ndim in (1, 2) and np.shape(times) == (len(values),)
    if not is_fit or np.isfinite(values).all():
        return np.empty(0, dtype=np.int64)
    used = are_used(values.reshape(len(values), -1), driven=inputs is not None and np.size(inputs) > 0)
    return np.flatnonzero(~used) if used.any() else np.empty(0, dtype=np.int64)


def _trial(empty: NDArray[np.int64], name: str, run: Any, times: Any, states: Any, inputs: Any, noise: Any) -> Trial:
    """Return a trial without its samples that are empty."""
    inputs, noise = (np.empty((0, 0)) if each is None else each for each in (inputs, noise))
    earlier = np.empty((0, 0))
    if len(empty):
        if np.size(inputs):
            used = np.isin(np.arange(len(times)), empty, invert=True)
            earlier = inputs_before(as_numbers(times), as_numbers(inputs).reshape(len(times), -1), used)
        times, states = np.delete(times, empty), np.delete(as_numbers(states), empty, axis=0)
        inputs, noise = (np.delete(each, empty, axis=0) if np.size(each) else each for each in (inputs, noise))
    return Trial(name, run, times, states, inputs, noise, earlier=earlier)


def _is_one(times: Any) -> bool:
    """Say whether times are of one trial, and not a list of such arrays."""
    return not hasattr(times, "__iter__") or np.ndim(next(iter(times), [])) == 0


def _per_trial(what: str, values: Any, count: int) -> list[Any]:
    """Return one value for each trial; a single name, or nothing, is for all of them."""
    if values is None or isinstance(values, str) or not hasattr(values, "__len__"):
        return [values] * count
    if len(values) != count:
        raise CommonlawError("one-per-trial", given=len(values), parts=what, trials=count)
    return list(values)


def _counted(objects: Sequence[str]) -> list[str]:
    """Return labels that count the trials of each object from 1."""
    counters = {name: itertools.count(1) for name in objects}
    return [str(next(counters[name])) for name in objects]


def _columns(trial: Trial, names: Sequence[str] | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the states and of the inputs."""
    states, inputs = trial.states.shape[1], trial.inputs.shape[1]
    if names is None:
        return _numbered("x", states), _numbered("u", inputs)
    listed = isinstance(names, list | tuple | np.ndarray) and all(isinstance(name, str) for name in names)
    if not listed or len(names) != states + inputs:
        driven = f" and {inputs} of inputs" if inputs else ""
        raise CommonlawError("names-count", names=names, states=states, inputs=driven)
    return tuple(names[:states]), tuple(names[states:])


def _numbered(letter: str, count: int) -> tuple[str, ...]:
    return (letter,) if count == 1 else tuple(f"{letter}{i}" for i in range(1, count + 1))
