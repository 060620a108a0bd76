"""NONMEM data sets: rows that are measurements, doses, infusions or resets, as their columns state.

Beal, Sheiner, Boeckmann and Bauer (eds.), NONMEM Users Guides, part VIII: data items of PREDPP.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.text import counted
from commonlaw.trials.columns import Codes, Column, Table
from commonlaw.trials.headers import label, split_header
from commonlaw.trials.reading import READ_AS, Reading
from commonlaw.trials.recognition import SEPARATE, is_amount, is_called, names_quantities, readable
from commonlaw.trials.trial import Dose

_OF_DOSES = frozenset({"rate", "ii", "addl", "ss", "dur", "tinf"})
_OF_RECORDS = frozenset({"evid", "mdv", "cmt", "dvid"})
_NUMBERS = ("amt", "rate", "ii", "addl", "ss", "dur", "tinf", "evid", "mdv", "cmt")
MAX_DOSES = 10_000
"""Doses of one trial, repetitions among them; one a day for a lifetime is 30 000."""


def items_of(table: Table, reading: Reading) -> dict[str, str]:
    """Return the columns of a NONMEM data set by item, in small letters; none if a table is no such data set.

    It has amounts or measurements, ``AMT`` or ``DV``, and another item; amounts may also be called doses next to EVID,
    MDV, CMT or DVID, or where their rows are exactly those without a measurement. A column that has another role by the
    user is no item.
    """
    given = [_listed(reading.get(role)) for role in ("time", "object", "trial", "properties", "noise_columns")]
    taken = {name for names in given for name in names}
    taken |= {name for name in _listed(reading.get("states")) if name.casefold() != "dv"}
    known = _OF_DOSES | _OF_RECORDS | {"amt", "dv"}
    items = dict[str, str]()
    for name in table.columns:
        if name.casefold() in known and name not in taken:
            items.setdefault(name.casefold(), name)
    amounts = [name for name in table.columns if is_amount(name) and name not in taken]
    if amounts and items.keys() & _OF_RECORDS:
        items.setdefault("amt", amounts[0])
    alternating = [name for name in amounts if name not in _listed(reading.get("inputs"))]
    is_alternating = len(alternating) == 1 and _alternates(table, alternating[0], taken)
    if is_alternating:
        items.setdefault("amt", alternating[0])
        if not items.keys() & {"dv", "dvid"}:
            items |= _named_quantities(table, alternating[0], taken)
    more = items.keys() & (_OF_RECORDS | _OF_DOSES if "amt" in items else _OF_RECORDS)
    is_data_set = is_alternating or {"amt", "dv"} <= items.keys() or (more and items.keys() & {"amt", "dv"})
    return items if is_data_set and not reading.get("wide") else {}


def _alternates(table: Table, amount: str, taken: Collection[str]) -> bool:
    """Say whether the rows of amounts are exactly those in which nothing is measured.

    Measurements are the numbers that no row of an amount has.
    """
    if not table.is_numeric(amount):
        return False
    is_dose = np.nan_to_num(readable(table, amount)) != 0
    is_sample = np.zeros(len(table), dtype=np.bool_)
    for name in table.columns:
        if name != amount and name not in taken and table.is_numeric(name):
            is_filled = np.isfinite(readable(table, name))
            if not is_filled[is_dose].any():
                is_sample |= is_filled
    return bool(is_dose.any() and is_sample.any() and (is_dose != is_sample).all())


def _named_quantities(table: Table, amount: str, taken: Collection[str]) -> dict[str, str]:
    """Return the columns that name quantities and have their values, as DVID and DV do; none if they are not clear."""
    is_dose = np.nan_to_num(readable(table, amount)) != 0
    names = [name for name in table.columns if name not in taken and names_quantities(name)]
    values = [name for name in table.numeric if name not in (*taken, *names, amount)]
    values = [name for name in values if not np.isfinite(readable(table, name)[is_dose]).any()]
    return {"dvid": names[0], "dv": values[0]} if len(names) == len(values) == 1 else {}


def _listed(names: Any) -> list[str]:
    """Return the names of columns that the user gives for a role, without their units."""
    values = [*names.values()] if isinstance(names, Mapping) else names if isinstance(names, list | tuple) else [names]
    return [split_header(name)[0] for name in values if isinstance(name, str) and name]


@dataclass(frozen=True, eq=False)
class _Records:
    """The rows of a NONMEM data set.

    Parameters
    ----------
    item
        Numbers by item, shape (n,), zero where a cell is empty or there is no such column.
    measured, is_dose, is_reset
        Which rows are measurements, are doses, or begin a trial with empty compartments or a steady state.
    groups
        Codes of individuals, and of the labels of their trials.
    """

    table: Table
    items: Mapping[str, str]
    times: Floats
    item: Mapping[str, Floats]
    measured: Bools
    is_dose: Bools
    is_reset: Bools
    groups: Codes

    @classmethod
    def of(cls, table: Table, items: Mapping[str, str], times: Floats, groups: Codes) -> "_Records":
        """Read the items of a table, with times of shape (n,)."""
        zeros = np.zeros(len(table))
        item = {
            name: np.nan_to_num(table.numbers(items[name], missing=True)) if name in items else zeros
            for name in _NUMBERS
        }
        given = (item["amt"] != 0) | ((item["ss"] != 0) & (item["rate"] != 0))
        if "evid" in items:
            known = np.isfinite(table.numbers(items["evid"], missing=True))
            event = np.where(known, item["evid"], given)
            is_sample = event == 0
        else:
            event = given.astype(np.float64)
            is_sample = ~given
            if "mdv" in items:
                is_sample = np.ones(len(table), dtype=np.bool_)
            elif "dv" in items:  # A zero in the row of an amount fills the cell
                is_sample |= np.nan_to_num(table.numbers(items["dv"], missing=True)) != 0
        is_dose = np.isin(event, (1, 4))
        result = cls(
            table,
            items,
            times,
            item,
            np.asarray(is_sample & (item["mdv"] == 0)),
            np.asarray(is_dose),
            np.isin(event, (3, 4)) | (is_dose & (item["ss"] == 1)),
            groups,
        )
        result._check(event)
        return result

    def _check(self, event: Floats) -> None:
        """Refuse what is not supported, with the first row of it."""
        item, dose = self.item, self.is_dose
        whole = {name: values != np.round(values) for name, values in item.items()}
        duration = np.maximum(item["dur"], item["tinf"])
        refused = {
            "nonmem-event": ("evid", ~np.isin(event, range(5))),
            "nonmem-amount-of-no-dose": ("amt", ~dose & (item["amt"] != 0)),
            "nonmem-amount-negative": ("amt", item["amt"] < 0),
            "nonmem-rate-of-model": ("rate", dose & (item["rate"] < 0)),
            "nonmem-duration": ("rate", dose & ((duration < 0) | ((duration > 0) & (item["rate"] > 0)))),
            "nonmem-infusion-endless": ("rate", dose & (item["rate"] > 0) & (item["amt"] == 0)),
            "nonmem-steady-state": ("ss", dose & ~np.isin(item["ss"], (0, 1))),
            "nonmem-repeats": ("addl", dose & ((item["addl"] < 0) | whole["addl"])),
            "nonmem-interval": ("ii", dose & ((item["addl"] > 0) | (item["ss"] == 1)) & ~(item["ii"] > 0)),
            "nonmem-compartment": ("cmt", (dose | self.measured) & ((item["cmt"] < 0) | whole["cmt"])),
        }
        for code, (name, wrong) in refused.items():
            if wrong.any():
                row = int(np.argmax(wrong))
                column = self.items.get(name, name.upper())
                where = f"{self.table.source}: column {column!r}, {self.table.locate(row)}"
                raise CommonlawError(code, where=where, value=event[row] if name == "evid" else item[name][row])

    @property
    def runs(self) -> Codes:
        """The number of each row's trial in its group, which resets begin, from 1 on."""
        runs = np.zeros(len(self.table), dtype=np.int64)
        for group in range(self.groups.max() + 1):
            rows = np.flatnonzero(self.groups == group)
            begun = self.is_reset[rows]
            begun[0] = True
            runs[rows] = np.cumsum(begun)
        return runs

    def doses(self, rows: Codes) -> tuple[Dose, ...]:
        """Return the doses in the rows of one trial, in the order of time, and a reset as a dose of nothing."""
        item, result = self.item, list[Dose]()
        for i in rows[(self.is_dose | self.is_reset)[rows]].tolist():
            amount, rate, interval, time = (float(v[i]) for v in (item["amt"], item["rate"], item["ii"], self.times))
            if not self.is_dose[i]:
                result.append(Dose(time, 0.0))
                continue
            duration = amount / rate if rate else float(max(item["dur"][i], item["tinf"][i]))
            after = rows[(rows > i) & (self.times[rows] == time)]
            dose = Dose(
                time,
                amount,
                duration,
                int(item["cmt"][i]),
                interval if item["ss"][i] else 0.0,
                is_before=not duration and bool(self.measured[after].any()),
            )
            if dose.is_before and self.measured[rows[(rows <= i) & (self.times[rows] == time)]].any():
                raise CommonlawError("nonmem-both-sides", where=self.table.source, time=time, row=self.table.locate(i))
            additional = int(item["addl"][i])
            if len(result) + additional >= MAX_DOSES:
                raise CommonlawError("nonmem-doses-too-many", where=self.table.source, limit=MAX_DOSES)
            result.append(dose)
            for k in range(1, additional + 1):
                result.append(replace(dose, time=time + k * interval, interval=0.0, is_before=False))
        return tuple(sorted(result, key=lambda dose: dose.time))

    def quantities(self) -> tuple[Codes, list[str]]:
        """Return what each row measures, as codes of names: one for each DVID, or else for each CMT of measurements."""
        name = self.items["dv"]
        for column in (self.items[item] for item in ("dvid", "cmt") if item in self.items):
            codes, cells = self.table.encoded(column)
            used = np.unique(codes[self.measured])
            if len(used) < 2:
                continue
            if (empty := self.measured & (codes < 0)).any():
                where = f"{self.table.source}: column {column!r}, {self.table.locate(int(np.argmax(empty)))}"
                raise CommonlawError("nonmem-quantity-missing", where=where, name=name)
            words = [label(cells[code]) for code in used]
            taken = {*self.table.columns}
            names = [word if word.isidentifier() and word not in taken else f"{name}{word}" for word in words]
            return np.searchsorted(used, codes), names
        return np.zeros(len(self.table), dtype=np.int64), [name]

    def in_words(self, unsampled: int) -> str:
        """Return the note on what was read."""
        infusions = self.is_dose & ((self.item["rate"] > 0) | (self.item["dur"] > 0) | (self.item["tinf"] > 0))
        parts = [counted(int(self.measured.sum()), "measurement"), counted(int(self.is_dose.sum()), "dose")]
        parts += [f"{int(infusions.sum())} of these infusions"] if infusions.any() else []
        parts += [f"{counted(int(self.is_reset.sum()), 'reset')}"] if self.is_reset.any() else []
        parts += [f"{counted(unsampled, 'trial')} without a measurement left out"] if unsampled else []
        return f"{READ_AS}a NONMEM data set by {', '.join(self.items.values())}: {', '.join(parts)}"


def with_records(table: Table, reading: Reading, time: str) -> tuple[Table, Reading]:
    """Return the measurements of a NONMEM data set as a table, which holds the doses, and which column is what in it.

    The columns of its items are left out. A reset (EVID 3 or 4) and a dose in steady state (SS 1) begin a trial.
    Several quantities (DVID, or else CMT of measurements) are a column each, ``DV1`` and ``DV2``. Other tables are
    returned as they are.

    Raises
    ------
    CommonlawError
        If an item has a value that is not supported; the message names the row.
    """
    items = items_of(table, reading)
    if not items:
        return table, reading
    owner, trial, groups = _individuals(table, reading)
    records = _Records.of(table, items, table.numbers(time), groups)
    runs = records.runs
    _, series = np.unique(groups * (runs.max() + 1) + runs, return_inverse=True)
    doses, is_sampled = np.empty(len(table), dtype=object), np.zeros(len(table), dtype=np.bool_)
    for rows in np.split(np.argsort(series, kind="stable"), np.cumsum(np.bincount(series))[:-1]):
        given = records.doses(rows)
        for row in rows.tolist():
            doses[row] = given  # The same tuple for the rows of a trial
        is_sampled[rows] = records.measured[rows].any()
    columns = {name: column for name, column in table.columns.items() if name not in items.values()}
    kept = np.flatnonzero(is_sampled & (records.measured | ~(records.is_dose | records.is_reset)))
    if not len(kept):
        raise CommonlawError("nothing-measured", trial=table.source)
    roles: Reading = {**reading, "trial": trial}
    if (runs > 1).any():
        before = [f"{label(cell)}-" for cell in table.texts([trial])[0].tolist()] if trial else [""] * len(table)
        roles["trial"] = trial = trial or "trial"
        columns[trial] = np.array(
            [f"{name}{run}" for name, run in zip(before, runs.tolist(), strict=True)], dtype=object
        )
    names = list[str]()
    if "dv" in items:
        quantities, kept = _quantities(records, series, kept)
        columns |= quantities
        names = roles["states"] = [*quantities]
    if owner:
        roles["object"] = owner
    if "inputs" in reading:
        roles["inputs"] = [name for name in _listed(reading["inputs"]) if name in columns]
    unit = table.units.get(items.get("dv", ""))
    result = replace(
        table,
        columns=columns,
        units={**table.units, **(dict.fromkeys(names, unit) if unit else {})},
        loose=(table.loose | {*names} if items.get("dv") in table.loose else table.loose) - {trial},
        plain=table.plain - {trial, *names},
        notes=(*table.notes, records.in_words(len({*series[~is_sampled].tolist()}))),
        doses=doses,
        administered=tuple(items[item] for item in ("amt", "rate") if item in items and "amt" in items),
    )
    return result.taken(kept), roles


def _individuals(table: Table, reading: Reading) -> tuple[str, str, Codes]:
    """Return the columns of individuals and of trials, empty where there is none, and codes of their rows."""
    owner, trial = reading.get("object"), reading.get("trial")
    folded = {name.casefold(): name for name in reversed([*table.columns])}
    if owner is None and "object_name" not in reading:
        owner = folded.get("id") or next((name for name in table.columns if is_called(name, SEPARATE)), None)
    if trial is None or trial not in table.columns:
        trial = folded.get("trial", "") if trial != "" else ""
    groups = np.zeros(len(table), dtype=np.int64)
    for name in (owner, trial):
        if name:
            codes = table.joined(name).codes(name)
            groups = np.unique(groups * (codes.max() + 2) + codes + 1, return_inverse=True)[1]
    return owner or "", trial, groups


def _quantities(records: _Records, series: Codes, kept: Codes) -> tuple[dict[str, Column], Codes]:
    """Return a column for each quantity, and of kept rows one for what is measured at the same time in a trial."""
    import pandas as pd

    codes, names = records.quantities()
    name = records.items["dv"]
    cells = records.table.columns[name]
    empty: Any = "" if name in records.table.loose else np.nan
    rows = kept[records.measured[kept]]
    frame = pd.DataFrame({"series": series[rows], "time": records.times[rows], "kind": codes[rows]})
    frame["repeat"] = frame.groupby(["series", "time", "kind"]).cumcount()
    same = frame.groupby(["series", "time", "repeat"], sort=False).ngroup().to_numpy()
    first = rows[np.unique(same, return_index=True)[1]][same]
    columns = dict[str, Column]()
    for kind, quantity in enumerate(names):
        column = np.full(len(cells), empty, dtype=cells.dtype if cells.dtype.kind in "fO" else np.float64)
        column[first[codes[rows] == kind]] = cells[rows[codes[rows] == kind]]
        columns[quantity] = column
    return columns, np.setdiff1d(kept, np.setdiff1d(rows, first))


def doses_of(table: Table, rows: Codes) -> tuple[Dose, ...]:
    """Return the doses of the trials that these rows are of, in the order of time."""
    if table.doses is None:
        return ()
    by_trial = {id(doses): doses for doses in table.doses[rows].tolist()}
    return tuple(sorted((dose for doses in by_trial.values() for dose in doses), key=lambda dose: dose.time))
