"""Points of one recording next to each other, each with the same quantities at common times: ``A: x, B: x``."""

import re
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.trials.columns import Table, stacked_column
from commonlaw.trials.headers import split_header
from commonlaw.trials.layouts.stacking import stacked
from commonlaw.trials.reading import READ_AS, Reading
from commonlaw.trials.recognition import is_time_header, readable
from commonlaw.trials.wide import coupling, longest_run, shown_columns


def points_across(table: Table, reading: Reading) -> Table | None:
    """Return a table whose columns are of points, named above them, with the points below each other; None if not so.

    They are an object each; or states of one, ``x_A``, where `object` is ``""`` or they act on each other, see
    `coupling`.
    """
    points, units = dict[str, dict[str, str]](), dict[str, set[str]]()
    for column in table.columns:
        point, colon, header = column.partition(": ")
        if colon:
            quantity, unit = split_header(header)
            points.setdefault(point.strip(), {})[quantity] = column
            units.setdefault(quantity, set()).add(table.units.get(column, unit))
    others = [column for column in table.columns if ": " not in column]
    names = [*units]
    times = [column for column in others if is_time_header(column)]
    if (
        len(points) < 2
        or len(times) != 1
        or any({*point} != {*names} for point in points.values())
        or any(len(of) > 1 for of in units.values())
        or any(column in (reading.get("states") or ()) for column in table.columns)
        or not all(table.is_numeric(column) for point in points.values() for column in point.values())
    ):
        return None
    note = f"{READ_AS}{len(points)} points, {shown_columns([*points])}, "
    by_point = [[point[name] for point in points.values()] for name in names]
    owner = reading.get("object")
    if owner == "" or (owner is None and _act_on_each_other(table, times[0], by_point)):
        new = {
            column: re.sub(r"\W+", "_", f"{name}_{point}")
            for point, of in points.items()
            for name, column in of.items()
        }
        why = "" if owner == "" else ", as they act on each other; if each is an object, say `object='point'`"
        return _renamed(table, new, f"{note}states of one object{why}")
    columns = [*points.values()]
    more = {name: stacked_column([(table, point[name]) for point in columns]) for name in names}
    more["point"] = np.repeat(np.array([*points], dtype=object), len(table))
    long = stacked(table, [point[names[0]] for point in columns], others, more)
    return replace(
        long,
        units={**long.units, **{name: unit for name, of in units.items() if (unit := next(iter(of)))}},
        loose=long.loose | {name for name in names if {point[name] for point in columns} & table.loose},
        roles={**table.roles, "object": "point"},
        notes=(*table.notes, f"{note}each an object; if they are states of one, say `object=''`"),
    )


def _act_on_each_other(table: Table, time: str, by_point: list[list[str]]) -> bool:
    """Say whether a quantity of a point needs those of others to be explained."""
    times = readable(table, time)
    return any(coupling(*longest_run(times, _values(table, names), np.empty((len(table), 0)))) for names in by_point)


def _values(table: Table, names: list[str]) -> Floats:
    return np.column_stack([readable(table, name) for name in names])


def _renamed(table: Table, names: dict[str, str], note: str) -> Table:
    """Return the table with other names of some columns."""
    return replace(
        table,
        columns={names.get(name, name): column for name, column in table.columns.items()},
        units={names.get(name, name): unit for name, unit in table.units.items()},
        loose=frozenset(names.get(name, name) for name in table.loose),
        plain=table.plain - names.keys(),
        commas=table.commas - names.keys(),
        parsed={},
        meant={},
        notes=(*table.notes, note),
    )
