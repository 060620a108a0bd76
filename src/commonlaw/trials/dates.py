"""Dates in the column of times, as time since the first of them."""

import re
from dataclasses import replace
from datetime import date

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.trials.columns import Column, Table

_ISO = re.compile(r"\d{4}-\d\d(-\d\d([T ]\d\d(:?\d\d){1,2}([.,]\d+)?( ?(Z|[+-]\d\d(:?\d\d)?))?)?)?")
"""2020-03, 2020-03-01, 2020-03-01 12:30, 2020-03-01T12:30:05.25Z."""
_LOCAL = re.compile(r"\d{1,4}[./]\d{1,2}[./]\d{2,4}( .*)?|\d{1,2}-\d{1,2}-\d{2,4}( .*)?")
"""01.03.2020, 3/1/20: which is the day and which the month, only those know who wrote it."""


def with_dates_as_times(table: Table, time: str) -> Table:
    """Return the table with dates in the column of times as days since the earliest, or seconds if they have hours.

    Any other column stays as it is. A note says what was done; the unit of the times is theirs.
    """
    column = table.columns[time]
    cells, present = _cells(column)
    if not present.any() or not _are_dates(cells[present][0]):
        return table
    import pandas as pd

    stamps = pd.Series(pd.to_datetime(cells, format="ISO8601", utc=True, errors="coerce"))
    wrong = np.flatnonzero(np.asarray(stamps.isna()) & present)
    if len(wrong):
        where, cell = table.locate(int(wrong[0])), str(cells[wrong[0]])
        raise CommonlawError(
            f"{table.source}: column {time!r}, {where}: {cell!r} is not a date such as 2020-03-31 or "
            "2020-03-31 12:30:05; repair the cell"
        )
    first, whole = stamps.min(), bool((stamps == stamps.dt.floor("D"))[present].all())
    unit, seconds = ("day", 86400.0) if whole else ("s", 1.0)
    since = (stamps - first).dt.total_seconds().to_numpy(np.float64) / seconds
    shown = first.strftime("%Y-%m-%d" if whole else "%Y-%m-%d %H:%M:%S")
    note = f"{time}: dates taken as time in {'days' if whole else 'seconds'} since {shown}"
    columns, units = {**table.columns, time: since}, {**table.units, time: unit}
    return replace(table, columns=columns, units=units, loose=table.loose - {time}, notes=(*table.notes, note))


def refuse_dates(table: Table, time: str) -> None:
    """Refuse a table whose rows are not all there, so that nobody knows the earliest date."""
    cells, present = _cells(table.columns[time])
    if present.any() and _are_dates(cells[present][0]):
        raise CommonlawError(f"{table.source}: column {time!r} holds dates: give a stream its times as numbers")


def _cells(column: Column) -> tuple[Column, Bools]:
    """Return cells without blanks around them, None where they are empty, and which are not; none of numbers."""
    if column.dtype.kind != "O":
        return column, np.zeros(len(column), dtype=np.bool_)
    import pandas as pd

    cells = np.array([cell.strip() or None if isinstance(cell, str) else cell for cell in column], dtype=object)
    return cells, ~np.asarray(pd.isna(cells), dtype=np.bool_)


def _are_dates(cell: object) -> bool:
    if isinstance(cell, str) and _LOCAL.fullmatch(cell):
        raise CommonlawError(f"the time {cell!r} can be read as several dates: write it as 2020-03-31")
    return isinstance(cell, date) or (isinstance(cell, str) and _ISO.fullmatch(cell) is not None)
