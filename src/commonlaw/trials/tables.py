"""Trials from files and frames."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Unpack, cast

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.text import as_text
from commonlaw.trials.across import times_across
from commonlaw.trials.columns import Codes, Table, frame_table, with_numbers
from commonlaw.trials.dates import is_time, with_dates_as_times
from commonlaw.trials.grouping import groups_of, read_cells, trials_of
from commonlaw.trials.headers import joined_units
from commonlaw.trials.identifiers import label
from commonlaw.trials.properties import Properties, column_properties, given_properties, object_codes
from commonlaw.trials.recognition import unit_in_name
from commonlaw.trials.roles import (
    ColumnRoles,
    Reading,
    checked,
    column_roles,
    free_columns,
    notation_of,
    time_of,
)
from commonlaw.trials.sources import name_of_table, read_table
from commonlaw.trials.trial import Schema, TrialData, check_measured
from commonlaw.trials.units import known_unit
from commonlaw.trials.wide import deviations_of, long_table


def read_trials(path: str | os.PathLike[str], *, sheet: str | None = None, **roles: Unpack[Reading]) -> TrialData:
    """Return the trials in a file, see `Trials.read`."""
    return rows_of(read_table(path, sheet), as_text(name_of_table(path)), **roles).data


def trials_from_frame(frame: Any, **roles: Unpack[Reading]) -> TrialData:
    """Return the trials in a frame, see `Trials.from_frame`."""
    return rows_of(frame_table(frame), "object", **roles).data


@dataclass(frozen=True)
class Rows:
    """What the rows of a table make: trials and what goes with them, and the labels of trials without any row left."""

    data: TrialData
    empty: tuple[str, ...]
    row_indices: tuple[Codes, ...]
    """Of each trial the indices of the rows of its samples, shape (n,)."""
    columns: ColumnRoles
    """What columns were taken for."""


def rows_of(table: Table, default_object: str, **roles: Unpack[Reading]) -> Rows:
    """Return what the rows of a whole table make, see `Trials.read`."""
    said = cast(Reading, {**table.roles, **checked(roles, Reading)})
    table, said, origin = _prepared(table, said)
    time = time_of(table, said)
    samples = _samples(table, said, time)
    columns = column_roles(samples, said, time)
    if columns.wide:
        rows = _long_rows(table, default_object, said, columns)
    elif len(samples) < len(table):
        rows = read_rows(table, default_object, said)
    else:
        rows = _rows(samples, default_object, said, columns, columns)
    if origin is not None:
        rows = replace(rows, row_indices=tuple(origin[own] for own in rows.row_indices))
    if rows.empty:
        raise CommonlawError("nothing-measured", trial=rows.empty[0])
    check_measured(rows.data.trials, rows.data.schema.states)
    return rows


def column_roles_of(table: Table, roles: Reading) -> ColumnRoles:
    """Return which column is what, also where the rows make no trials."""
    said = cast(Reading, {**table.roles, **checked(roles, Reading)})
    table, said, _ = _prepared(table, said)
    return column_roles(_samples(table, said, time := time_of(table, said)), said, time)


def _prepared(table: Table, roles: Reading) -> tuple[Table, Reading, Codes | None]:
    """Return the table with its numbers read, and a row for each cell if its columns are times; and the roles then.

    The third value is the index of the row in which each cell stood, if so.
    """
    table = with_numbers(table, notation_of(roles))
    if table.facts:
        table = replace(table, facts=(), notes=(f"{table.source}: {'; '.join(table.facts)}", *table.notes))
    if roles.get("time") in table.columns or (across := times_across(table, roles.get("wide"))) is None:
        return table, roles, None
    table, origin = across
    return table, cast(Reading, {**table.roles, **roles, "wide": None}), origin


def _samples(table: Table, roles: Reading, time: str) -> Table:
    """Return the rows from the first time on, as ahead of it may be conditions, with times as numbers."""
    first = next((i for i, cell in enumerate(table.columns[time]) if is_time(cell)), 0)
    return _with_times(table.taken(np.arange(first, len(table))) if first else table, roles, time)


def _with_times(table: Table, roles: Reading, time: str) -> Table:
    return with_dates_as_times(table, time, roles.get("dates"), free_columns(table, roles))


def _long_rows(table: Table, default_object: str, roles: Reading, columns: ColumnRoles) -> Rows:
    """Return the trials in a table that has a column for each object."""
    if columns.object is not None:
        raise CommonlawError("wide-with-object", where=table.source, column=columns.object)
    long, state, origin = long_table(table, columns.time, columns.states, columns.noise_columns, columns.wide)
    noise = {state: name} if (name := deviations_of(state)) in long.columns else {}
    named: Reading = {
        "object": "object", "time": columns.time, "states": [state], "inputs": columns.inputs, "noise_columns": noise,
    }  # fmt: skip
    long = _with_times(long, roles, columns.time)
    rows = _rows(
        long, default_object, {**roles, **named}, column_roles(long, {**roles, **named}, columns.time), columns
    )
    schema = replace(rows.data.schema, wide=columns.states)
    return replace(
        rows, data=rows.data._replace(schema=schema), row_indices=tuple(origin[own] for own in rows.row_indices)
    )


def read_rows(table: Table, default_object: str, roles: Reading) -> Rows:
    """Return the trials in a table, which may end within a trial."""
    time = time_of(table, roles)
    table = _with_times(table, roles, time)
    columns = column_roles(table, roles, time)
    return _rows(table, default_object, roles, columns, columns)


def _rows(table: Table, default_object: str, roles: Reading, columns: ColumnRoles, shown: ColumnRoles) -> Rows:
    """Return the trials in a table whose columns have these roles, of a long one those `shown` of a wide one."""
    if columns.object is not None and "object_name" in roles:
        raise CommonlawError("object-column-and-name", where=table.source, column=columns.object)
    owners, objects, spelled = _labels(table, columns.object, "object", roles.get("object_name") or default_object)
    runs, labels, spelled_runs = _labels(table, columns.trial, "trial", "1")
    if columns.properties is None:
        known = given_properties(roles["properties"], columns.object or "object", objects)
    else:
        known = column_properties(table, columns.properties, owners, objects)
    schema = _schema(table, roles, columns, known)
    located = replace(
        table, locate=lambda row: f"{table.locate(row)}, {objects[owners[row]]}, trial {labels[runs[row]]}"
    )
    groups = groups_of(owners, objects, runs, labels)
    cells = read_cells(located, schema)
    found = trials_of(table, cells, groups, roles.get("restarts"), named=columns.trial is not None)
    shown = replace(shown, properties=columns.properties, notes=tuple(dict.fromkeys((*shown.notes, *columns.notes))))
    remarks = (*table.notes, *spelled, *spelled_runs, *shown.lines, *known.notes, *found.notes)
    nameless = columns.object is None and "object_name" not in roles
    data = TrialData(found.trials, schema, known.values, remarks, nameless)
    return Rows(data, found.empty, found.row_indices, shown)


def _schema(table: Table, roles: Reading, columns: ColumnRoles, known: Properties) -> Schema:
    """Return names and units of the columns that are used."""
    names = [columns.time, *columns.states, *columns.inputs, *columns.noise_columns.values()]
    headers = {**unit_in_name(columns.time), **table.units, **known.units}
    units = joined_units(headers, roles.get("units"), [*table.columns, *known.names], [*names, *known.names])
    _check_units(table, columns.noise_columns, units)
    labels_in = columns.object or "object", columns.trial or "trial"
    return Schema(columns.states, columns.inputs, *labels_in, columns.time, units, columns.noise_columns)


def _labels(table: Table, column: str | None, what: str, default: str) -> tuple[Codes, list[str], tuple[str, ...]]:
    if column is None:
        return np.zeros(len(table), dtype=np.int64), [label(default)], ()
    return object_codes(table, column, what)


def _check_units(table: Table, noise_columns: Mapping[str, str], units: Mapping[str, str]) -> None:
    """Refuse standard deviations in another unit than their state."""
    for state, name in noise_columns.items():
        if state in units and name in units and known_unit(units[state]) != known_unit(units[name]):
            raise CommonlawError(
                "noise-column-unit",
                where=table.source,
                column=name,
                unit=units[name],
                state=state,
                state_unit=units[state],
            )
