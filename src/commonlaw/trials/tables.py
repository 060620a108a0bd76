"""Trials from files and frames."""

import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, Unpack, cast

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.trials.columns import Codes, Table, frame_table
from commonlaw.trials.dates import with_dates_as_times
from commonlaw.trials.headers import find_name, joined_units
from commonlaw.trials.properties import (
    column_properties,
    constant_columns,
    given_properties,
    object_codes,
)
from commonlaw.trials.sources import read_table
from commonlaw.trials.trial import Roles, Schema, Trial, TrialData, check_measured, label, shown
from commonlaw.trials.units import known_unit

_CLOCKS = (
    *("sec", "second", "seconds", "minute", "minutes", "hour", "hours", "day", "days", "year", "years", "age"),
    *("date", "datetime", "timestamp"),
)
"""Columns of times where there is no t or time, and one of these."""


def read_trials(path: str | os.PathLike[str], *, sheet: str | None = None, **roles: Unpack[Roles]) -> TrialData:
    """Return the trials in a file, see `Trials.read`."""
    return rows_of(read_table(path, sheet), Path(path).stem, **roles).data


def trials_from_frame(frame: Any, **roles: Unpack[Roles]) -> TrialData:
    """Return the trials in a frame, see `Trials.from_frame`."""
    return rows_of(frame_table(frame), "object", **roles).data


@dataclass(frozen=True)
class Rows:
    """What the rows of a table make: trials and what goes with them, and the labels of trials without any row left."""

    data: TrialData
    empty: tuple[str, ...]
    places: tuple[Codes, ...]
    """Of each trial the indices of the rows of its samples, shape (n,)."""


def rows_of(table: Table, default_object: str, **roles: Unpack[Roles]) -> Rows:
    """Return what the rows of a whole table make, see `Trials.read`."""
    rows = read_rows(table, default_object, cast(Roles, {**table.roles, **_checked(roles)}))
    if rows.empty:
        raise CommonlawError(f"{rows.empty[0]}: no state was measured in any row; leave the trial out")
    for trial in rows.data.trials:
        check_measured(trial, rows.data.schema.states)
    return rows


def _checked(roles: Roles) -> Roles:
    """Return the keywords that say something, having refused those that there are not."""
    for name in roles:
        if name not in Roles.__annotations__:
            raise unknown("keyword", name, [*Roles.__annotations__, "sheet"])
    said = {name: value for name, value in roles.items() if value is not None}
    if not isinstance(said.get("noise_columns", {}), Mapping):
        raise CommonlawError(f"noise_columns are {said['noise_columns']!r}: name them by state, such as {{'x': 'sx'}}")
    for name in ("states", "inputs", "noise_columns"):
        if name in said and not said[name]:
            del said[name]
    return cast(Roles, said)


def read_rows(table: Table, default_object: str, roles: Roles) -> Rows:
    """Return the trials in a table, which may end within a trial, whose columns have these roles."""
    objects_in, trials_in = _role(table, roles, "object", ("object",)), _role(table, roles, "trial", ("trial",))
    clocks = [name for name in table.columns if name.casefold() in _CLOCKS]
    time = _role(table, roles, "time", ("t", "time")) or (clocks[0] if len(clocks) == 1 else None)
    if time is None:
        raise CommonlawError(
            f"{table.source}: which column holds the time? Name it with time=...; columns: {', '.join(table.columns)}"
        )
    table = with_dates_as_times(table, time)
    if objects_in is not None and "object_name" in roles:
        raise CommonlawError(f"{table.source}: column {objects_in!r} names the objects: leave object_name=... out")
    owners, objects = _labels(table, objects_in, "object", roles.get("object_name") or default_object)
    runs, labels = _labels(table, trials_in, "trial", "1")
    columns = _columns(table, roles, [each for each in (objects_in, trials_in, time) if each is not None], owners)
    if columns.properties is None:
        known = given_properties(roles["properties"], objects_in or "object", objects)
    else:
        known = column_properties(table, columns.properties, owners, objects)
    noise_columns = _noise_columns(table, roles, columns.states)
    names = [time, *columns.states, *columns.inputs, *noise_columns.values()]
    units = joined_units(
        {**table.units, **known.units}, roles.get("units"), [*table.columns, *known.names], [*names, *known.names]
    )
    _check_units(table, noise_columns, units)
    labels_in = objects_in or "object", trials_in or "trial"
    schema = Schema(columns.states, columns.inputs, *labels_in, time, units, noise_columns)
    located = replace(
        table, locate=lambda row: f"{table.locate(row)}, {objects[owners[row]]}, trial {labels[runs[row]]}"
    )
    cells = _cells(located, schema)
    made, empty, places, notes = _cut(table, cells, owners * len(labels) + runs, objects, labels)
    remarks = (*table.notes, *columns.notes, *known.notes, *notes)
    nameless = objects_in is None and "object_name" not in roles
    return Rows(TrialData(made, schema, known.values, remarks, nameless), empty, places)


def _role(table: Table, roles: Roles, role: Literal["object", "trial", "time"], defaults: Sequence[str]) -> str | None:
    """Return the column that has a role, named by the user or found by its name, capitals not counting."""
    named = roles.get(role)
    # the schema of a table without such a column has the default for its name, and may be what names the columns here
    if named is not None and (named != role or named in table.columns):
        return table.find(named)
    folded = {name.casefold(): name for name in reversed(list(table.columns))}
    exact = [name for name in defaults if name in table.columns]
    # of time and T, time is the time and T may be a temperature
    alike = [folded[name] for name in reversed(defaults) if name in folded]
    return next(iter((*exact, *alike)), None)


def _labels(table: Table, column: str | None, what: str, default: str) -> tuple[Codes, list[str]]:
    if column is None:
        return np.zeros(len(table), dtype=np.int64), [label(default)]
    return object_codes(table, column, what)


@dataclass(frozen=True)
class _Columns:
    """Columns of states, inputs and properties (None: they are elsewhere), and what was noticed."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    properties: list[str] | None
    notes: tuple[str, ...]


def _columns(table: Table, roles: Roles, taken: list[str], owners: Codes) -> _Columns:
    """Give the columns that are not taken their roles: as named; else properties where constant, and states."""
    inputs = _found(table, roles.get("inputs", ()))
    states = _found(table, roles.get("states", ()))
    given = roles.get("properties")
    properties = _found(table, given) if _names_columns(table, given) else []
    noise = dict.fromkeys(_found(table, [*(roles.get("noise_columns") or {}).values()]))
    roles_of = Counter([*taken, *inputs, *states, *properties, *noise])
    name, count = roles_of.most_common(1)[0]
    if count > 1:
        raise CommonlawError(f"{table.source}: column {name!r} is given two roles: give it one")
    rest = [name for name in table.columns if name not in roles_of]
    notes = []
    if given is None and (properties := constant_columns(table, rest, owners)):
        notes = [f"{', '.join(properties)}: taken as properties, being constant for each object"]
    rest = [name for name in rest if name not in properties]
    if not states:
        states = tuple(name for name in rest if table.is_numeric(name))
    left = [name for name in rest if name not in states]
    if left:
        notes.append(f"columns left out: {', '.join(left)}")
    if not states:
        raise CommonlawError(
            f"{table.source}: no column of numbers is left for the states; name them with states=[...]; "
            f"columns: {', '.join(table.columns)}"
        )
    elsewhere = given is not None and not _names_columns(table, given)
    return _Columns(states, inputs, None if elsewhere else list(properties), tuple(notes))


def _found(table: Table, names: Any) -> tuple[str, ...]:
    if not isinstance(names, Iterable):
        raise CommonlawError(f"columns are named by {names!r}: give the name of one, or a list of names")
    return tuple(table.find(name) for name in ([names] if isinstance(names, str) else names))


def _noise_columns(table: Table, roles: Roles, states: Sequence[str]) -> dict[str, str]:
    """Return the columns of standard deviations by state."""
    given = roles.get("noise_columns") or {}
    try:
        return {find_name(state, states, "state"): table.find(name) for state, name in given.items()}
    except CommonlawError as error:
        raise CommonlawError(f"{table.source}: noise_columns=...: {error}") from None


def _check_units(table: Table, noise_columns: Mapping[str, str], units: Mapping[str, str]) -> None:
    """Refuse standard deviations in another unit than their state."""
    for state, name in noise_columns.items():
        if state in units and name in units and known_unit(units[state]) != known_unit(units[name]):
            raise CommonlawError(
                f"{table.source}: column {name!r} is in {units[name]}, and {state}, whose standard deviations it "
                f"holds, in {units[state]}: give both in one unit"
            )


def _names_columns(table: Table, given: Any) -> bool:
    """Say whether properties are given as names of columns and not as a second table."""
    if isinstance(given, str):
        return given in table.columns or not (Path(given).suffix or Path(given).exists())
    return isinstance(given, Sequence)


_Cells = tuple[Floats, Floats, Floats, Floats]
"""Of all rows: times, shape (n,), states, inputs, and standard deviations of the states, each of shape (n, columns)."""


def _cells(table: Table, schema: Schema) -> _Cells:
    times, noise = table.numbers(schema.time), np.full((len(table), len(schema.states)), np.nan)
    states = np.column_stack([table.numbers(name, missing=True) for name in schema.states])
    inputs = np.column_stack([np.empty((len(table), 0)), *(table.numbers(name) for name in schema.inputs)])
    for state, name in schema.noise_columns.items():
        j = schema.states.index(state)
        noise[:, j] = table.deviations(name, np.isfinite(states[:, j]))
    return times, states, inputs, noise


def _cut(
    table: Table, cells: _Cells, group: Codes, objects: Sequence[str], labels: Sequence[str]
) -> tuple[tuple[Trial, ...], tuple[str, ...], tuple[Codes, ...], list[str]]:
    """Cut rows into trials, in order of first appearance and sorted by time.

    Rows before a measured state that have none are left out; labels of trials without any row come second, then the
    rows of each trial, and notes.
    """
    codes, first, which = np.unique(group, return_index=True, return_inverse=True)
    in_order = np.argsort(first)
    rank = np.argsort(in_order)[which]
    bounds = np.cumsum(np.bincount(rank))[:-1]
    made, empty, places, late, gaps = [], [], [], [], []
    measured = np.asarray(np.isfinite(cells[1]).any(axis=1))
    for code, rows in zip(codes[in_order], np.split(np.argsort(rank, kind="stable"), bounds), strict=True):
        name, run = objects[code // len(labels)], labels[code % len(labels)]
        where = f"{name}, trial {run}"
        times = cells[0][rows]
        if np.any(times[1:] < times[:-1]):
            rows = rows[np.argsort(times, kind="stable")]
            late.append(where)
        _refuse_twice(table, cells[0][rows], rows, where)
        ahead = np.logical_and.accumulate(~measured[rows][::-1])[::-1]
        kept = (measured[rows] | ahead) & ~ahead[0]
        if not kept.all():
            gaps.append(f"{where}: {shown([table.locate(int(row)) for row in rows[~kept]])}")
        if kept.any():
            made.append(Trial(name, run, *(each[rows[kept]] for each in cells)))
            places.append(rows[kept])
        else:
            empty.append(where)
    notes = [f"sorted by time: {'; '.join(late)}"] if late else []
    notes += [f"rows without a measured state left out: {'; '.join(gaps)}"] if gaps else []
    return tuple(made), tuple(empty), tuple(places), notes


def _refuse_twice(table: Table, times: Floats, rows: Codes, where: str) -> None:
    """Refuse a trial in which a time, in the sorted `times` of these rows, is there twice."""
    twice = np.flatnonzero(times[1:] == times[:-1])
    if len(twice):
        here, there = (table.locate(int(row)) for row in rows[twice[0] : twice[0] + 2])
        raise CommonlawError(
            f"{table.source}: {where}: the time {times[twice[0]]:g} is there twice, in {here} and in {there}; remove a "
            "row, or name the columns that tell trials and objects apart with trial=... and object=..."
        )
