"""Wide tables: a column for each object, or for each time."""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.columns import Codes, Column, Table, column_of
from commonlaw.trials.dates import first_time, holds_dates, years_of
from commonlaw.trials.headers import known_unit, split_header
from commonlaw.trials.recognition import QUANTITIES, SEPARATE, is_called, readable, words

NOISE = " noise"
"""What the name of a column of standard deviations has behind that of its state."""
_DEFAULT = "value"
"""Name of what stands in the columns, if nobody names it."""
_WELL = re.compile(r"(?:(.*[\W_]))?([A-P])0?(?:[1-9]|1\d|2[0-4])")
"""Of a plate of up to 384 wells, after the name of what was measured or without it."""
_NUMBERED = re.compile(r"(.*?)[\W_]*\d+")
_REPLICATE = re.compile(r"(.*[^\W\d_]{2})[\W_]*\d+")
"""A word of two letters at least, and a number."""
_CONDITION = re.compile(r"[-+]?\d+(?:[.,]\d+)?\s*(\D+)")
"""A number with a unit, such as the temperature or the dose of a run."""
_MIN_LIKE_COLUMNS, _MIN_COLUMNS = 4, 8
"""Columns of like names, and of any names, from which on they may be an object each."""
_MAX_REPLICATE_DIFFERENCE = 0.1
"""Of the range of their mean, by how much replicates differ from it; and of all values, by how much starts differ."""


def columns_of_one_quantity(table: Table, names: Sequence[str]) -> list[str]:
    """Return those columns of numbers that hold one quantity of an object each; none if that is in doubt.

    They have one unit, and names of wells; or all are called by conditions in the same unit, ``25 °C``, ``35 °C``; or
    by words with numbers, which name individuals or repetitions, or have nearly the same values for the same word, as
    replicates have. Names of quantities such as theta are no such words.
    """
    conditions = {found[1].strip() if (found := _CONDITION.fullmatch(name)) else None for name in names}
    wells = {name: found for name in names if (found := _WELL.fullmatch(name))}
    stems = {name: found[1] for name in names if (found := _REPLICATE.fullmatch(name))}
    groups = [[name for name in stems if stems[name] == stem] for stem in dict.fromkeys(stems.values())]
    if len(wells) >= _MIN_LIKE_COLUMNS and len({well[1] for well in wells.values()}) == 1:
        letters = {well[2] for well in wells.values()}
        values = _complete(table, [*wells])
        start_alike = len(values) and np.ptp(values[0]) < _MAX_REPLICATE_DIFFERENCE * np.ptp(values)
        alike = [*wells] if len(letters) > 1 or len(wells) >= _MIN_COLUMNS or start_alike else []
    elif len(names) > 1 and len(conditions) == 1 and (condition := conditions.pop()):
        unit = known_unit(condition)  # Lengths are the places of sensors on one object
        alike = [] if unit is not None and unit.dimensionality == {"[length]": 1} else list(names)
    elif len(stems) == len(names) > 2 and not any(map(_is_variable, stems.values())):
        individuals = all(is_called(stem, SEPARATE) for stem in stems.values())
        values = _complete(table, names)
        span = float(np.ptp(values)) if values.size else 0.0
        repeated = len(groups) < len(names) and all(_are_repeated(table, group, span) for group in groups)
        alike = list(names) if individuals or repeated else []
    else:
        return []
    return alike if len({table.units.get(name) for name in alike}) == 1 else []


def _is_variable(stem: str) -> bool:
    """Say whether a name ends in a quantity or is a Greek letter, which one object may have several of."""
    try:
        unicodedata.lookup(f"GREEK SMALL LETTER {stem.upper()}")
    except KeyError:
        return words(stem)[-1] in QUANTITIES
    return True


def _complete(table: Table, names: Sequence[str]) -> Floats:
    """Return the rows of columns without missing values, shape (n, columns)."""
    values = np.column_stack([readable(table, name) for name in names])
    return np.asarray(values[np.isfinite(values).all(axis=1)])


def _are_repeated(table: Table, names: Sequence[str], span: float) -> bool:
    """Return whether columns are replicates: nearly equal, or both constant as blanks next to the range of all."""
    values = _complete(table, names)
    mean = values.mean(axis=1, keepdims=True)
    if not len(values):
        return False
    return bool(
        np.sqrt(np.mean((values - mean) ** 2)) < _MAX_REPLICATE_DIFFERENCE * np.ptp(mean)
        or np.ptp(values) < _MAX_REPLICATE_DIFFERENCE * span
    )


def wide_hint(table: Table, states: Sequence[str]) -> tuple[str, ...]:
    """Return a note if columns that were taken as the states of one object may well be an object each."""
    stems = {found[1].casefold() if (found := _NUMBERED.fullmatch(name)) else name for name in states}
    alike = len(states) >= _MIN_LIKE_COLUMNS and len(stems) == 1
    if not alike and (len(states) < _MIN_COLUMNS or len({table.units.get(name) for name in states}) > 1):
        return ()
    return (
        f"{shown_columns(states)} are taken as states of one object; if each is an object of its own, read them with "
        f"`wide={_DEFAULT!r}`, or the name of what was measured",
    )


def long_table(
    table: Table, time: str, columns: Sequence[str], noise: Mapping[str, str], wide: object
) -> tuple[Table, str, Codes]:
    """Return a table with a row for each sample of each object, the name of its state, and the row that each was in.

    Given are the column of times; those of the objects, and of standard deviations by them, which go to the column
    of the state's name and `NOISE`; and the name of the state. Rows ahead of the first time are conditions.
    """
    if not isinstance(wide, bool | str) or not wide:
        raise CommonlawError("wide-not-a-name", value=wide)
    name, unit = split_header(quantity(columns, wide))
    units = {table.units.get(column, "") for column in columns}
    if not unit and len(units) > 1:
        raise CommonlawError("wide-units", where=table.source, units=sorted(units))
    unit = unit or next(iter(units), "")
    repeated = [column for column in table.columns if column not in (time, *columns, *noise.values())]
    if name in (time, *repeated, "object"):
        raise CommonlawError("wide-name-taken", where=table.source, name=name)
    if not columns:
        raise CommonlawError("wide-without-objects", where=table.source)
    first = first_time(table, time)
    rows, count = np.arange(first, len(table)), len(columns)
    measured = table.taken(rows)
    made: dict[str, Column] = {"object": np.repeat(np.array(columns, dtype=object), len(rows))}
    made |= {each: np.tile(measured.columns[each], count) for each in (time, *repeated)}
    made[name] = np.concatenate([_quantified(measured, column) for column in columns])
    if noise:
        if without := [column for column in columns if column not in noise]:
            raise CommonlawError("wide-without-deviations", where=table.source, columns=shown_columns(without))
        made[name + NOISE] = np.concatenate([measured.numbers(noise[column], missing=True) for column in columns])
    conditions = {
        label.strip(): column_of([table.columns[column][row] for column in columns])[0]
        for row, label in enumerate(table.columns[time][:first])
        if isinstance(label, str)
    }
    if twice := conditions.keys() & made.keys():
        raise CommonlawError("wide-name-twice", where=table.source, name=min(twice))
    made |= {key: np.repeat(values, len(rows)) for key, values in conditions.items()}
    kept_units = {each: table.units[each] for each in (time, *repeated) if each in table.units}
    long = replace(
        measured,
        columns=made,
        units=kept_units | ({name: unit} if unit else {}),
        loose=frozenset((table.loose - set(columns)) | conditions.keys()),
        locate=lambda row: f"{measured.locate(row % len(rows))}, column {columns[row // len(rows)]!r}",
        number=lambda row: measured.number(row % len(rows)),
        parsed={},
    )
    return long, name, np.tile(rows, count)


def quantity(columns: Sequence[str], wide: bool | str) -> str:
    """Return the name of what was measured: if nobody names it, what the names of wells begin with."""
    if isinstance(wide, str):
        return wide
    begins = {found[1] or "" if (found := _WELL.fullmatch(name)) else "" for name in columns}
    return begins.pop().strip(" _-.:") or _DEFAULT if len(begins) == 1 else _DEFAULT


def shown_columns(names: Sequence[str]) -> str:
    """Return names in short."""
    return f"{', '.join(names[:2])}, ..., {names[-1]} ({len(names)} columns)" if len(names) > 3 else ", ".join(names)


_FEWEST = 3
"""Columns named by times from which on they are taken for such."""
_VALUE, _TIME = "value", "time"
"""What stands in the columns, and when, if nobody names it."""


def times_across(table: Table, wide: bool | str | None) -> tuple[Table, Codes] | None:
    """Return a table whose columns are times as a row for each cell, and the rows of these; None if they are not."""
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
    stamps = np.array([years.get(time, time) for time in times], dtype=np.float64 if years else object)
    columns: dict[str, Column] = {name: labels[rows]}
    columns |= {each: table.columns[each][rows] for each in others if each != name}
    columns[_TIME] = np.tile(stamps, len(table))
    columns[state] = np.column_stack([_quantified(table, time) for time in times]).ravel()
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


def _quantified(table: Table, name: str) -> Floats:
    """Return a column of measurements, refused if values in it are below a limit of quantification."""
    if np.isfinite(table.limits(name)).any():
        raise CommonlawError("wide-censored", where=table.source, column=name)
    return table.numbers(name, missing=True)
