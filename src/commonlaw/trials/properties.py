"""Properties of objects, from columns, a second table, or a mapping."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.trials.columns import Codes, Table, frame_table
from commonlaw.trials.files import read_table
from commonlaw.trials.headers import label
from commonlaw.trials.trial import Property, property_names


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
    """Return the properties in columns of a table, without empty cells, given the index of the object of each row."""
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
                "property-differs",
                where=table.source,
                property=name,
                object=objects[codes[here]],
                first=_value(cells[here], words),
                first_row=table.locate(int(here)),
                second=_value(cells[there], words),
                second_row=table.locate(int(there)),
            )
        for owner in np.unique(owners):
            values.setdefault(objects[owner], {})[name] = _value(cells[first[owner]], words)
    return Properties(values, {name: table.units[name] for name in names if name in table.units})


def constant_columns(table: Table, names: Sequence[str], codes: Codes, *, others_are_states: bool) -> list[str]:
    """Return the columns that are constant, and not empty, for each object; of a single one, only those of numbers.

    Where all columns of numbers of a single object are constant, they are its states. Refused is a column that is
    constant but for a few rows of at most half of the objects.
    """
    _, first = np.unique(codes, return_index=True)
    single, constant, varying = len(first) < 2, list[str](), False
    for name in names:
        try:
            cells, words = _cells(table, name)
        except CommonlawError:  # a column with a cell that cannot be read is for the reader of states to refuse
            continue
        if np.isnan(cells).all() or (single and words is not None):
            continue
        if np.array_equal(cells, cells[first][codes], equal_nan=True):
            constant.append(name)
        elif others_are_states and words is None:
            varying = True
            if not single:
                _refuse_nearly_constant(table, name, cells, codes)
    return constant if varying or not (single and others_are_states) else []


def _refuse_nearly_constant(table: Table, name: str, cells: Floats, codes: Codes) -> None:
    """Refuse a column that is constant for at least half of the objects, and but for a tenth of the rows of others."""
    of_first = np.unique(cells[codes == codes[0]], return_counts=True)[1]
    if of_first.sum() - of_first.max() > max(1, 0.1 * of_first.sum()):
        return
    values = np.unique(cells, return_inverse=True)[1]
    pairs, which, counts = np.unique(codes * len(cells) + values, return_inverse=True, return_counts=True)
    sizes, most = np.bincount(codes), np.zeros(codes.max() + 1, dtype=np.int64)
    np.maximum.at(most, pairs // len(cells), counts)
    odd = sizes - most
    few = (odd < most) & (odd <= np.maximum(1, 0.1 * sizes))
    row = int(np.argmax(counts[which] < most[codes]))
    usual = cells[(codes == codes[row]) & (counts[which] == most[codes[row]])][0]
    if not few.all() or 2 * np.sum(odd > 0) > len(odd) or np.isnan(usual):
        return
    cell = "empty" if np.isnan(cells[row]) else f"{cells[row]:g}"
    raise CommonlawError(
        "property-or-state",
        where=table.source,
        column=name,
        cell=cell,
        row=table.locate(row),
        usual=usual,
        rows=most[codes[row]],
        count=sizes[codes[row]],
    )


def given_properties(given: Any, key: str, objects: Sequence[str]) -> Properties:
    """Return the properties in a mapping from object to values by name, or in a table with a row for each object.

    The names are in its column `key`. A note names objects without properties.
    """
    if given is None:
        return Properties()
    if isinstance(given, Mapping):
        for name, values in given.items():
            if not isinstance(values, Mapping):
                raise CommonlawError("properties-not-by-name", object=name, value=values)
        properties = Properties({label(name): dict(values) for name, values in given.items()})
    else:
        is_file = isinstance(given, str | os.PathLike)
        table = read_table(given) if is_file else frame_table(given, "the table of properties")
        if key not in table.columns:
            error = unknown("column", key, table.columns)
            raise CommonlawError("properties-without-objects", where=table.source, error=error, key=key)
        codes, names, notes = object_codes(table, key)
        known = column_properties(table, [name for name in table.columns if name != key], codes, names)
        properties = replace(known, notes=notes)
    without = [name for name in objects if name not in properties.values]
    note = f"no properties are given for {', '.join(without)}"
    return replace(properties, notes=(*properties.notes, note)) if without else properties


def object_codes(table: Table, name: str, what: str = "object") -> tuple[Codes, list[str], tuple[str, ...]]:
    """Return the label of each row as codes, shape (n,), the labels, and notes of those written in several ways."""
    ways: dict[str, list[str]] = {}

    def read(cell: object) -> str:
        ways.setdefault(label(cell), []).append(str(cell).strip())
        return label(cell)

    codes, labels = table.encoded(name, read)
    missing = np.flatnonzero(codes < 0)
    if len(missing):
        raise CommonlawError(
            "label-missing",
            where=table.source,
            column=name,
            row=table.locate(int(missing[0])),
            label=what,
            count=len(missing),
        )
    spelled = {text: list(dict.fromkeys(cells)) for text, cells in ways.items() if text}
    notes = (
        f"{what} {text!r} is written in {len(cells)} ways, taken as one: {', '.join(map(ascii, cells))}"
        for text, cells in spelled.items()
        if len(cells) > 1
    )
    return codes, [str(text) for text in labels], tuple(notes)


def _cells(table: Table, name: str) -> tuple[Floats, list[object] | None]:
    """Return a column as numbers, NaN where empty; or as indices into a list of words."""
    if table.is_numeric(name):
        return table.numbers(name, missing=True), None
    codes, words = table.encoded(name)
    return np.where(codes < 0, np.nan, codes), words


def _value(cell: float, words: list[object] | None) -> Property:
    return float(cell) if words is None else str(words[int(cell)])
