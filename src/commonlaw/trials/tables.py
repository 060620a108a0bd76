"""Trials from tables and from arrays."""

import itertools
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from commonlaw.errors import CommonlawError
from commonlaw.text import shown
from commonlaw.trials.columns import Codes, Table, with_numbers, with_unit
from commonlaw.trials.dates import Elapsed, elapsed, first_time, with_dates_as_times
from commonlaw.trials.grouping import are_used, groups_of, inputs_before, read_cells, repeats_in_words, trials_of
from commonlaw.trials.headers import joined_units, known_unit, label
from commonlaw.trials.properties import column_properties, given_properties, object_codes
from commonlaw.trials.reading import Reading, checked, notation_of
from commonlaw.trials.recognition import unit_in_name
from commonlaw.trials.roles import ColumnRoles, column_roles, free_columns, time_of
from commonlaw.trials.trial import PropertyTable, Schema, Trial, TrialData, as_numbers, check_measured
from commonlaw.trials.wide import NOISE, long_table, times_across


@dataclass(frozen=True)
class Rows:
    """What the rows of a table make: trials and what goes with them, and the labels of trials without any row left."""

    data: TrialData
    empty: tuple[str, ...]
    row_indices: tuple[Codes, ...]
    """Of each trial the indices of the rows of its samples, shape (n,)."""
    columns: ColumnRoles
    """What columns were taken for."""

    def at(self, rows: Codes) -> "Rows":
        """Return the same, where each row was one of these of another table."""
        return replace(self, row_indices=tuple(rows[row_index] for row_index in self.row_indices))


def rows_of(table: Table, roles: Reading) -> Rows:
    """Return what the rows of a whole table make, see `Trials.read`."""
    table, said, samples, columns, origin = _recognized(table, roles)
    if columns.wide:
        rows = _long_rows(table, said, columns)
    elif len(samples) < len(table):
        rows = read_rows(table, said)
    else:
        rows = _rows(samples, said, columns, columns)
    if origin is not None:
        rows = rows.at(origin)
    if rows.empty:
        raise CommonlawError("nothing-measured", trial=rows.empty[0])
    check_measured(rows.data.trials, rows.data.schema.states)
    return rows


def column_roles_of(table: Table, roles: Reading) -> ColumnRoles:
    """Return which column is what, also where the rows make no trials."""
    return _recognized(table, roles)[3]


def _recognized(table: Table, roles: Reading) -> tuple[Table, Reading, Table, ColumnRoles, Codes | None]:
    """Return a table with its numbers read, what is said of it, its rows from the first time on, and its columns.

    If its columns were times, it has a row for each cell: last come the rows of these in the table as it came in.
    """
    said = cast(Reading, {**table.roles, **checked(roles)})
    table, origin = with_numbers(table, notation_of(said)), None
    if table.facts:
        table = replace(table, facts=(), notes=(f"{table.source}: {'; '.join(table.facts)}", *table.notes))
    if said.get("time") not in table.columns and (across := times_across(table, said.get("wide"))) is not None:
        table, origin = across
        said = cast(Reading, {**table.roles, **said, "wide": None})
    time = time_of(table, said)
    first = first_time(table, time)
    samples = _with_times(table.taken(np.arange(first, len(table))) if first else table, said, time)
    return table, said, samples, column_roles(samples, said, time), origin


def _with_times(table: Table, roles: Reading, time: str) -> Table:
    return with_dates_as_times(table, time, roles.get("dates"), free_columns(table, roles))


def _long_rows(table: Table, said: Reading, columns: ColumnRoles) -> Rows:
    """Return the trials in a table that has a column for each object."""
    if columns.object is not None:
        raise CommonlawError("wide-with-object", where=table.source, column=columns.object)
    long, state, origin = long_table(table, columns.time, columns.states, columns.noise_columns, columns.wide)
    noise = {state: state + NOISE} if state + NOISE in long.columns else {}
    roles: Reading = {
        **said, "object": "object", "time": columns.time, "states": [state], "inputs": columns.inputs,
        "noise_columns": noise,
    }  # fmt: skip
    long = _with_times(long, roles, columns.time)
    rows = _rows(long, roles, column_roles(long, roles, columns.time), columns).at(origin)
    return replace(rows, data=rows.data._replace(schema=replace(rows.data.schema, wide=columns.states)))


def read_rows(table: Table, roles: Reading) -> Rows:
    """Return the trials in a table, which may end within a trial."""
    time = time_of(table, roles)
    table = _with_times(table, roles, time)
    columns = column_roles(table, roles, time)
    return _rows(table, roles, columns, columns)


def _rows(table: Table, roles: Reading, columns: ColumnRoles, shown: ColumnRoles) -> Rows:
    """Return the trials in a table whose columns have these roles, of a long one those `shown` of a wide one."""
    if columns.object is not None and "object_name" in roles:
        raise CommonlawError("object-column-and-name", where=table.source, column=columns.object)
    owners, objects, spelled = _labels(table, columns.object, "object", roles.get("object_name") or table.label)
    runs, labels, spelled_runs = _labels(table, columns.trial, "trial", "1")
    if columns.properties is None:
        known = given_properties(roles["properties"], columns.object or "object", objects)
    else:
        known = column_properties(table, columns.properties, owners, objects)
    names = [columns.time, *columns.states, *columns.inputs, *columns.noise_columns.values()]
    headers = {**unit_in_name(columns.time), **table.units, **known.units}
    units = joined_units(headers, roles.get("units"), [*table.columns, *known.names], [*names, *known.names])
    for state, name in columns.noise_columns.items():
        if state in units and name in units and known_unit(units[state]) != known_unit(units[name]):
            unit, state_unit = units[name], units[state]
            raise CommonlawError(
                "noise-column-unit", where=table.source, column=name, unit=unit, state=state, state_unit=state_unit
            )
    labels_in = columns.object or "object", columns.trial or "trial"
    schema = Schema(columns.states, columns.inputs, *labels_in, columns.time, units, columns.noise_columns)
    located = replace(
        table, locate=lambda row: f"{table.locate(row)}, {objects[owners[row]]}, trial {labels[runs[row]]}"
    )
    groups = groups_of(owners, objects, runs, labels)
    cells = read_cells(located, schema)
    trials, row_indices, empty, notes = trials_of(
        table, cells, groups, roles.get("restarts"), named=columns.trial is not None
    )
    shown = replace(shown, properties=columns.properties, notes=tuple(dict.fromkeys((*shown.notes, *columns.notes))))
    remarks = (*table.notes, *spelled, *spelled_runs, *shown.lines, *known.notes, *notes)
    nameless = columns.object is None and "object_name" not in roles
    data = TrialData(tuple(trials), schema, known.values, remarks, nameless)
    return Rows(data, tuple(empty), tuple(row_indices), shown)


def _labels(table: Table, column: str | None, what: str, default: str) -> tuple[Codes, list[str], tuple[str, ...]]:
    if column is None:
        return np.zeros(len(table), dtype=np.int64), [label(default)], ()
    return object_codes(table, column, what)


def trials_from_arrays(
    times: Sequence[Any] | NDArray[Any] | float,
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
    (times, clock_unit), (states, state_unit) = with_unit(times), with_unit(states)
    (inputs, input_unit), (noise, noise_unit) = with_unit(inputs), with_unit(noise)
    if noise_unit and noise_unit != state_unit:
        raise CommonlawError("noise-in-other-unit", unit=noise_unit, state_unit=state_unit or "no unit")
    runs, single = _times_by_trial(times, states)
    runs, clock = _elapsed(runs)
    count = len(runs)
    objects = [label(each) for each in _per_trial("objects", object, count)]
    counters = {name: itertools.count(1) for name in objects}
    counted = [str(next(counters[name])) for name in objects]
    labels = counted if trial is None else _per_trial("trial labels", trial, count)
    all_states = _per_trial("arrays of states", [states] if single else states, count)
    all_inputs = _per_trial("arrays of inputs", [inputs] if single else inputs, count)
    all_noise = _per_trial("arrays of standard deviations", [noise] if single else noise, count)
    parts = list(zip(objects, labels, runs, all_states, all_inputs, all_noise, strict=True))
    if not parts:
        raise CommonlawError("no-times")
    made, empty = zip(*(_trial(*part) for part in parts), strict=True)
    columns = _columns(made[0], names)
    check_measured(made, columns[0])
    known = given_properties(properties, "object", list(dict.fromkeys(objects)))
    used = ["t", *columns[0], *columns[1], *known.names]
    noisy = {} if noise is None else {name: f"{name} noise" for name in columns[0]}
    own_units = {"t": clock.unit if clock else clock_unit}
    own_units |= dict.fromkeys(columns[0], state_unit) | dict.fromkeys(columns[1], input_unit)
    headers = known.units | {name: unit for name, unit in own_units.items() if unit}
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


def _times_by_trial(times: Any, states: Any) -> tuple[list[Any], bool]:
    """Return the times of each trial, which may be the same for all or a time step, and whether there is only one."""
    is_step = not hasattr(times, "__iter__")
    if not is_step and np.ndim(next(iter(times), [])):
        return list(times), False
    single = not _are_several(states, times)
    if not is_step:
        return [times] * (1 if single else len(states)), single
    if not isinstance(times, float | int | np.number) or not 0 < times < np.inf:
        raise CommonlawError("time-step", step=times)
    return [float(times) * np.arange((np.shape(own) or (1,))[0]) for own in ([states] if single else states)], single


def _are_several(states: Any, times: Any) -> bool:
    """Say whether states at the same times, or in the same time steps, are those of several trials."""
    if not isinstance(states, list | tuple):
        return np.ndim(states) == 3
    sizes = {np.ndim(state) for state in states}
    if sizes != {1}:
        return sizes == {2}
    if hasattr(times, "__iter__"):
        return len(states) != len(times) and all(len(state) == len(times) for state in states)
    return not any(isinstance(state, list | tuple) for state in states)  # These are rows


def _elapsed(runs: list[Any]) -> tuple[list[Any], Elapsed | None]:
    """Return times that are dates or durations as numbers, from the earliest of all trials on, and what they are in."""
    import pandas as pd

    kinds = {np.asarray(run).dtype.kind for run in runs}
    if kinds <= set("iufb") or not kinds <= set("mMO"):
        return runs, None
    whole = pd.Series([each for run in runs for each in run]).infer_objects()
    if whole.dtype.kind == "m":
        result = Elapsed(np.asarray(whole.dt.total_seconds(), dtype=np.float64), "s", "seconds")
    elif whole.dtype.kind == "M":
        result = elapsed(whole)
    else:
        return runs, None
    return np.split(result.values, np.cumsum([len(run) for run in runs])[:-1]), result


def _trial(name: str, run: Any, times: Any, states: Any, inputs: Any, noise: Any) -> tuple[Trial, Codes]:
    """Return a trial without the samples that say nothing, see `are_used`, and their indices."""
    inputs, noise = (np.empty((0, 0)) if each is None else each for each in (inputs, noise))
    earlier, unused = np.empty((0, 0)), np.empty(0, dtype=np.int64)
    with suppress(CommonlawError):  # What is no array `Trial` refuses
        values = states if type(states) is np.ndarray and states.dtype == np.float64 else as_numbers(states)
        if values.size and values.ndim in (1, 2) and np.shape(times) == (len(values),):
            used = are_used(values.reshape(len(values), -1), driven=np.size(inputs) > 0)
            unused = np.flatnonzero(~used & used.any())
    if len(unused):
        if np.size(inputs):
            earlier = inputs_before(as_numbers(times), as_numbers(inputs).reshape(len(times), -1), used)
        times, states = np.delete(times, unused), np.delete(as_numbers(states), unused, axis=0)
        inputs, noise = (np.delete(each, unused, axis=0) if np.size(each) else each for each in (inputs, noise))
    return Trial(name, run, times, states, inputs, noise, earlier=earlier), unused


def _per_trial(what: str, values: Any, count: int) -> list[Any]:
    """Return one value for each trial; a single name, or nothing, is for all of them."""
    if values is None or isinstance(values, str) or not hasattr(values, "__len__"):
        return [values] * count
    if len(values) != count:
        raise CommonlawError("one-per-trial", given=len(values), parts=what, trials=count)
    return list(values)


def _columns(trial: Trial, names: Sequence[str] | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the states and of the inputs."""
    states, inputs = trial.states.shape[1], trial.inputs.shape[1]
    if names is None:
        names = [
            name if count == 1 else f"{name}{i}"
            for name, count in (("x", states), ("u", inputs))
            for i in range(1, count + 1)
        ]
    listed = isinstance(names, list | tuple | np.ndarray) and all(isinstance(name, str) for name in names)
    if not listed or len(names) != states + inputs:
        driven = f" and {inputs} of inputs" if inputs else ""
        raise CommonlawError("names-count", names=names, states=states, inputs=driven)
    return tuple(names[:states]), tuple(names[states:])
