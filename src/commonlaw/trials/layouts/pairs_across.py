"""Pairs of columns, each of times and of a quantity with a name of its own: ``t, wild type, t, mutant``."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.text import counted
from commonlaw.trials.columns import Table, stacked_column
from commonlaw.trials.headers import join_header, split_header
from commonlaw.trials.layouts.grid import SORTED, Sample, merged
from commonlaw.trials.layouts.stacking import quantified, stacked
from commonlaw.trials.reading import READ_AS, Reading
from commonlaw.trials.recognition import is_time_header
from commonlaw.trials.wide import quantity, shown_columns

_NUMBER = re.compile(r"[\s_.-]*\d+$")


def pairs_across(table: Table, reading: Reading) -> Table | None:
    """Return a table with a row for each sample of pairs of columns, None if it has none.

    With `wide` the pairs are an object each; with `states`, or where all units differ, states of one object.
    """
    times, names = [*table.columns][::2], [*table.columns][1::2]
    stems = {join_header(_NUMBER.sub("", name), table.units.get(name, "")) for name in times}
    stem = next(iter(stems), "")
    if len(times) < 2 or len(names) < len(times) or len(stems) > 1 or not is_time_header(stem):
        return None
    if reading.get("time") in table.columns.keys() - {split_header(stem)[0]}:
        return None  # A single pair
    if any(is_time_header(join_header(name, table.units.get(name, ""))) for name in names):
        return None
    wide, units = reading.get("wide"), [table.units.get(name, "") for name in names]
    note = f"{READ_AS}{counted(len(names), 'pair')} of times and a quantity, {shown_columns(names)}, "
    if wide:
        return _objects(table, stem, times, names, *split_header(quantity(names, wide)), note=note)
    if reading.get("states") or len({*units}) == len(units):
        return _states(table, stem, times, names, note)
    raise CommonlawError("pairs-ambiguous", where=table.source, columns=names, states=names)


def _objects(
    table: Table, header: str, times: Sequence[str], names: Sequence[str], state: str, unit: str, note: str
) -> Table:
    """Return the pairs below each other, with the name of the quantity as that of the object."""
    units = {table.units.get(name, "") for name in names}
    if not unit and len(units) > 1:
        raise CommonlawError("wide-units", where=table.source, units=sorted(units))
    time, time_unit = split_header(header)
    columns = {
        time: stacked_column([(table, name) for name in times]),
        state: np.concatenate([quantified(table, name) for name in names]),
        "object": np.repeat(np.array(names, dtype=object), len(table)),
    }
    long = stacked(table, names, (), columns)
    written = {time: time_unit, state: unit or next(iter(units))}
    long = replace(
        long,
        units={name: text for name, text in written.items() if text},
        loose=frozenset({time} if {*times} & table.loose else ()),
        roles={**table.roles, "object": "object", "time": time, "states": [state]},
        notes=(*table.notes, f"{note}each an object"),
    )
    return long.taken(np.flatnonzero(long.codes(time) >= 0))


def _states(table: Table, header: str, times: Sequence[str], names: Sequence[str], note: str) -> Table:
    """Return a table with a row for each time of any pair, and a column for each quantity."""
    samples = list[tuple[float, Sample]]()
    for time, name in zip(times, names, strict=True):
        counts, state = Counter[object](), join_header(name, table.units.get(name, ""))
        order = table.numbers(time, missing=True) if table.is_numeric(time) else np.arange(len(table), dtype=np.float64)
        for row in np.flatnonzero(table.codes(time) >= 0).tolist():
            stamp = table.columns[time][row]
            counts[stamp] += 1
            cells = {header: stamp, state: table.columns[name][row]}
            place = Sample((stamp, counts[stamp]), cells, f"{table.locate(row)}, column {name!r}", table.number(row))
            samples.append((float(order[row]), place))
    samples.sort(key=lambda pair: pair[0])
    return replace(
        merged(table.source, [sample for _, sample in samples]),
        notation=table.notation,
        label=table.label,
        roles={**table.roles, "time": split_header(header)[0], "states": [*names], **SORTED},
        notes=(*table.notes, f"{note}states of one object"),
    )
