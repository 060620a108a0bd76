"""Dates and times of day in the column of times, as time since the first of them."""

import re
from collections.abc import Collection, Iterable
from contextlib import suppress
from dataclasses import replace
from datetime import date, datetime, time, timedelta
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import Diagnostic
from commonlaw.errors import CommonlawError
from commonlaw.trials.columns import Column, Table
from commonlaw.trials.headers import known_unit
from commonlaw.trials.reading import DateOrder

if TYPE_CHECKING:
    import pandas as pd

_OFFSET = r" ?(Z|[+-]\d\d(:?\d\d)?)"
_ISO = re.compile(rf"\d{{4}}-\d\d(-\d\d([T ]\d\d(:?\d\d){{1,2}}([.,]\d+)?({_OFFSET})?)?)?|\d{{8}}T\d{{4}}(\d\d)?Z?")
"""2020-03, 2020-03-01, 2020-03-01 12:30, 2020-03-01T12:30:05.25Z, 20200301T1230."""
_WITH_OFFSET = re.compile(rf".*[T ][\d:.,]*( ?[apAP]\.?[mM]\.?)?{_OFFSET}")
_ZEROS = str.maketrans("123456789", "0" * 9)
_DIGITS = re.compile(r"\d{8}", re.ASCII)
_YEARS = 1800, 2200
"""In which numbers such as 20200331 are taken for dates."""

_CLOCK = r"(\d{1,2}):(\d\d)(?::(\d\d)(?:[.,](\d+))?)?(?: ?([ap])\.?m\.?)?"
_AFTER_DATE = rf"(?:[ T,]+{_CLOCK}({_OFFSET})?)?"
_LOCAL = re.compile(rf"(\d{{1,4}})([./-])(\d{{1,2}})\2(\d{{1,4}}){_AFTER_DATE}", re.ASCII | re.IGNORECASE)
"""31.03.2020 12:30, 3/31/20 12:30 PM, 2020/03/31."""
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
_MONTH = rf"({'|'.join(_MONTHS)})[a-z]{{0,6}}\.?"
_NAMED = re.compile(rf"(?:(\d{{1,2}})\.?[ -]{_MONTH}|{_MONTH} (\d{{1,2}}),?)[ -](\d{{2,4}})", re.ASCII | re.IGNORECASE)
"""31-Mar-2020, 31 March 2020, Mar 31, 2020."""
_DURATION = re.compile(
    r"(-)?(?:(\d+) days?,? ?)?(\d+)(?::(\d\d)(?::(\d\d)(?:[.,](\d+))?)?|(?= ?[ap]\.?m))(?: ?([ap])\.?m\.?)?",
    re.ASCII | re.IGNORECASE,
)
"""1:30:00, 26:10:05.25, 1 day 2:10:05, 1:30:00 PM, 1 PM; and 1:30, which may be hours or minutes."""
_MINUTES = re.compile(r"(-)?()()(\d+):([0-5]\d)[.,](\d+)()", re.ASCII)
"""1:30.5: minutes and seconds, as spreadsheets show them."""
_DAY = 86_400.0
"""Seconds."""

_EPOCH_NAME = re.compile("time|date|stamp|epoch|unix|utc|zeit", re.IGNORECASE)


class Elapsed(NamedTuple):
    """Times since the earliest of some dates."""

    values: Floats
    unit: str
    since: str
    """The earliest, as shown with the unit."""
    calendar: bool = True
    """Whether they are of dates, not durations."""


def elapsed(stamps: "pd.Series[Any]") -> Elapsed:
    """Return dates as days since the earliest, or seconds if they have hours."""
    first = stamps.min()
    whole = bool((stamps == stamps.dt.floor("D"))[stamps.notna()].all())
    unit, seconds = ("day", _DAY) if whole else ("s", 1.0)
    since = (stamps - first).dt.total_seconds().to_numpy(np.float64) / seconds
    shown = first.strftime("%Y-%m-%d" if whole else "%Y-%m-%d %H:%M:%S")
    return Elapsed(since, unit, f"{'days' if whole else 'seconds'} since {shown}")


def with_dates_as_times(table: Table, name: str, order: DateOrder | None, others: Collection[str]) -> Table:
    """Return the table with dates in the column of times as days since the earliest, or seconds if they have hours.

    Times of day are seconds since 0:00:00, after the date in one of the `other` columns if there is one. A note says
    so.
    """
    column, note = table.columns[name], f"{name}: dates taken as time in"
    partner = _partner(table, name, others)
    if partner is not None:
        days, clock = (partner, name) if is_clock(table.columns[name]) else (name, partner)
        import pandas as pd

        stamps = _stamps(table, days, order) + pd.to_timedelta(_durations(table, clock, "h:mm"), unit="s")
        table = replace(table, columns={key: cells for key, cells in table.columns.items() if key != partner})
        note = f"{days} and {clock}: taken together as time in"
    elif (hours := _hours_and_minutes(table, name)) is not None or is_clock(column):
        values = _durations(table, name, order) if hours is None else hours
        kept = np.flatnonzero(np.isfinite(values))
        after_midnight = np.cumsum(np.diff(values[kept], prepend=-np.inf) < -_DAY / 2, dtype=np.int64)
        note = f"{name}: taken as time in seconds since 0:00:00{'' if hours is None else ', from hours and minutes'}"
        if len(kept) and after_midnight[-1] and np.max(values[kept]) < _DAY:
            values[kept] += _DAY * after_midnight
            note += ", a day later after each midnight"
            counts = [day for day in others if len(kept) == len(values) and _counts_days(table, day, after_midnight)]
            note += f", as {', '.join(counts)} counts" if counts else ""
            table = replace(table, columns={key: cells for key, cells in table.columns.items() if key not in counts})
        calendar = bool(len(kept) and np.min(values[kept]) >= 3600)  # Others are durations: 0:15, 0:30
        return _with_times(table, name, values, "s", note, calendar=calendar)
    elif (counted := _epochs(table, name)) is not None:
        stamps, note = counted, f"{name}: counted since 1970, taken as time in"
    elif holds_dates(column):
        stamps = _stamps(table, name, order)
    else:
        return table
    times = elapsed(stamps)
    return _with_times(table, name, times.values, times.unit, f"{note} {times.since}", calendar=True)


def holds_dates(column: Column) -> bool:
    """Say whether the first cell of a column that is not empty is a date, alone or with a time of day."""
    return _is_date(_first_cell(column))


def years_of(names: Iterable[str]) -> dict[str, float]:
    """Return those of some names that are years, with these as numbers.

    >>> years_of(["country", "1990", "X1991"])
    {'1990': 1990.0, 'X1991': 1991.0}
    """
    matches = {name: re.fullmatch(r"[A-Za-z]{0,2}(\d{4})", name.strip(), re.ASCII) for name in names}
    years = {name: float(match[1]) for name, match in matches.items() if match}
    return {name: year for name, year in years.items() if _YEARS[0] <= year < _YEARS[1]}


_UNITS_OF_TIME = "s|sec|seconds?|min|minutes?|h|hr|hours?|d|days?|weeks?|months?"
_ELAPSED = re.compile(
    rf"(?:(days?|hours?|weeks?|months?)[ _]*(\d+(?:[.,]\d+)?)|(\d+(?:[.,]\d+)?) *({_UNITS_OF_TIME}))", re.IGNORECASE
)


def elapsed_in_names(names: Iterable[str]) -> tuple[str, dict[str, float]]:
    """Return the unit of time in the first of some names that is a time since a start, and those in this unit.

    >>> elapsed_in_names(["mouse", "Day 0", "Day 7"]), elapsed_in_names(["0 h", "0.5 h", "30 min"])
    (('d', {'Day 0': 0.0, 'Day 7': 7.0}), ('h', {'0 h': 0.0, '0.5 h': 0.5}))
    """
    units, times = dict[str, str](), dict[str, float]()
    for name in names:
        if match := _ELAPSED.fullmatch(name.strip()):
            units[name] = f"{known_unit((match[1] or match[4]).casefold()):~}"
            times[name] = float((match[2] or match[3]).replace(",", "."))
    unit = next(iter(units.values()), "")
    return unit, {name: time for name, time in times.items() if units[name] == unit}


def is_time(cell: object) -> bool:
    """Say whether a cell may be meant as a time: it is no word."""
    return not isinstance(cell, str) or not cell.strip() or cell.strip()[0] in "+-.0123456789" or _is_date(cell.strip())


def first_time(table: Table, name: str) -> int:
    """Return the index of the first row with a time."""
    return next((i for i, cell in enumerate(table.columns[name]) if is_time(cell)), 0)


def _with_times(table: Table, name: str, values: Floats, unit: str, note: str, *, calendar: bool) -> Table:
    columns, units = {**table.columns, name: values}, {**table.units, name: unit}
    loose, plain = table.loose - {name}, table.plain - {name}
    notes = *table.notes, note
    return replace(table, columns=columns, units=units, loose=loose, plain=plain, notes=notes, calendar=calendar)


def _partner(table: Table, name: str, others: Collection[str]) -> str | None:
    """Return the only other column that has the times of day to the dates of this one, or the dates to its times."""
    is_time, is_day = is_clock(table.columns[name]), _is_of_days(table.columns[name])
    fits = _is_of_days if is_time else is_clock
    partners = [
        candidate
        for candidate in others
        if (is_time or is_day) and candidate != name and fits(table.columns[candidate])
    ]
    return partners[0] if len(partners) == 1 else None


def _is_of_days(column: Column) -> bool:
    """Say whether a column holds dates without times of day."""
    cell = _first_cell(column)
    if not _is_date(cell):
        return False
    return ":" not in cell if isinstance(cell, str) else not isinstance(cell, datetime) or cell.time() == time()


def is_clock(column: Column) -> bool:
    """Say whether a column holds times of day, or durations."""
    if column.dtype.kind != "O":
        return False
    first = _first_cell(column)
    if isinstance(first, str):
        return (_MINUTES.fullmatch(first) or _DURATION.fullmatch(first)) is not None
    return isinstance(first, time | timedelta)


def _durations(table: Table, name: str, order: DateOrder | None) -> Floats:
    """Return times of day, or durations, in seconds, shape (n,), NaN where a cell is empty."""
    cells, present = _cells(table.columns[name])
    written = re.search(r"h+:mm(?!:ss)", name, re.IGNORECASE), re.search(r"(?<!:)m+:ss", name, re.IGNORECASE)
    pairs = order if order in ("h:mm", "m:ss") else "h:mm" if written[0] else "m:ss" if written[1] else None
    values = np.full(len(cells), np.nan)
    for row in np.flatnonzero(present):
        cell = cells[row]
        if isinstance(cell, time):
            cell = cell.isoformat()
        if isinstance(cell, timedelta):
            values[row] = cell.total_seconds()
            continue
        match = _MINUTES.fullmatch(cell) or _DURATION.fullmatch(cell) if isinstance(cell, str) else None
        if match is None or (int(match[4] or 0) > 59 and match[3]) or int(match[5] or 0) > 59:
            raise _no_date(table, name, int(row), "a time such as 12:30:05")
        sign, days, hours, minutes, seconds, fraction, half = match.groups()
        if seconds is None and half is None and pairs is None:
            raise CommonlawError(
                "times-ambiguous", where=table.source, column=name, row=table.locate(int(row)), cell=cell
            )
        if seconds is None and half is None and pairs == "m:ss":
            hours, minutes, seconds = "0", hours, minutes
        whole = _DAY * int(days or 0) + 3600 * _hours(hours or "0", half) + 60 * int(minutes or 0) + int(seconds or 0)
        values[row] = (-1.0 if sign else 1.0) * (whole + float(f"0.{fraction or 0}"))
    return values


def _hours_and_minutes(table: Table, name: str) -> Floats | None:
    """Return whole numbers such as 950 and 1000 as seconds since midnight, shape (n,); None if they are no hhmm.

    They are where nearly all steps from row to row are the same as such, and fewer are as numbers.
    """
    values = None if name in table.units else _numbers(table, name)
    if values is None or len(values) < 3:
        return None
    hours, minutes = np.divmod(values, 100)
    seconds = 3600 * hours + 60 * minutes
    is_hhmm = (values >= 0) & (values < 2400) & (minutes < 60) & (minutes == np.round(minutes))
    steps, raw = np.diff(seconds), np.diff(values)
    same, usual = steps == np.median(steps), raw == np.median(raw)
    return seconds if is_hhmm.all() and np.sum(same) >= max(0.9 * len(steps), np.sum(usual) + 2) else None


def _counts_days(table: Table, name: str, passed: NDArray[np.int64]) -> bool:
    """Say whether a column of numbers goes on by one at each midnight that has passed."""
    days = _numbers(table, name)
    return days is not None and np.array_equal(days - days[0], passed - passed[0])


def _numbers(table: Table, name: str) -> Floats | None:
    """Return a column of numbers, NaN where one is missing; None if it is none, for others to refuse."""
    try:
        return table.numbers(name, missing=True) if table.is_numeric(name) else None
    except CommonlawError:
        return None


def _epochs(table: Table, name: str) -> "pd.Series[Any] | None":
    """Return the dates of counts since 1970 in a column called a time, all in this century; None if it has others."""
    import pandas as pd

    if not _EPOCH_NAME.search(name) or (values := _numbers(table, name)) is None:
        return None
    kept = values[np.isfinite(values)]
    units: dict[Literal["s", "ms", "us", "ns"], float] = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
    first, last = (pd.Timestamp(year, 1, 1).timestamp() for year in (2000, 2100))
    for unit, scale in units.items():
        is_known = table.units.get(name, unit) in (unit, unit.replace("us", "µs"))
        if is_known and len(kept) and first <= kept.min() * scale and kept.max() * scale < last:
            return pd.Series(pd.Timestamp(0, tz="UTC") + pd.to_timedelta(values, unit=unit))
    return None


def _stamps(table: Table, name: str, order: DateOrder | None) -> "pd.Series[Any]":
    """Return the dates of a column, NaT where a cell is empty."""
    import pandas as pd

    cells, present = _cells(table.columns[name])
    # Where some dates have an offset from UTC and others none, it is not known what is meant
    rows = np.flatnonzero(present)
    shapes = [_shape(cell) if isinstance(cell, str) else "" for cell in cells[rows]]
    with_offset = {shape: _WITH_OFFSET.fullmatch(shape) is not None for shape in {*shapes}}
    offset = np.array([
        with_offset[shape] if shape else isinstance(cell, datetime) and cell.tzinfo is not None
        for cell, shape in zip(cells[rows], shapes, strict=True)
    ])  # fmt: skip
    if offset.any() and not offset.all():
        aware, naive = int(rows[offset][0]), int(rows[~offset][0])
        raise CommonlawError(
            "dates-with-and-without-offset",
            where=table.source,
            column=name,
            aware=str(cells[aware]),
            aware_row=table.locate(aware),
            naive=str(cells[naive]),
            naive_row=table.locate(naive),
        )
    is_iso = all(_ISO.fullmatch(shape) for shape in {*shapes} - {""})
    texts = cells if is_iso else _in_iso_order(table, name, cells, present, order)
    stamps = pd.Series(pd.to_datetime(texts, format="ISO8601", utc=True, errors="coerce"))
    wrong = np.flatnonzero(np.asarray(stamps.isna()) & present)
    if len(wrong):
        raise _no_date(table, name, int(wrong[0]), "a date such as 2020-03-31 or 2020-03-31 12:30:05")
    return stamps


def _shape(cell: str) -> str:
    """Return a cell with each digit as 0, which how it is written does not depend on."""
    return cell.translate(_ZEROS)


def _no_date(table: Table, name: str, row: int, what: str) -> CommonlawError:
    cell = str(table.columns[name][row]).strip()
    return CommonlawError(
        "date-unreadable", where=table.source, column=name, row=table.locate(row), cell=cell, kind=what
    )


def _in_iso_order(table: Table, name: str, cells: Column, present: Bools, order: DateOrder | None) -> Column:
    """Return dates as ISO 8601 writes them; the order of day and month is that which is possible in all rows."""
    texts = dict.fromkeys(cell for cell in cells[present].tolist() if isinstance(cell, str))
    local = {cell: readings for cell in texts if (readings := _readings(cell, order)) is not None}
    orders: tuple[DateOrder, ...] = ("dmy", "mdy", "ymd")
    for row in np.flatnonzero(present):
        if local.get(cells[row]) == {} and (order in orders or not any(_readings(cells[row], way) for way in orders)):
            raise _no_date(table, name, int(row), f"a date{f' in the order {order}' if order else ''}")
    by_order: dict[str, list[str]] = {}
    for candidate in orders:
        dates = [readings[candidate] for readings in local.values() if candidate in readings]
        if len(dates) == len(local) and dates not in by_order.values():
            by_order[candidate] = dates
    if not local:
        return cells
    first = next(iter(local))
    if len(by_order) > 1:
        ways = " or ".join(dates[0][:10] for dates in by_order.values())
        choices = [Diagnostic("dates-in-order", {"order": candidate}) for candidate in by_order]
        raise CommonlawError(
            "dates-ambiguous", where=table.source, column=name, first=first, ways=ways, choices=choices
        )
    if not by_order:
        raise CommonlawError("dates-without-order", where=table.source, column=name, first=first)
    chosen = dict(zip(local, *by_order.values(), strict=True))
    return np.array([chosen.get(cell, cell) for cell in cells], dtype=object)


def _readings(cell: str, order: DateOrder | None) -> dict[str, str] | None:
    """Return a date as ISO 8601 writes it, by the possible orders of its numbers; None if it needs none, or is none."""
    if named := _NAMED.match(cell):
        month = _MONTHS.index((named[2] or named[3]).casefold()) + 1
        cell = f"{named[1] or named[4]}.{month}.{named[5]}{cell[named.end() :]}"
    if _ISO.fullmatch(cell) or (match := _LOCAL.fullmatch(cell)) is None:
        return None
    first, mark, second, third, hour, minute, seconds, fraction, half, offset, *_ = match.groups()
    if order in ("dmy", "mdy", "ymd"):
        orders: tuple[str, ...] = (order,)
    elif len(first) > 2:
        orders = ("ymd",)
    elif mark == ".":
        orders = ("dmy",)
    else:
        orders = ("dmy", "mdy", "ymd") if mark == "-" and len(third) <= 2 else ("dmy", "mdy")
    rest = ""
    if hour is not None:
        rest = f"T{_hours(hour, half):02}:{minute}:{seconds or '00'}.{fraction or '0'}{(offset or '').strip()}"
    result = dict[str, str]()
    for candidate in orders:
        year, month, day = (int((first, second, third)[candidate.index(letter)]) for letter in "ymd")
        with suppress(ValueError):
            # Two digits from 69 on are years of the twentieth century, as POSIX has it
            result[candidate] = f"{date(year + (0 if year > 99 else 1900 if year >= 69 else 2000), month, day)}{rest}"
    return result


def _hours(text: str, half: str | None) -> int:
    """Return the hours since midnight, of a clock of twelve hours in a `half` of the day."""
    return int(text) % 12 + 12 * (half.casefold() == "p") if half else int(text)


def _first_cell(column: Column) -> object:
    """Return the first cell that is not empty, as `_cells` has it; None if there is none."""
    import pandas as pd

    stripped = (cell.strip() or None if isinstance(cell, str) else cell for cell in column)
    first = next((cell for cell in stripped if pd.isna(cell) is not True), None)
    if column.dtype.kind == "O" and not (isinstance(first, str) and _DIGITS.fullmatch(first)):
        return first
    cells, present = _cells(column)
    return cells[present][0] if present.any() else None


def _cells(column: Column) -> tuple[Column, Bools]:
    """Return cells without blanks around them, None where they are empty, and which are not; none of numbers."""
    import pandas as pd

    if column.dtype.kind != "O":
        return _compact(column) or (column, np.zeros(len(column), dtype=np.bool_))
    cells = np.array([cell.strip() or None if isinstance(cell, str) else cell for cell in column], dtype=object)
    present = ~np.asarray(pd.isna(cells), dtype=np.bool_)
    if all(isinstance(cell, str) and _DIGITS.fullmatch(cell) for cell in cells[present]):
        return _compact(pd.to_numeric(pd.Series(cells)).to_numpy(np.float64)) or (cells, present & False)
    return cells, present


def _compact(values: Floats) -> tuple[Column, Bools] | None:
    """Return numbers as dates in text, and which are there; None if not even half of them are such as 20200331."""
    import pandas as pd

    finite = values[np.isfinite(values)]
    if not len(finite) or finite.min() < _YEARS[0] * 10_000 or finite.max() >= _YEARS[1] * 10_000:
        return None
    numbers, codes = np.unique(finite, return_inverse=True)
    texts = np.array([f"{number:.15g}" for number in numbers], dtype=object)
    dates = np.asarray(pd.to_datetime(pd.Series(texts), format="%Y%m%d", errors="coerce").notna(), dtype=np.bool_)
    if 2 * np.sum(dates) <= len(dates):
        return None
    cells = np.full(len(values), None, dtype=object)
    texts[dates] = [f"{text[:4]}-{text[4:6]}-{text[6:]}" for text in texts[dates]]
    cells[np.isfinite(values)] = texts[codes]
    return cells, np.isfinite(values)


def _is_date(cell: object) -> bool:
    if isinstance(cell, str):
        return (_ISO.fullmatch(cell) or _DIGITS.fullmatch(cell)) is not None or _readings(cell, None) is not None
    return isinstance(cell, date)
