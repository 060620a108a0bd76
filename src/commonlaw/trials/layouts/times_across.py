"""A row for each object and a column for each time."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from commonlaw.trials.columns import Column, Table
from commonlaw.trials.dates import elapsed_in_names, holds_dates, years_of
from commonlaw.trials.layouts.stacking import quantified, stacked
from commonlaw.trials.reading import READ_AS, Reading, WrittenReading
from commonlaw.trials.recognition import OBJECT, TIME, is_called
from commonlaw.trials.wide import quantity


def times_across(table: Table, reading: Reading) -> Table | None:
    """Return a table whose columns are times as one with a row for each cell; None if they are not."""
    if reading.get("time") in table.columns:
        return None
    dates = [name for name in table.columns if holds_dates(np.array([name], dtype=object))]
    unit, numbers = ("year", years_of(table.columns)) if len(dates) < 3 else ("", {})
    if len(dates) < 3 and len(numbers) < 3:
        unit, numbers = elapsed_in_names(table.columns)
    times = list(numbers) if len(dates) < 3 else dates
    others = [name for name in table.columns if name not in set(times)]
    if len(times) < max(3, len(others)) or not all(map(table.is_numeric, times)):
        return None
    words = [name for name in others if not table.is_numeric(name) or is_called(name, OBJECT)]
    if numbers and not (words and all(here < there for here, there in pairwise(numbers.values()))):
        return None
    if numbers and unit != "year" and any(is_called(name, TIME) for name in others):
        return None
    name, labels = _objects(table, words)
    state, count = quantity((), reading.get("wide")), len(table)
    stamps = np.array([numbers.get(time, time) for time in times], dtype=np.float64 if numbers else object)
    more = {
        name: np.tile(labels, len(times)),
        "time": np.repeat(stamps, count),
        state: np.concatenate([quantified(table, time) for time in times]),
    }
    long = stacked(table, times, others, more)
    note = (
        f"{READ_AS}a table with times across, {times[0]} to {times[-1]}, and an object in each row, named by {name}: "
        f"{state} is what was measured"
    )
    roles: WrittenReading = {**table.roles, "object": name, "time": "time", "states": [state]}
    units = {**long.units, "time": unit} if numbers else long.units
    return replace(long, units=units, roles=roles, notes=(*table.notes, note))


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
