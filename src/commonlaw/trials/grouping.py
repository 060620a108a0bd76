"""Rows of a table grouped into trials, each in order of time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import Diagnostic
from commonlaw.errors import CommonlawError
from commonlaw.text import counted, shown
from commonlaw.trials.columns import Codes, Table
from commonlaw.trials.reading import Restarts
from commonlaw.trials.recognition import input_values
from commonlaw.trials.trial import Schema, Trial

Cells = tuple[Floats, Floats, Floats, Floats, Floats]
"""Of all rows: times, shape (n,), states, inputs, standard deviations of the states and limits that they are below of,
each of shape (n, columns)."""

_RANDOM = 1.5
"""Standard deviations from the number of times that rows in random order go back, beyond which they are in no such."""

_MAX_MISPLACED_SHARE = 0.1
"""Of the rows of a trial, those that may stand out of place without being asked about."""
_HOLE = 1.5
"""Median steps that times are apart between which a row is missing: more than one step, less than two."""


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


def groups_of(owners: Codes, objects: Sequence[str], runs: Codes, labels: Sequence[str]) -> list[Group]:
    """Return the rows of each object and label of a trial, in order of first appearance."""
    codes, first, which = np.unique(owners * len(labels) + runs, return_index=True, return_inverse=True)
    in_order = np.argsort(first)
    rank = np.argsort(in_order)[which]
    rows = np.split(np.argsort(rank, kind="stable"), np.cumsum(np.bincount(rank))[:-1])
    names = ((objects[code // len(labels)], labels[code % len(labels)]) for code in codes[in_order])
    return [Group(*name, row) for name, row in zip(names, rows, strict=True)]


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
            made.append(Trial(group.object, group.trial, times, states, inputs, noise, earlier=earlier, below=below))
            row_indices.append(rows[kept])
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
    """Return times and inputs before the first used row, from the first nonzero input on, shape (m, 1 + inputs)."""
    before = slice(0, int(np.argmax(used)))
    rows = np.column_stack([times[before], inputs[before]])
    begun = np.logical_or.accumulate(rows[:, 1:].any(axis=1))
    return rows[begun]


def _back(times: Floats, group: Group) -> Codes:
    """Return the indices, within a group, of the rows whose time is before that of the row above."""
    own = times[group.rows]
    return np.flatnonzero(own[1:] < own[:-1]) + 1


def _refuse_restarts(table: Table, times: Floats, groups: Sequence[Group]) -> None:
    """Refuse a table whose times go back, but not as in reverse or random order or by single rows.

    Of n rows in random order, (n - 1) / 2 have a time before the one above, with a variance of (n + 1) / 12 (Eulerian
    numbers). All groups count together, as a table is shuffled as a whole.
    """
    wild = [(group, back) for group in groups if _is_out_of_order(times[group.rows], back := _back(times, group))]
    if not wild:
        return
    sizes = np.array([len(group.rows) for group, _ in wild])
    off = sum(len(back) for _, back in wild) - np.sum(sizes - 1) / 2
    if abs(off) <= _RANDOM * np.sqrt(np.sum(sizes + 1) / 12):
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
    """Say whether times go back, at these indices, not as in reverse nor by a few single rows that are out of place."""
    if not 0 < len(back) < len(times) - 1:
        return False
    if len(back) > max(2, _MAX_MISPLACED_SHARE * len(times)):
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
    # Where a row is out of place, one is missing in another
    return bool(np.any(steps[np.searchsorted(rest, times[late])] < _HOLE * np.median(np.diff(rest))))


def _remedy(table: Table, times: Floats, groups: Sequence[Group]) -> Diagnostic:
    """Return how to tell trials apart where times start again."""
    telling = [name for name in table.columns if _tells_apart(table, name, times, groups)]
    telling = telling or [name for name in table.columns if _tells_apart(table, name, times, groups, repeated=True)]
    return Diagnostic("name-trials-by", {"columns": telling}) if telling else Diagnostic("name-trials")


def _tells_apart(table: Table, name: str, times: Floats, groups: Sequence[Group], *, repeated: bool = False) -> bool:
    """Say whether times increase among rows of a group that have the same cell in a column, at least two each."""
    rows = np.concatenate([group.rows for group in groups])
    owners = np.repeat(np.arange(len(groups)), [len(group.rows) for group in groups])
    try:
        codes = table.encoded(name)[0][rows]
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
    own = cells[0][rows]
    measured = np.asarray(np.isfinite(cells[1][rows]).any(axis=1))
    twice = np.flatnonzero((own[1:] == own[:-1]) & measured[1:])
    if not len(twice):
        return
    here, there = (table.locate(int(row)) for row in rows[twice[0] : twice[0] + 2])
    what = f"{table.source}: {group.label}: the time {own[twice[0]]:g} is there twice, in {here} and in {there}"
    places = np.searchsorted(group.rows, rows)
    together = may_be_apart or bool(np.all(places[twice + 1] - places[twice] == 1))
    if together and all(np.array_equal(cell[rows[twice]], cell[rows[twice + 1]], equal_nan=True) for cell in cells[1:]):
        raise CommonlawError("copies", repeats=what)
    if not together or any(_tells_apart(table, name, cells[0], groups) for name in table.columns):
        raise CommonlawError("time-repeated", repeats=what, remedy=_remedy(table, cells[0], groups))


def repeats_in_words(trials: Sequence[Trial]) -> list[str]:
    """Return a note on trials with several measurements at one time, if there are any."""
    found = [trial for trial in trials if trial.repeats is not None]
    if not found:
        return []
    repeated = [each.counts[each.counts > 1] for each in found]
    rows, times = int(sum(map(np.sum, repeated))), sum(map(len, repeated))
    where = f"at {times} times in {counted(len(found), 'trial')}"
    return [f"{rows} measurements {where} are averaged, weighted by their number"]
