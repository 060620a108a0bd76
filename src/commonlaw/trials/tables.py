"""Trials from tables, also from wide ones, and from arrays."""

import itertools
import os
from collections import Counter
from collections.abc import Container, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import Diagnostic, is_note, note
from commonlaw.errors import CommonlawError
from commonlaw.text import counted, shown
from commonlaw.trials.columns import Codes, Table, column_of, with_numbers, with_unit
from commonlaw.trials.dates import (
    Elapsed,
    elapsed,
    first_time,
    with_dates_as_times,
)
from commonlaw.trials.headers import joined_units, known_unit, label, split_header
from commonlaw.trials.layouts.blocks import BLOCK
from commonlaw.trials.layouts.columns import table_in_columns
from commonlaw.trials.layouts.stacking import quantified, stacked
from commonlaw.trials.nonmem import doses_of, with_records
from commonlaw.trials.properties import column_properties, given_properties, object_codes
from commonlaw.trials.reading import Reading, Restarts, checked, notation_of
from commonlaw.trials.recognition import (
    CONSTANT_IN_TRIALS,
    input_values,
    is_covariate,
    readable,
    runs_of_labels,
    unit_in_name,
    units_in_names,
)
from commonlaw.trials.roles import ColumnRoles, column_roles, free_columns, time_of
from commonlaw.trials.trial import EXTREME, PropertyTable, Schema, Trial, TrialData, as_numbers, check_measured
from commonlaw.trials.units import in_radians
from commonlaw.trials.wide import quantity, shown_columns

Cells = tuple[Floats, Floats, Floats, Floats, Floats]
"""Of all rows: times, shape (n,), states, inputs, standard deviations of the states and limits that they are below of,
each of shape (n, columns)."""


@dataclass(frozen=True)
class Group:
    """Rows of one trial, in the order of the table: the trial's labels, and the indices of the rows, shape (n,)."""

    object: str
    trial: str
    rows: Codes

    @property
    def label(self) -> str:
        """Object and trial as shown in messages."""
        return f"{self.object}, trial {self.trial}"


def read_cells(table: Table, schema: Schema) -> Cells:
    """Return the numbers in the rows of a table."""
    times, noise = table.numbers(schema.time), np.full((len(table), len(schema.states)), np.nan)
    states = np.column_stack([table.numbers(name, missing=True) for name in schema.states])
    inputs = np.column_stack([np.empty((len(table), 0)), *(input_values(table, name) for name in schema.inputs)])
    for state, name in schema.noise_columns.items():
        j = schema.states.index(state)
        noise[:, j] = table.deviations(name, np.isfinite(states[:, j]))
    return times, states, inputs, noise, np.column_stack([table.limits(name) for name in schema.states])


def trials_of(
    table: Table, cells: Cells, groups: Sequence[Group], restarts: Restarts | None, *, named: bool
) -> tuple[list[Trial], list[Codes], list[str], list[str]]:
    """Return the trials of groups of rows, without rows that say nothing, see `are_used`.

    With them are the rows of their samples, labels of trials without any row left, and notes on what was done.

    Where times go back and it is not said what this means, rows are sorted if they are in reverse or in random order or
    a few single ones out of place, and refused otherwise. New trials are counted from 1, after the label of a group if
    it was `named`.
    """
    notes = []
    if restarts == "trials":
        begun = [group.label for group in groups if len(_back(cells[0], group))]
        parts = list[Group]()
        for group in groups:
            split = np.split(group.rows, _back(cells[0], group))
            before = f"{group.trial}-" if named else ""
            numbered = [Group(group.object, f"{before}{i}", rows) for i, rows in enumerate(split, 1)]
            parts += numbered if len(split) > 1 else [group]
        groups = parts
        notes = [f"a trial begins wherever the time goes back: {'; '.join(begun)}"] if begun else []
    # Rows of inputs alone, such as doses, come after what was measured at their times
    alone = np.asarray((np.isnan(cells[1]) & np.isnan(cells[4])).all(axis=1))
    sorted_rows = [group.rows[np.lexsort((alone[group.rows], cells[0][group.rows]))] for group in groups]
    for group, rows in zip(groups, sorted_rows, strict=True):
        _refuse_twice(table, cells, rows, group, groups, may_be_apart=restarts == "sort")
    if restarts is None:
        _refuse_restarts(table, cells[0], groups)
    late = [group.label for group in groups if len(_back(cells[0], group))]
    notes += [f"sorted by time: {'; '.join(late)}"] if late else []
    made, row_indices, empty, gaps = [], [], [], []
    for group, rows in zip(groups, sorted_rows, strict=True):
        kept = are_used(np.where(np.isnan(cells[4][rows]), cells[1][rows], 0.0), driven=cells[2].shape[1] > 0)
        if not kept.all():
            gaps.append(f"{group.label}: {shown([table.locate(int(row)) for row in rows[~kept]])}")
        if kept.any():
            times, states, inputs, noise, below = (cell[rows[kept]] for cell in cells)
            earlier = inputs_before(cells[0][rows], cells[2][rows], kept)
            trial = Trial(group.object, group.trial, times, states, inputs, noise, earlier=earlier, below=below)
            made.append(replace(trial, doses=doses_of(table, rows)) if table.administered else trial)
            row_indices.append(table.rows[rows[kept]])
        else:
            empty.append(group.label)
    notes += [f"rows without a measured state left out: {'; '.join(gaps)}"] if gaps else []
    notes += repeats_in_words(made)
    return made, row_indices, empty, notes


def are_used(states: Floats, *, driven: bool) -> Bools:
    """Return which samples of a trial say something, from states of shape (n, states): none where nothing was measured.

    Those with a measured state; those after the last, which are to be forecast; and, where there are inputs, all after
    the first, such as a dose between two measurements.
    """
    measured = np.asarray(np.isfinite(states).any(axis=1))
    begun = np.logical_or.accumulate(measured)
    after = ~np.logical_or.accumulate(measured[::-1])[::-1]
    return np.asarray(measured | (begun & (after | driven)))


def inputs_before(times: Floats, inputs: Floats, used: Bools) -> Floats:
    """Return times and inputs before the first used row, none where all inputs to it are zero, (m, 1 + inputs)."""
    first = int(np.argmax(used))
    rows = np.column_stack([times[:first], inputs[:first]])
    return rows if inputs[: first + 1].any() else rows[:0]


def _back(times: Floats, group: Group) -> Codes:
    """Return the indices, within a group, of the rows whose time is before that of the row above."""
    group_times = times[group.rows]
    return np.flatnonzero(group_times[1:] < group_times[:-1]) + 1


def _refuse_restarts(table: Table, times: Floats, groups: Sequence[Group]) -> None:
    """Refuse a table whose times go back, but not as in reverse or random order or by single rows.

    Of n rows in random order, (n - 1) / 2 have a time before the one above, with a variance of (n + 1) / 12 (Eulerian
    numbers): within 1.5 standard deviations they are. All groups count together, as a table is shuffled as a whole.
    """
    wild = [(group, back) for group in groups if _is_out_of_order(times[group.rows], back := _back(times, group))]
    if not wild:
        return
    sizes = np.array([len(group.rows) for group, _ in wild])
    off = sum(len(back) for _, back in wild) - np.sum(sizes - 1) / 2
    if abs(off) <= 1.5 * np.sqrt(np.sum(sizes + 1) / 12):
        return
    group, back = wild[0]
    here, there = (int(group.rows[i]) for i in (back[0] - 1, back[0]))
    often = "" if len(back) == 1 else f", {len(back)} times in all"
    raise CommonlawError(
        "time-decreases",
        where=table.source,
        group=group.label,
        before=times[here],
        before_row=table.locate(here),
        after=times[there],
        after_row=table.locate(there),
        often=often,
        remedy=_remedy(table, times, groups),
    )


def _is_out_of_order(times: Floats, back: Codes) -> bool:
    """Say whether times go back, at these indices, not as in reverse nor by single rows, at most a tenth of them."""
    if not 0 < len(back) < len(times) - 1:
        return False
    if len(back) > max(2, 0.1 * len(times)):
        return True
    # Whether times can increase up to a row, if single rows before it, no two adjacent, are left out
    can = [True, True]
    for i in range(2, len(times)):
        can.append(bool((can[i - 1] and times[i] > times[i - 1]) or (can[i - 2] and times[i] > times[i - 2])))
    if not (can[-1] or can[-2]):
        return True
    i = len(times) - (1 if can[-1] else 2)
    kept = [i]
    while i > 1 or (i == 1 and times[1] > times[0]):
        i -= 1 if can[i - 1] and times[i] > times[i - 1] else 2
        kept.append(i)
    late = np.setdiff1d(np.arange(len(times)), kept)
    rest = np.delete(times, late)
    steps = np.diff(rest, prepend=-np.inf, append=np.inf)
    # Where a row is out of place, one is missing in another: times are there apart by more than one step
    return bool(np.any(steps[np.searchsorted(rest, times[late])] < 1.5 * np.median(np.diff(rest))))


def _remedy(table: Table, times: Floats, groups: Sequence[Group]) -> Diagnostic:
    """Return how to tell trials apart where times start again."""
    columns = [name for name in table.columns if not is_covariate(name)]
    telling = [name for name in columns if _tells_apart(table, name, times, groups)]
    telling = telling or [name for name in columns if _tells_apart(table, name, times, groups, repeated=True)]
    return Diagnostic("name-trials-by", {"columns": telling}) if telling else Diagnostic("name-trials")


def _tells_apart(table: Table, name: str, times: Floats, groups: Sequence[Group], *, repeated: bool = False) -> bool:
    """Say whether times increase among rows of a group that have the same cell in a column, at least two each."""
    rows = np.concatenate([group.rows for group in groups])
    owners = np.repeat(np.arange(len(groups)), [len(group.rows) for group in groups])
    try:
        codes = table.codes(name)[rows]
    except CommonlawError:
        return False
    order = np.lexsort((codes, owners))  # stable: of the same cell, rows keep their order
    same = (np.diff(codes[order]) == 0) & (np.diff(owners[order]) == 0)
    steps = np.diff(times[rows][order])[same]
    increase = (steps >= 0).all() and (steps > 0).any() if repeated else (steps > 0).all()
    return bool(np.mean(same) > 0.5 and (codes >= 0).all() and increase)


def _refuse_twice(
    table: Table, cells: Cells, rows: Codes, group: Group, groups: Sequence[Group], *, may_be_apart: bool
) -> None:
    """Refuse a group in which a time is there twice, but for repeated measurements; its `rows` are sorted by time."""
    times = cells[0][rows]
    measured = np.asarray(np.isfinite(cells[1][rows]).any(axis=1))
    twice = np.flatnonzero((times[1:] == times[:-1]) & measured[1:])
    if not len(twice):
        return
    here, there = (table.locate(int(row)) for row in rows[twice[0] : twice[0] + 2])
    what = f"{table.source}: {group.label}: the time {times[twice[0]]:g} is there twice, in {here} and in {there}"
    places = np.searchsorted(group.rows, rows)
    together = may_be_apart or bool(np.all(places[twice + 1] - places[twice] == 1))
    if together and all(np.array_equal(cell[rows[twice]], cell[rows[twice + 1]], equal_nan=True) for cell in cells[1:]):
        raise CommonlawError("copies", repeats=what)
    if not together or any(_tells_apart(table, name, cells[0], groups) for name in table.columns):
        raise CommonlawError("time-repeated", repeats=what, remedy=_remedy(table, cells[0], groups))


def repeats_in_words(trials: Sequence[Trial]) -> list[str]:
    """Return a note on trials with several measurements at one time, if there are any."""
    averaged = [trial for trial in trials if trial.repeats is not None]
    if not averaged:
        return []
    repeated = [trial.counts[trial.counts > 1] for trial in averaged]
    rows, times = int(sum(map(np.sum, repeated))), sum(map(len, repeated))
    where = f"at {counted(times, 'time')} in {counted(len(averaged), 'trial')}"
    return [f"{rows} measurements {where} are averaged, weighted by their number"]


def unanswered_notes(
    notes: Sequence[str], trials: Sequence[Trial], states: Sequence[str], starts: Mapping[str, Container[str] | None]
) -> tuple[str, ...]:
    """Return notes without those on states never measured that have a start in all trials without any value.

    By state a start has the objects or labels of the trials that it is of, None for all.
    """
    answered = list[str]()
    for name, owners in starts.items():
        if name in states:
            latent = [trial for trial in trials if _never_measured(trial)[states.index(name)]]
            if owners is None or all(trial.label in owners or trial.object in owners for trial in latent):
                answered.append(name)
    return tuple(line for line in notes if not any(is_note(line, "state-never-measured", name) for name in answered))


def _never_measured(trial: Trial) -> Bools:
    """Return whether each state has neither a value nor a limit in a trial, shape (states,)."""
    return np.asarray((np.isnan(trial.states) & np.isnan(trial.below)).all(axis=0))


def unmeasured_in_words(trials: Sequence[Trial], states: Sequence[str]) -> list[str]:
    """Return notes on states that are never measured in some trials, in which they begin somewhere unknown."""
    empty = np.array([_never_measured(trial) for trial in trials]).reshape(len(trials), len(states))
    names, owners = Counter(trial.name for trial in trials), Counter(trial.object for trial in trials)

    def called(trial: Trial) -> str:
        """Return, in quotes, the shortest of the names by which an initial value is that of a trial alone."""
        if names[trial.name] == 1:
            return f'"{trial.name}"'
        return f'"{trial.object if owners[trial.object] == 1 else trial.label}"'

    places = [[trial for trial, is_empty in zip(trials, column, strict=True) if is_empty] for column in empty.T]
    return [
        str(
            note(
                "state-never-measured",
                state,
                trials="; ".join(trial.label for trial in where),
                start=f"{state}(0) = 0 @ {', '.join(map(called, where))}",
            )
        )
        for state, where in zip(states, places, strict=True)
        if 0 < len(where) < len(trials)
    ]


@dataclass(frozen=True)
class Rows:
    """What the rows of a table make: trials and what goes with them, and the labels of trials without any row left."""

    data: TrialData
    empty: tuple[str, ...]
    row_indices: tuple[Codes, ...]
    """Of each trial the indices of the rows of its samples in the table as it came in, shape (n,)."""
    columns: ColumnRoles
    """What columns were taken for."""


def rows_of(table: Table, roles: Reading) -> Rows:
    """Return what the rows of a whole table make, see `Trials.read`."""
    table, reading, samples, columns = _recognized(table, roles)
    if columns.wide:
        rows = _long_rows(table, reading, columns)
    elif len(samples) < len(table):
        rows = read_rows(table, reading)
    else:
        rows = _rows(samples, reading, columns, columns)
    if rows.empty:
        raise CommonlawError("nothing-measured", trial=rows.empty[0])
    check_measured(rows.data.trials, rows.data.schema.states)
    _refuse_tiny(table.source, rows.data)
    return rows


def column_roles_of(table: Table, roles: Reading) -> ColumnRoles:
    """Return which column is what, also where the rows make no trials."""
    return _recognized(table, roles)[3]


def _recognized(table: Table, roles: Reading) -> tuple[Table, Reading, Table, ColumnRoles]:
    """Return a table with its numbers read, what is said of it, its rows from the first time on, and its columns.

    If its columns were times, it has a row for each cell.
    """
    asked = checked(roles)
    if (
        asked.get("restarts") == "trials"
        and table.roles.get("object") == BLOCK
        and not asked.keys() & {"object", "trial"}
    ):
        asked |= {"object": "", "trial": BLOCK}
    reading = cast(Reading, {**table.roles, **asked})
    table = with_numbers(table, notation_of(reading))
    if table.facts:
        table = replace(table, facts=(), notes=(f"{table.source}: {'; '.join(table.facts)}", *table.notes))
    if (long := table_in_columns(table, reading)) is not None:
        table, reading = long, cast(Reading, {**long.roles, **reading, "wide": None})
    time = time_of(table, reading)
    first = first_time(table, time)
    samples = _with_times(table.taken(np.arange(first, len(table))) if first else table, reading, time)
    if first:
        return table, reading, samples, column_roles(*with_records(samples, reading, time), time)
    samples, reading = with_records(samples, reading, time)
    return samples, reading, samples, column_roles(samples, reading, time)


def _with_times(table: Table, roles: Reading, time: str) -> Table:
    return with_dates_as_times(table, time, roles.get("dates"), free_columns(table, roles))


def _long_rows(table: Table, reading: Reading, columns: ColumnRoles) -> Rows:
    """Return the trials in a table that has a column for each object; rows ahead of the first time are conditions."""
    time, names, wide = columns.time, columns.states, columns.wide
    if columns.object is not None:
        raise CommonlawError("wide-with-object", where=table.source, column=columns.object)
    if not isinstance(wide, bool | str):
        raise CommonlawError("wide-not-a-name", value=wide)
    state, unit = split_header(quantity(names, wide))
    units = {table.units.get(name, "") for name in names}
    if not unit and len(units) > 1:
        raise CommonlawError("wide-units", where=table.source, units=sorted(units))
    unit = unit or next(iter(units), "")
    repeated = [name for name in table.columns if name not in (*names, *columns.noise_columns.values())]
    if state in (*repeated, "object"):
        raise CommonlawError("wide-name-taken", where=table.source, name=state)
    first = first_time(table, time)
    measured = table.taken(np.arange(first, len(table)))
    more = {"object": np.repeat(np.array(names, dtype=object), len(measured))}
    more[state] = np.concatenate([quantified(measured, name) for name in names])
    noise = {state: f"{state} noise"} if columns.noise_columns else {}
    if noise:
        if without := [name for name in names if name not in columns.noise_columns]:
            raise CommonlawError("wide-without-deviations", where=table.source, columns=shown_columns(without))
        deviations = [measured.numbers(columns.noise_columns[name], missing=True) for name in names]
        more[noise[state]] = np.concatenate(deviations)
    texts = table.texts(names) if first else []
    conditions = {
        label.strip(): np.repeat(column_of([cells[row] for cells in texts])[0], len(measured))
        for row, label in enumerate(table.columns[time][:first])
        if isinstance(label, str)
    }
    if twice := conditions.keys() & {*repeated, *more}:
        raise CommonlawError("wide-name-twice", where=table.source, name=min(twice))
    long = stacked(measured, names, repeated, more | conditions)
    units_of = {**long.units, state: unit} if unit else long.units
    long = replace(long, units=units_of, loose=long.loose | conditions.keys())
    roles: Reading = {
        **reading, "object": "object", "time": time, "states": [state], "inputs": columns.inputs, "noise_columns": noise
    }  # fmt: skip
    long = _with_times(long, roles, time)
    rows = _rows(long, roles, column_roles(long, roles, time), columns)
    return replace(rows, data=rows.data._replace(schema=replace(rows.data.schema, wide=names)))


def read_rows(table: Table, roles: Reading) -> Rows:
    """Return the trials in a table, which may end within a trial."""
    time = time_of(table, roles)
    table, roles = with_records(_with_times(table, roles, time), roles, time)
    columns = column_roles(table, roles, time)
    return _rows(table, roles, columns, columns)


def _rows(table: Table, roles: Reading, columns: ColumnRoles, shown: ColumnRoles) -> Rows:
    """Return the trials in a table whose columns have these roles, of a long one those `shown` of a wide one."""
    import pandas as pd

    table = table.joined(columns.object).joined(columns.trial)
    if columns.object is not None and "object_name" in roles:
        raise CommonlawError("object-column-and-name", where=table.source, column=columns.object)
    owners, objects, spelled = _labels(table, columns.object, "object", roles.get("object_name") or table.label)
    runs, labels, spelled_runs = _labels(table, columns.trial, "trial", "1")
    if columns.trial is None:
        runs = runs_of_labels(owners, readable(table, columns.time))
        labels = [str(number + 1) for number in range(runs.max(initial=0) + 1)]
        spelled_runs = (f"a trial begins wherever the name in {columns.object} changes",) if len(labels) > 1 else ()
    if columns.properties is None:
        known = given_properties(roles["properties"], columns.object or "object", objects)
    else:
        known = column_properties(table, columns.properties, owners, objects)
    names = [columns.time, *columns.states, *columns.inputs, *columns.noise_columns.values()]
    ends = {name: unit for name, unit in units_in_names([*table.columns]).items() if name not in table.units}
    headers = {**unit_in_name(columns.time), **table.units, **ends, **known.units}
    more = [*known.names, *table.administered]
    units = joined_units(headers, roles.get("units"), [*table.columns, *more], [*names, *more])
    read = [f"{name} [{unit}]" for name, unit in ends.items() if units.get(name) == unit]
    for state, name in columns.noise_columns.items():
        if state in units and name in units and known_unit(units[state]) != known_unit(units[name]):
            unit, state_unit = units[name], units[state]
            raise CommonlawError(
                "noise-column-unit", where=table.source, column=name, unit=unit, state=state, state_unit=state_unit
            )
    labels_in = columns.object or ("name" if columns.trial == "object" else "object"), columns.trial or "trial"
    schema = Schema(columns.states, columns.inputs, *labels_in, columns.time, units, columns.noise_columns)
    schema = replace(schema, calendar=table.calendar, administered=table.administered)
    located = replace(
        table, locate=lambda row: f"{table.locate(row)}, {objects[owners[row]]}, trial {labels[runs[row]]}"
    )
    by_label = pd.Series(np.arange(len(table))).groupby([owners, runs], sort=False)
    parts = [rows.to_numpy() for _, rows in by_label]
    groups = [Group(objects[owners[rows[0]]], labels[runs[rows[0]]], rows) for rows in parts]
    cells = read_cells(located, schema)
    trials, row_indices, empty, notes = trials_of(
        table, cells, groups, roles.get("restarts"), named=columns.trial is not None
    )
    shown = replace(shown, properties=columns.properties, notes=tuple(dict.fromkeys((*shown.notes, *columns.notes))))
    notes += [f"units read from names: {', '.join(read)}"] if read else []
    notes += unmeasured_in_words(trials, schema.states)
    remarks = (*table.notes, *spelled, *spelled_runs, *shown.lines, *known.notes, *notes)
    nameless = columns.object is None and "object_name" not in roles
    guessed = tuple(name for name in known.names if "properties" not in roles and name not in units)
    guessed += tuple(name for name in columns.inputs if columns.reasons.get(name) == CONSTANT_IN_TRIALS)
    used = {*names, *more, *labels_in, *(columns.object or "").split(", ")}
    rest = [name for name in table.columns if name not in used]
    text_columns = tuple(name for name in rest if not table.is_numeric(name))
    unread = tuple(name for name in rest if table.is_numeric(name))
    data = in_radians(TrialData(tuple(trials), schema, known.values, remarks, nameless, guessed, text_columns, unread))
    return Rows(data, tuple(empty), tuple(row_indices), shown)


def _labels(table: Table, column: str | None, what: str, default: str) -> tuple[Codes, list[str], tuple[str, ...]]:
    if column is None:
        return np.zeros(len(table), dtype=np.int64), [label(default)], ()
    return object_codes(table, column, what)


def trials_from_arrays(
    times: Sequence[Any] | NDArray[Any] | float,
    states: ArrayLike,
    object: object,
    trial: object,
    inputs: ArrayLike | None,
    noise: ArrayLike | None,
    names: Sequence[str] | None,
    units: Mapping[str, str] | None,
    properties: str | os.PathLike[str] | PropertyTable | Any,
) -> TrialData:
    """Return the trials in arrays, see `Trials.from_arrays`."""
    (times, clock_unit), (states, state_unit) = with_unit(times), with_unit(states)
    (inputs, input_unit), (noise, noise_unit) = with_unit(inputs), with_unit(noise)
    if noise_unit and noise_unit != state_unit:
        raise CommonlawError("noise-in-other-unit", unit=noise_unit, state_unit=state_unit or "no unit")
    runs, single = _times_by_trial(times, states)
    runs, clock = _elapsed(runs)
    count = len(runs)
    objects = [label(name) for name in _per_trial("objects", object, count)]
    counters = {name: itertools.count(1) for name in objects}
    counted = [str(next(counters[name])) for name in objects]
    labels = counted if trial is None else _per_trial("trial labels", trial, count)
    all_states = _per_trial("arrays of states", [states] if single else states, count)
    all_inputs = _per_trial("arrays of inputs", [inputs] if single else inputs, count)
    all_noise = _per_trial("arrays of standard deviations", [noise] if single else noise, count)
    parts = list(zip(objects, labels, runs, all_states, all_inputs, all_noise, strict=True))
    if not parts:
        raise CommonlawError("no-times")
    made, empty = zip(*(_trial(*part) for part in parts), strict=True)
    for trial_made in made:
        _refuse_extreme(trial_made)
    columns = _columns(made[0], names)
    check_measured(made, columns[0])
    known = given_properties(properties, "object", list(dict.fromkeys(objects)))
    used = ["t", *columns[0], *columns[1], *known.names]
    noisy = {} if noise is None else {name: f"{name} noise" for name in columns[0]}
    own_units = {"t": clock.unit if clock else clock_unit}
    own_units |= dict.fromkeys(columns[0], state_unit) | dict.fromkeys(columns[1], input_unit)
    headers = known.units | {name: unit for name, unit in own_units.items() if unit}
    units, calendar = joined_units(headers, units, used, used), clock is not None and clock.calendar
    schema = Schema(*columns, units=units, noise_columns=noisy, calendar=calendar)
    gaps = [
        f"{made_trial.label}: {shown([f'sample {here[0] + 1}', *(str(i + 1) for i in here[1:])])}"
        for made_trial, here in zip(made, empty, strict=True)
        if len(here)
    ]
    notes = [f"t: dates taken as time in {clock.since}"] if clock else []
    notes += [f"samples without a measured state left out: {'; '.join(gaps)}"] if gaps else []
    remarks = (*known.notes, *notes, *repeats_in_words(made), *unmeasured_in_words(made, columns[0]))
    data = TrialData(made, schema, known.values, remarks, set(objects) == {"object"})
    _refuse_tiny("arrays", data)
    return in_radians(data)


def _times_by_trial(times: Any, states: Any) -> tuple[list[Any], bool]:
    """Return the times of each trial, which may be the same for all or a time step, and whether there is only one."""
    is_step = not hasattr(times, "__iter__")
    if not is_step and np.ndim(next(iter(times), [])):
        return list(times), False
    single = not _are_several(states, times)
    if not is_step:
        return [times] * (1 if single else len(states)), single
    if not isinstance(times, float | int | np.number) or not 0 < times < np.inf:
        raise CommonlawError("time-step", step=times)
    return [
        float(times) * np.arange((np.shape(values) or (1,))[0]) for values in ([states] if single else states)
    ], single


def _are_several(states: Any, times: Any) -> bool:
    """Say whether states at the same times, or in the same time steps, are those of several trials."""
    if not isinstance(states, list | tuple):
        return np.ndim(states) == 3
    sizes = {np.ndim(state) for state in states}
    if sizes != {1}:
        return sizes == {2}
    if hasattr(times, "__iter__"):
        return len(states) != len(times) and all(len(state) == len(times) for state in states)
    return not any(isinstance(state, list | tuple) for state in states)  # These are rows


def _elapsed(runs: list[Any]) -> tuple[list[Any], Elapsed | None]:
    """Return times that are dates or durations as numbers, from the earliest of all trials on, and what they are in."""
    import pandas as pd

    kinds = {np.asarray(run).dtype.kind for run in runs}
    if kinds <= set("iufb") or not kinds <= set("mMO"):
        return runs, None
    whole = pd.Series([time for run in runs for time in run]).infer_objects()
    if whole.dtype.kind == "m":
        result = Elapsed(np.asarray(whole.dt.total_seconds(), dtype=np.float64), "s", "seconds", calendar=False)
    elif whole.dtype.kind == "M":
        result = elapsed(whole)
    else:
        return runs, None
    return np.split(result.values, np.cumsum([len(run) for run in runs])[:-1]), result


def _trial(name: str, run: Any, times: Any, states: Any, inputs: Any, noise: Any) -> tuple[Trial, Codes]:
    """Return a trial without the samples that say nothing, see `are_used`, and their indices."""
    inputs, noise = (np.empty((0, 0)) if array is None else array for array in (inputs, noise))
    earlier, unused = np.empty((0, 0)), np.empty(0, dtype=np.int64)
    with suppress(CommonlawError):  # What is no array `Trial` refuses
        values = states if type(states) is np.ndarray and states.dtype == np.float64 else as_numbers(states)
        if values.size and values.ndim in (1, 2) and np.shape(times) == (len(values),):
            used = are_used(values.reshape(len(values), -1), driven=np.size(inputs) > 0)
            unused = np.flatnonzero(~used & used.any())
    if len(unused):
        if np.size(inputs):
            earlier = inputs_before(as_numbers(times), as_numbers(inputs).reshape(len(times), -1), used)
        times, states = np.delete(times, unused), np.delete(as_numbers(states), unused, axis=0)
        inputs, noise = (np.delete(array, unused, axis=0) if np.size(array) else array for array in (inputs, noise))
    return Trial(name, run, times, states, inputs, noise, earlier=earlier), unused


def _refuse_extreme(trial: Trial) -> None:
    """Refuse values whose powers overflow."""
    for what, values in (("state", trial.states), ("input", trial.inputs), ("standard deviation", trial.noise)):
        extreme = np.argwhere(np.abs(values) > EXTREME)
        if len(extreme):
            sample, column = extreme[0]
            place, value = f"sample {sample + 1}, {what} {column + 1}", values[sample, column]
            raise CommonlawError("sample-extreme", where=trial.label, value=value, place=place, limit=EXTREME)


def _refuse_tiny(source: str, data: TrialData) -> None:
    """Refuse columns whose largest value is so small that its powers underflow."""
    schema, largest = data.schema, dict[str, float]()
    columns = {"states": schema.states, "inputs": schema.inputs}
    if schema.noise_columns:
        columns["noise"] = tuple(schema.noise_columns.get(name, name) for name in schema.states)
    for field, names in columns.items():
        sizes = [np.nanmax(np.abs(getattr(trial, field)), axis=0, initial=0.0) for trial in data.trials]
        largest |= dict(zip(names, np.max(sizes, axis=0).tolist(), strict=True))
    for attributes in data.properties.values():
        for name, value in attributes.items():
            largest |= {name: max(abs(value), largest.get(name, 0.0))} if isinstance(value, float) else {}
    for name, value in largest.items():
        if 0 < value < 1 / EXTREME:
            raise CommonlawError("column-tiny", where=f"{source}: column {name!r}", value=value, limit=1 / EXTREME)


def _per_trial(what: str, values: Any, count: int) -> list[Any]:
    """Return one value for each trial; a single name, or nothing, is for all of them."""
    if values is None or isinstance(values, str) or not hasattr(values, "__len__"):
        return [values] * count
    if len(values) != count:
        raise CommonlawError("one-per-trial", given=len(values), parts=what, trials=count)
    return list(values)


def _columns(trial: Trial, names: Sequence[str] | None) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the states and of the inputs."""
    states, inputs = trial.states.shape[1], trial.inputs.shape[1]
    if names is None:
        names = [
            name if count == 1 else f"{name}{i}"
            for name, count in (("x", states), ("u", inputs))
            for i in range(1, count + 1)
        ]
    listed = isinstance(names, list | tuple | np.ndarray) and all(isinstance(name, str) for name in names)
    if not listed or len(names) != states + inputs:
        driven = f" and {inputs} of inputs" if inputs else ""
        raise CommonlawError("names-count", names=names, states=states, inputs=driven)
    return tuple(names[:states]), tuple(names[states:])
