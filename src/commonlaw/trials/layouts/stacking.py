"""Columns of a table below each other, as rows of one."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.columns import Column, Table


def stacked(table: Table, names: Sequence[str], repeated: Iterable[str], more: Mapping[str, Column]) -> Table:
    """Return a table with a row for each cell of some columns, one column below the other.

    It has the `repeated` columns, and `more` of as many rows.
    """
    rows = np.tile(np.arange(len(table)), len(names))
    columns = {**{name: table.columns[name][rows] for name in repeated}, **more}
    return replace(
        table,
        columns=columns,
        units={name: unit for name, unit in table.units.items() if name in columns},
        loose=table.loose & columns.keys(),
        locate=lambda row: f"{table.locate(int(rows[row]))}, column {names[row // len(table)]!r}",
        number=lambda row: table.number(int(rows[row])),
        rows=table.rows[rows],
        parsed={},
        meant={},
        plain=table.plain & {*repeated} - more.keys(),
    )


def quantified(table: Table, name: str) -> Floats:
    """Return a column of measurements, refused if values in it are below a limit of quantification."""
    if np.isfinite(table.limits(name)).any():
        raise CommonlawError("wide-censored", where=table.source, column=name)
    return table.numbers(name, missing=True)
