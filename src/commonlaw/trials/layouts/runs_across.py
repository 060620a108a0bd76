"""Runs next to each other, each with a column of its times: ``t 1, x 1, t 2, x 2``."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import takewhile

import numpy as np

from commonlaw.text import counted
from commonlaw.trials.columns import Table, stacked_column
from commonlaw.trials.headers import join_header, split_header
from commonlaw.trials.layouts.stacking import stacked
from commonlaw.trials.reading import READ_AS, Reading
from commonlaw.trials.recognition import TIME, TRIAL, is_called, is_time_header, readable, words
from commonlaw.trials.wide import shown_columns

_RUN = re.compile(rf"(.+?)(((?<![^\W_])({'|'.join(sorted(TRIAL))})\s*)?#?\d{{1,4}})", re.IGNORECASE)
"""A name and its run: ``Time (s) Run #1``, ``time_1``."""
_AGAIN = re.compile(r"(.+)\.(\d{1,3})")
"""A name that occurs again, as pandas writes it."""
_SEPARATORS = " _-.:#"

Runs = Mapping[str, Mapping[str, str]]
"""The columns of each run by what they hold, with its unit."""


def runs_across(table: Table, reading: Reading) -> Table | None:
    """Return a table that has a column of times for each run as one with the runs below each other; None if not so.

    All columns are of a run, ``Run 1: Time``, ``time_1`` or ``time A``, each run has the same, and one of them is a
    time: by its name, or as the first of two, x, that increases. A single run may be named by its time.
    """
    for runs in (_by_number(table), _by_place(table)):
        headers = [*next(iter(runs.values()), {})]
        if len(runs) < 2 or len(headers) < 2 or any({*run} != {*headers} for run in runs.values()):
            continue
        times = [header for header in headers if (name := split_header(header)[0]) == "t" or is_called(name, TIME)]
        if not times and len(headers) == 2 and split_header(headers[0])[0].casefold() == "x":
            times = headers[:1] if all(_increases(table, run[headers[0]]) for run in runs.values()) else []
        if len(times) == 1 and reading.get("time") not in table.columns.keys() - {split_header(times[0])[0]}:
            return _below(table, runs, times[0])
    return None


def _by_number(table: Table) -> Runs:
    runs = dict[str, dict[str, str]]()
    for column in table.columns:
        run, _, name = column.partition(":")
        if not name and (match := _AGAIN.fullmatch(column)) and match[1] in table.columns:
            name, run = match[1], str(int(match[2]) + 1)
        elif not name and f"{column}.1" in table.columns:
            name, run = column, "1"
        elif not name and (match := _RUN.fullmatch(column)):
            name, run = match[1], match[2]
        name, unit = split_header(name.strip(" _,-"))
        runs.setdefault(run.strip(), {})[join_header(name, table.units.get(column, unit))] = column
    return runs


def _by_place(table: Table) -> Runs:
    """Return the columns of runs that begin with a time each, whose names have one part that differs between runs."""
    columns = [*table.columns]
    begins = [i for i, name in enumerate(columns) if _is_time(table, name)]
    width = begins[1] if len(begins) > 1 else len(columns)
    if len(columns) % width or begins != [*range(0, len(columns), width)]:
        return {}
    stems, labels = list[str](), list[list[str]]()
    for j in range(width):
        names = columns[j::width]
        before = _begin(names)
        after = _begin([name[len(before) :][::-1] for name in names])[::-1]
        before = before[: 1 + max(before.rfind(mark) for mark in _SEPARATORS)] or before
        after = after[min((i for mark in _SEPARATORS if (i := after.find(mark)) >= 0), default=0) :]
        stems.append((before + after).strip(_SEPARATORS))
        labels.append([name[len(before) : len(name) - len(after)].strip(_SEPARATORS) for name in names])
    if not all(stems) or len({*stems}) < width or any(label != labels[0] for label in labels) or not all(labels[0]):
        return {}
    runs = dict[str, dict[str, str]]()
    for i, column in enumerate(columns):
        name, unit = split_header(stems[i % width])
        runs.setdefault(labels[0][i // width], {})[join_header(name, table.units.get(column, unit))] = column
    return runs


def _begin(names: Sequence[str]) -> str:
    """Return what all names begin with."""
    return "".join(letters[0] for letters in takewhile(lambda letters: len({*letters}) == 1, zip(*names, strict=False)))


def _is_time(table: Table, name: str) -> bool:
    return words(name)[:1] == ["t"] or is_time_header(join_header(name, table.units.get(name, "")))


def _increases(table: Table, column: str) -> bool:
    values = readable(table, column)
    steps = np.diff(values[np.isfinite(values)])
    return bool(len(steps) and (steps > 0).all())


def _below(table: Table, runs: Runs, time: str) -> Table:
    """Return the runs below each other, without the empty rows of shorter ones."""
    headers = {header: split_header(header) for header in next(iter(runs.values()))}
    more = {
        name: stacked_column([(table, run[header]) for run in runs.values()]) for header, (name, _) in headers.items()
    }
    more["object"] = np.repeat(np.array([*runs], dtype=object), len(table))
    long = stacked(table, [run[time] for run in runs.values()], (), more)
    loose = {name for header, (name, _) in headers.items() if {run[header] for run in runs.values()} & table.loose}
    shown_runs = f"{counted(len(runs), 'run')}, {shown_columns([*runs])}"
    long = replace(
        long,
        units={name: unit for name, unit in headers.values() if unit},
        loose=frozenset(loose),
        roles={**table.roles, "object": "object", "time": headers[time][0]},
        notes=(*table.notes, f"{READ_AS}columns of {shown_runs}, each an object with its times"),
    )
    return long.taken(np.flatnonzero(np.any([long.codes(name) >= 0 for name in more if name != "object"], axis=0)))
