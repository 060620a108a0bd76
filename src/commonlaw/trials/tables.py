"""Trials from files and frames."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack, cast

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.names import as_text
from commonlaw.trials.columns import Codes, Table, frame_table
from commonlaw.trials.dates import with_dates_as_times
from commonlaw.trials.grouping import groups_of, read_cells, trials_of
from commonlaw.trials.headers import joined_units
from commonlaw.trials.identifiers import label
from commonlaw.trials.properties import Properties, column_properties, given_properties, object_codes
from commonlaw.trials.roles import (
    Identity,
    Reading,
    ValueColumns,
    checked,
    identity_columns,
    noise_columns_of,
    value_columns,
)
from commonlaw.trials.sources import read_table
from commonlaw.trials.trial import Schema, TrialData, check_measured
from commonlaw.trials.units import known_unit
from commonlaw.trials.wide import long_table


def read_trials(path: str | os.PathLike[str], *, sheet: str | None = None, **roles: Unpack[Reading]) -> TrialData:
    """Return the trials in a file, see `Trials.read`."""
    return rows_of(read_table(path, sheet), as_text(Path(path).stem), **roles).data


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


def rows_of(table: Table, default_object: str, **roles: Unpack[Reading]) -> Rows:
    """Return what the rows of a whole table make, see `Trials.read`."""
    said = cast(Reading, {**table.roles, **checked(roles, Reading)})
    rows = _read_wide(table, default_object, said) if said.get("wide") else read_rows(table, default_object, said)
    if rows.empty:
        raise CommonlawError(f"{rows.empty[0]}: no state was measured in any row; leave the trial out")
    check_measured(rows.data.trials, rows.data.schema.states)
    return rows


def _read_wide(table: Table, default_object: str, roles: Reading) -> Rows:
    """Return the trials in a table that has a column for each object."""
    identity = identity_columns(table, roles)
    if identity.object is not None:
        raise CommonlawError(
            f"{table.source}: with wide=... each column is an object, and column {identity.object!r} names objects, "
            "too: rename it, or leave it out"
        )
    columns = value_columns(table, roles, identity, np.zeros(len(table), dtype=np.int64))
    repeated = [name for name in table.columns if name not in (identity.time, *columns.states)]
    long, state, origin = long_table(table, identity.time, repeated, columns.states, roles["wide"])
    rows = read_rows(long, default_object, {**roles, "object": "object", "time": identity.time, "states": [state]})
    return replace(rows, row_indices=tuple(origin[own] for own in rows.row_indices))


def read_rows(table: Table, default_object: str, roles: Reading) -> Rows:
    """Return the trials in a table, which may end within a trial, whose columns have these roles."""
    identity = identity_columns(table, roles)
    table = with_dates_as_times(table, identity.time)
    if identity.object is not None and "object_name" in roles:
        raise CommonlawError(f"{table.source}: column {identity.object!r} names the objects: leave object_name=... out")
    owners, objects, spelled = _labels(table, identity.object, "object", roles.get("object_name") or default_object)
    runs, labels, spelled_runs = _labels(table, identity.trial, "trial", "1")
    columns = value_columns(table, roles, identity, owners)
    if columns.properties is None:
        known = given_properties(roles["properties"], identity.object or "object", objects)
    else:
        known = column_properties(table, columns.properties, owners, objects)
    schema = _schema(table, roles, identity, columns, known)
    located = replace(
        table, locate=lambda row: f"{table.locate(row)}, {objects[owners[row]]}, trial {labels[runs[row]]}"
    )
    groups = groups_of(owners, objects, runs, labels)
    cells = read_cells(located, schema)
    found = trials_of(table, cells, groups, roles.get("restarts"), named=identity.trial is not None)
    remarks = (*table.notes, *spelled, *spelled_runs, *columns.notes, *known.notes, *found.notes)
    nameless = identity.object is None and "object_name" not in roles
    return Rows(TrialData(found.trials, schema, known.values, remarks, nameless), found.empty, found.row_indices)


def _schema(table: Table, roles: Reading, identity: Identity, columns: ValueColumns, known: Properties) -> Schema:
    """Return names and units of the columns that are used."""
    noise_columns = noise_columns_of(table, roles, columns.states)
    names = [identity.time, *columns.states, *columns.inputs, *noise_columns.values()]
    units = joined_units(
        {**table.units, **known.units}, roles.get("units"), [*table.columns, *known.names], [*names, *known.names]
    )
    _check_units(table, noise_columns, units)
    labels_in = identity.object or "object", identity.trial or "trial"
    return Schema(columns.states, columns.inputs, *labels_in, identity.time, units, noise_columns)


def _labels(table: Table, column: str | None, what: str, default: str) -> tuple[Codes, list[str], tuple[str, ...]]:
    if column is None:
        return np.zeros(len(table), dtype=np.int64), [label(default)], ()
    return object_codes(table, column, what)


def _check_units(table: Table, noise_columns: Mapping[str, str], units: Mapping[str, str]) -> None:
    """Refuse standard deviations in another unit than their state."""
    for state, name in noise_columns.items():
        if state in units and name in units and known_unit(units[state]) != known_unit(units[name]):
            raise CommonlawError(
                f"{table.source}: column {name!r} is in {units[name]}, and {state}, whose standard deviations it "
                f"holds, in {units[state]}: give both in one unit"
            )
