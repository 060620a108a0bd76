"""Properties of objects, from columns, a second table, or a mapping."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.trials.columns import Codes, Table, frame_table
from commonlaw.trials.sources import read_table
from commonlaw.trials.trial import Property, label, property_names


@dataclass(frozen=True)
class Properties:
    """Property values by object and name, units by name, and what was noticed."""

    values: dict[str, dict[str, Property]] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        """Names of the properties, in order of first appearance."""
        return property_names(self.values)


def column_properties(table: Table, names: Sequence[str], codes: Codes, objects: Sequence[str]) -> Properties:
    """Return the properties in columns of a table, in which an empty cell says nothing.

    The codes, shape (n,), are the object of each row as an index into `objects`.
    """
    values: dict[str, dict[str, Property]] = {}
    for name in names:
        cells, words = _cells(table, name)
        rows = np.flatnonzero(~np.isnan(cells))
        owners = codes[rows]
        first = np.full(len(objects), -1)
        first[owners[::-1]] = rows[::-1]
        clash = np.flatnonzero(cells[rows] != cells[first[owners]])
        if len(clash):
            here, there = first[owners[clash[0]]], rows[clash[0]]
            raise CommonlawError(
                f"{table.source}: property {name!r} of {objects[codes[here]]} is {_value(cells[here], words)!r} in "
                f"{table.locate(int(here))} and {_value(cells[there], words)!r} in {table.locate(int(there))}; an "
                "object has one value of a property: correct a row, or give the column another role"
            )
        for owner in np.unique(owners):
            values.setdefault(objects[owner], {})[name] = _value(cells[first[owner]], words)
    return Properties(values, {name: table.units[name] for name in names if name in table.units})


def constant_columns(table: Table, names: Sequence[str], codes: Codes) -> list[str]:
    """Return the columns that are constant, and not empty, for each of at least two objects."""
    _, first = np.unique(codes, return_index=True)
    if len(first) < 2:
        return []
    found = []
    for name in names:
        try:
            cells, _ = _cells(table, name)
        except CommonlawError:  # a column with a cell that cannot be read is for the reader of states to refuse
            continue
        if np.array_equal(cells, cells[first][codes], equal_nan=True) and not np.isnan(cells).all():
            found.append(name)
    return found


def given_properties(given: Any, key: str, objects: Sequence[str]) -> Properties:
    """Return the properties in a mapping from object to values by name, or in a table with a row for each object.

    The table, a file or a frame, has the objects' names in the column `key`. Those of `objects` that have no
    properties are named in a note.
    """
    if given is None:
        return Properties()
    found = Properties(_mapped(given)) if isinstance(given, Mapping) else _tabled(given, key)
    without = [name for name in objects if name not in found.values]
    note = f"no properties are given for {', '.join(without)}"
    return Properties(found.values, found.units, (note,)) if without else found


def _mapped(given: Mapping[Any, Any]) -> dict[str, dict[str, Property]]:
    for name, values in given.items():
        if not isinstance(values, Mapping):
            raise CommonlawError(f"properties of {name!r} are {values!r}: give values by name, such as {{'mass': 0.5}}")
    return {label(name): dict(values) for name, values in given.items()}


def _tabled(given: Any, key: str) -> Properties:
    is_file = isinstance(given, str | os.PathLike)
    table = read_table(given) if is_file else frame_table(given, "the table of properties")
    if key not in table.columns:
        error = unknown("column", key, table.columns)
        raise CommonlawError(f"{table.source}: {error}; the objects' names of a table of properties stand in {key!r}")
    codes, names = object_codes(table, key)
    return column_properties(table, [name for name in table.columns if name != key], codes, names)


def object_codes(table: Table, name: str, what: str = "object") -> tuple[Codes, list[str]]:
    """Return the label of each row as codes, shape (n,), and the labels."""
    codes, labels = table.encoded(name, label)
    missing = np.flatnonzero(codes < 0)
    if len(missing):
        raise CommonlawError(
            f"{table.source}: column {name!r}, {table.locate(int(missing[0]))}: the {what} is missing "
            f"({len(missing)} rows have none); fill it in every row"
        )
    return codes, [str(each) for each in labels]


def _cells(table: Table, name: str) -> tuple[Floats, list[object] | None]:
    """Return a column as numbers, NaN where empty; or as indices into a list of words."""
    if table.is_numeric(name):
        return table.numbers(name, missing=True), None
    codes, words = table.encoded(name)
    return np.where(codes < 0, np.nan, codes), words


def _value(cell: float, words: list[object] | None) -> Property:
    return float(cell) if words is None else str(words[int(cell)])
