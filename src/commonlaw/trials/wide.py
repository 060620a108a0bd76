"""Tables with a column for each object, such as the wells of a plate, and how they are told."""

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.trials.columns import Codes, Column, Table, column_of
from commonlaw.trials.dates import is_time
from commonlaw.trials.headers import split_header

_DEFAULT = "value"
"""Name of what stands in the columns, if nobody names it."""
_WELL = re.compile(r"[A-P]0?([1-9]|1\d|2[0-4])")
"""Of a plate of up to 384 wells."""
_NUMBERED = re.compile(r"(.*?)[\W_]*\d+")
_FEW, _MANY = 4, 8
"""Columns of like names, and of any names, from which on they may be an object each."""


def check_wide(table: Table, states: Sequence[str]) -> tuple[str, ...]:
    """Return a note if columns that were taken as the states of one object may well be an object each.

    Raises
    ------
    CommonlawError
        If they are named like the wells of a plate.
    """
    wells = [name for name in states if _WELL.fullmatch(name)]
    stems = {found[1].casefold() if (found := _NUMBERED.fullmatch(name)) else name for name in states}
    if len(wells) >= _FEW:
        raise CommonlawError(
            f"{table.source}: {_shown(wells)} are named like wells, each an object of its own: read them with "
            f"wide={_DEFAULT!r}, or the name of what was measured; if they are states of one object, name them with "
            "states=[...]"
        )
    alike = len(states) >= _FEW and len(stems) == 1
    if not alike and (len(states) < _MANY or len({table.units.get(name) for name in states}) > 1):
        return ()
    return (
        f"{_shown(states)} are taken as states of one object; if each is an object of its own, read them with "
        f"wide={_DEFAULT!r}, or the name of what was measured",
    )


def long_table(
    table: Table, time: str, repeated: Sequence[str], columns: Sequence[str], wide: object
) -> tuple[Table, str, Codes]:
    """Return a table with a row for each sample of each object, the name of its state, and the row that each was in.

    Parameters
    ----------
    table
        A table with a column for each object.
    time
        The column of times. Rows ahead of the first time are conditions: a column of the name in place of the time.
    repeated
        Columns that are the same for all objects.
    columns
        Those of the objects.
    wide
        The name of what stands in these columns, with its unit or without; True is for ``value``.
    """
    name, unit = _state(table, columns, wide)
    if name in (taken := [time, *repeated, "object"]) or not columns:
        raise CommonlawError(
            f"{table.source}: {name!r} is the name of a column: give what was measured another with wide=..."
            if name in taken
            else f"{table.source}: no column of numbers is left to be an object: name them with states=[...]"
        )
    first = next((i for i, cell in enumerate(table.columns[time]) if is_time(cell)), 0)
    rows, count = np.arange(first, len(table)), len(columns)
    measured = table.taken(rows)
    made: dict[str, Column] = {"object": np.repeat(np.array(columns, dtype=object), len(rows))}
    made |= {each: np.tile(measured.columns[each], count) for each in (time, *repeated)}
    made[name] = np.concatenate([measured.numbers(each, missing=True) for each in columns])
    conditions = _conditions(table, time, columns, first)
    if twice := conditions.keys() & made.keys():
        raise CommonlawError(f"{table.source}: {min(twice)!r} is the name of a row and of a column: rename one of them")
    made |= {key: np.repeat(values, len(rows)) for key, values in conditions.items()}
    units = {each: table.units[each] for each in (time, *repeated) if each in table.units}
    long = replace(
        measured,
        columns=made,
        units=units | ({name: unit} if unit else {}),
        loose=frozenset((table.loose - set(columns)) | conditions.keys()),
        locate=lambda row: f"{measured.locate(row % len(rows))}, column {columns[row // len(rows)]!r}",
        number=lambda row: measured.number(row % len(rows)),
        parsed={},
    )
    return long, name, np.tile(rows, count)


def _state(table: Table, columns: Sequence[str], wide: object) -> tuple[str, str]:
    """Return the name and the unit of what stands in the columns."""
    if not isinstance(wide, bool | str) or not wide:
        raise CommonlawError(f"wide is {wide!r}: give the name of what was measured, such as 'OD', or True")
    name, unit = split_header(_DEFAULT if isinstance(wide, bool) else wide)
    units = {table.units.get(each, "") for each in columns}
    if not unit and len(units) > 1:
        raise CommonlawError(
            f"{table.source}: the columns of the objects have several units ({', '.join(sorted(units))}): name those "
            "of one quantity with states=[...]"
        )
    return name, unit or next(iter(units), "")


def _conditions(table: Table, time: str, columns: Sequence[str], rows: int) -> dict[str, Column]:
    """Return the values of the objects in so many first rows, by what stands in place of the time."""
    cells = ([table.columns[each][row] for each in columns] for row in range(rows))
    names = (table.columns[time][row] for row in range(rows))
    return {name.strip(): column_of(own)[0] for name, own in zip(names, cells, strict=True) if isinstance(name, str)}


def _shown(names: Sequence[str]) -> str:
    return f"{', '.join(names[:2])}, ..., {names[-1]} ({len(names)} columns)"
