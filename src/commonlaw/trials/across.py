"""Tables with a row for each object and a column for each time, such as dates or years."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from commonlaw.trials.columns import Codes, Column, Table
from commonlaw.trials.dates import holds_dates, years_of

_FEWEST = 3
"""Columns named by times from which on they are taken for such."""
_VALUE, _TIME = "value", "time"
"""What stands in the columns, and when, if nobody names it."""


def times_across(table: Table, wide: bool | str | None) -> tuple[Table, Codes] | None:
    """Return a table of which the columns are times with a row for each of its cells; None if they are no times.

    The second value is the index of the row in which each cell stood, shape (cells,).
    """
    dates = [name for name in table.columns if holds_dates(np.array([name], dtype=object))]
    years = years_of(table.columns) if len(dates) < _FEWEST else {}
    times = dates if len(dates) >= _FEWEST else list(years)
    others = [name for name in table.columns if name not in set(times)]
    if len(times) < _FEWEST or len(times) < len(others) or not all(map(table.is_numeric, times)):
        return None
    words = [name for name in others if not table.is_numeric(name)]
    if years and not (words and all(here < there for here, there in pairwise(years.values()))):
        return None
    name, labels = _objects(table, words)
    rows, state = np.repeat(np.arange(len(table)), len(times)), wide if isinstance(wide, str) else _VALUE
    stamps = np.array([years.get(each, each) for each in times], dtype=np.float64 if years else object)
    columns: dict[str, Column] = {name: labels[rows]}
    columns |= {each: table.columns[each][rows] for each in others if each != name}
    columns[_TIME] = np.tile(stamps, len(table))
    columns[state] = np.column_stack([table.numbers(each, missing=True) for each in times]).ravel()
    units = {key: unit for key, unit in table.units.items() if key in columns} | ({_TIME: "year"} if years else {})
    note = (
        f"{table.source}: the columns {times[0]} to {times[-1]} are times, and each row is an object, named by {name}: "
        f"{state} is what was measured"
    )
    return (
        replace(
            table,
            columns=columns,
            units=units,
            locate=lambda row: f"{table.locate(int(rows[row]))}, column {times[row % len(times)]!r}",
            number=lambda row: table.number(int(rows[row])),
            loose=table.loose & columns.keys(),
            parsed={},
            roles={**table.roles, "object": name, "time": _TIME, "states": [state]},
            notes=(*table.notes, note),
        ),
        rows,
    )


def _objects(table: Table, words: Sequence[str]) -> tuple[str, Column]:
    """Return the column that names the objects, and their names: the first without repetitions, else all together."""
    for name in words:
        cells, labels = table.encoded(name)
        if (cells >= 0).all() and len(labels) == len(table):
            return name, table.columns[name]
    if not words:
        return "object", np.array([f"row {table.number(row)}" for row in range(len(table))], dtype=object)
    texts = [[cell.strip() if isinstance(cell, str) else "" for cell in table.columns[name]] for name in words]
    return "object", np.array([", ".join(filter(None, cells)) for cells in zip(*texts, strict=True)], dtype=object)
