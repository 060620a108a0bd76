"""Dates in the column of times, as time since the first of them."""

import re
from dataclasses import replace
from datetime import date, datetime

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.columns import Column, Table

_OFFSET = r" ?(Z|[+-]\d\d(:?\d\d)?)"
_ISO = re.compile(rf"\d{{4}}-\d\d(-\d\d([T ]\d\d(:?\d\d){{1,2}}([.,]\d+)?({_OFFSET})?)?)?|\d{{8}}T\d{{4}}(\d\d)?Z?")
"""2020-03, 2020-03-01, 2020-03-01 12:30, 2020-03-01T12:30:05.25Z, 20200301T1230."""
_WITH_OFFSET = re.compile(rf".*[T ][\d:.,]*{_OFFSET}")
_DIGITS = re.compile(r"\d{8}", re.ASCII)
_YEARS = 1800, 2200
"""In which numbers such as 20200331 are taken for dates."""
_LOCAL = re.compile(r"\d{1,4}[./]\d{1,2}[./]\d{2,4}( .*)?|\d{1,2}-\d{1,2}-\d{2,4}( .*)?")
"""01.03.2020, 3/1/20: which is the day and which the month, only those know who wrote it."""


def with_dates_as_times(table: Table, time: str) -> Table:
    """Return the table with dates in the column of times as days since the earliest, or seconds if they have hours.

    Any other column stays as it is. A note says what was done; the unit of the times is theirs.
    """
    cells, present = _cells(table.columns[time])
    if not present.any() or not _are_dates(cells[present][0]):
        return table
    _refuse_mixed_offsets(table, time, cells, present)
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


def is_time(cell: object) -> bool:
    """Say whether a cell may be meant as a time: it is no word."""
    return not isinstance(cell, str) or not cell.strip() or cell.strip()[0] in "+-.0123456789"


def refuse_dates(table: Table, time: str) -> None:
    """Refuse a table whose rows are not all there, so that nobody knows the earliest date."""
    cells, present = _cells(table.columns[time])
    if present.any() and _are_dates(cells[present][0]):
        raise CommonlawError(f"{table.source}: column {time!r} holds dates: give a stream its times as numbers")


def _refuse_mixed_offsets(table: Table, time: str, cells: Column, present: Bools) -> None:
    """Refuse dates of which some have an offset from UTC and others none: nobody knows which one is meant."""
    rows = np.flatnonzero(present)
    offset = np.array([_has_offset(cell) for cell in cells[rows]])
    if offset.any() and not offset.all():
        aware, naive = int(rows[offset][0]), int(rows[~offset][0])
        raise CommonlawError(
            f"{table.source}: column {time!r}: {str(cells[aware])!r} in {table.locate(aware)} has an offset from "
            f"UTC, and {str(cells[naive])!r} in {table.locate(naive)} has none; write all dates in one way"
        )


def _has_offset(cell: object) -> bool:
    if isinstance(cell, str):
        return _WITH_OFFSET.fullmatch(cell) is not None
    return isinstance(cell, datetime) and cell.tzinfo is not None


def _cells(column: Column) -> tuple[Column, Bools]:
    """Return cells without blanks around them, None where they are empty, and which are not; none of numbers.

    Numbers that are dates such as 20200331, nearly all of them, are written as these.
    """
    import pandas as pd

    if column.dtype.kind != "O":
        return _compact(column) or (column, np.zeros(len(column), dtype=np.bool_))
    cells = np.array([cell.strip() or None if isinstance(cell, str) else cell for cell in column], dtype=object)
    present = ~np.asarray(pd.isna(cells), dtype=np.bool_)
    if all(isinstance(cell, str) and _DIGITS.fullmatch(cell) for cell in cells[present]):
        return _compact(pd.to_numeric(pd.Series(cells)).to_numpy(np.float64)) or (cells, present & False)
    return cells, present


def _compact(values: Floats) -> tuple[Column, Bools] | None:
    """Return numbers as dates in text, and which are there; None if not even half of them are such as 20200331.

    Of numbers by chance, one of 28 is a date; counts from one on, to more than 31, are not.
    """
    import pandas as pd

    numbers, codes = np.unique(values[np.isfinite(values)], return_inverse=True)
    if not len(numbers) or numbers[0] < _YEARS[0] * 10_000 or numbers[-1] >= _YEARS[1] * 10_000:
        return None
    texts = np.array([f"{number:.15g}" for number in numbers], dtype=object)
    dates = np.asarray(pd.to_datetime(pd.Series(texts), format="%Y%m%d", errors="coerce").notna(), dtype=np.bool_)
    if 2 * np.sum(dates) <= len(dates):
        return None
    cells = np.full(len(values), None, dtype=object)
    texts[dates] = [f"{text[:4]}-{text[4:6]}-{text[6:]}" for text in texts[dates]]
    cells[np.isfinite(values)] = texts[codes]
    return cells, np.isfinite(values)


def _are_dates(cell: object) -> bool:
    if isinstance(cell, str) and _LOCAL.fullmatch(cell):
        raise CommonlawError(f"the time {cell!r} can be read as several dates: write it as 2020-03-31")
    written = isinstance(cell, str) and (_ISO.fullmatch(cell) or _DIGITS.fullmatch(cell)) is not None
    return isinstance(cell, date) or written
