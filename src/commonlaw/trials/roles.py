"""Which column is what: as the user says, or by the names of columns, their units and what stands in them."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.runtime.files import is_file, is_folder
from commonlaw.trials.columns import Codes, Table
from commonlaw.trials.headers import find_name, split_header
from commonlaw.trials.properties import constant_columns, object_codes
from commonlaw.trials.reading import Reading, Roles
from commonlaw.trials.recognition import (
    absent_states,
    common_inputs,
    deviation_columns,
    increase_within,
    input_columns,
    is_covariate,
    is_quantity,
    joint_objects,
    note_on_pulses,
    object_column,
    other_clocks,
    pulsed_inputs,
    readable,
    runs_of_labels,
    time_column,
    trial_column,
)
from commonlaw.trials.wide import columns_of_one_quantity, shown_columns, wide_hint

_LABELS: tuple[Literal["object", "trial", "time"], ...] = ("object", "trial", "time")
GUESSED = "columns recognized as "
"""What the line on guessed roles begins with."""
ROLES = {
    "time": "time",
    "object": "object",
    "trial": "trial",
    "states": "state",
    "inputs": "input",
    "properties": "property",
    "noise_columns": "standard deviations",
}
"""What columns are, by the keyword that names them."""


def free_columns(table: Table, roles: Reading) -> list[str]:
    """Return the columns that the user gives no role."""
    named: list[Any] = [roles.get(role) for role in ("object", "trial", "time", "states", "inputs", "properties")]
    listed = [value if isinstance(value, list | tuple) else [value] for value in named]
    texts = [value for values in listed for value in values if isinstance(value, str) and value]
    taken = {table.find(text) for text in texts if split_header(text)[0] in table.columns or text in table.columns}
    return [name for name in table.columns if name not in taken]


@dataclass(frozen=True)
class ColumnRoles:
    """Which column of a table is what.

    Parameters
    ----------
    properties
        Columns of properties; None if these stand elsewhere.
    noise_columns
        Columns of standard deviations, by state.
    wide
        What was measured, if each column of a state is an object of its own.
    reasons
        What speaks for roles that were guessed, by column.
    guessed
        Whether a role follows neither from the settings nor from the names ``object``, ``trial``, ``t`` and ``time``.
    """

    time: str
    object: str | None
    trial: str | None
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    properties: tuple[str, ...] | None
    noise_columns: Mapping[str, str]
    wide: bool | str | None
    reasons: Mapping[str, str]
    guessed: bool
    notes: tuple[str, ...]

    @property
    def _by_role(self) -> dict[str, str]:
        """The columns by keyword, and why they have this role."""
        result = dict[str, str]()
        for role in ROLES:
            given = getattr(self, role) or ()
            names = [given] if isinstance(given, str) else [*(given.values() if isinstance(given, Mapping) else given)]
            why = {name: f" ({reason})" for name in names if (reason := self.reasons.get(name))}
            if names:
                result[role] = ", ".join(f"{name}{why.get(name, '')}" for name in names)
        return result | ({"states": f"{shown_columns(self.states)}, each of an object"} if self.wide else {})

    @property
    def sentence(self) -> str:
        """Which column was taken for what, and why."""
        return "; ".join(f"{ROLES[role]}: {names}" for role, names in self._by_role.items())

    @property
    def lines(self) -> tuple[str, ...]:
        """The notes, and if something was guessed, what it was and how to change it."""
        if not self.guessed:
            return self.notes
        options = [f"`{role}=...`" for role in ROLES if role in self._by_role or role == "inputs"]
        remedy = f"To correct them, use {', '.join(options)}{', `wide=...`' if self.wide else ''}"
        return (f"{GUESSED}{self.sentence}. {remedy}", *self.notes)


def time_of(table: Table, roles: Roles) -> str:
    """Return the column of times, named by the user or found."""
    time = _label_column(table, roles, "time") or time_column(table)
    if time is None:
        raise CommonlawError("time-missing", where=table.source, columns=table.columns)
    return time


def named_roles(table: Table, roles: Reading) -> dict[str, Any]:
    """Return the columns by role as far as they are named, to be shown where the others are not clear."""
    labels = {role: _label_column(table, roles, role) for role in _LABELS}
    return labels | {role: _found(table, roles.get(role, ())) for role in ("states", "inputs", "properties")}


def column_roles(table: Table, roles: Reading, time: str) -> ColumnRoles:
    """Return which column is what, of samples with times as numbers: as named, else by names, units and values."""
    table = table.joined(roles.get("object")).joined(roles.get("trial"))
    name, count = Counter(named := _named_columns(table, {**roles, "time": time})).most_common(1)[0]
    if count > 1:
        raise CommonlawError("role-twice", where=table.source, column=name)
    times, reasons = readable(table, time), dict[str, str]()
    indices = [name for name in table.columns if name not in named and table.is_index(name)]
    free = [name for name in table.columns if name not in (*named, *indices)]
    owner, owners, trial, runs = _labels(table, roles, times, free)
    reasons |= {name: "" for name in (owner, trial) if name is not None and name not in named}

    def take(columns: Iterable[str], reason: str = "") -> tuple[str, ...]:
        """Return columns that are free, which then they are no longer."""
        able = {*free}
        taken = tuple(name for name in columns if name in able)
        able -= {*taken}
        free[:] = [name for name in free if name in able]
        reasons.update(dict.fromkeys(taken, reason))
        return taken

    labels = (owner, trial, *(trial or "").split(", "))
    free = [name for name in free if name not in labels]
    states, inputs = (_found(table, roles.get(role, ())) for role in ("states", "inputs"))
    noise = _noise_columns(table, roles, states, free)
    take(noise.values())
    given = roles.get("properties")
    properties: tuple[str, ...] | None = None
    if given is None:
        held = constant_columns(table, free, owners, others_are_states=not states)
        properties = take(held, "" if owner else "constant")
    elif _names_columns(table, given):
        properties = _found(table, given)
    if properties is not None:
        also = (name for name in table.columns if name == owner and is_quantity(table, name))
        properties = tuple(dict.fromkeys((*properties, *also)))
    left_out = take(name for name in table.columns if is_covariate(name) and table.is_numeric(name))
    wide, numbers = roles.get("wide"), [name for name in free if table.is_numeric(name)]
    is_given, on_columns = bool(wide) and "wide" in roles, tuple[str, ...]()
    if not (states or is_given):
        left_out += take(other_clocks(table, numbers, times, owners * len(table) + runs))
    if not (states or wide or owner or trial or "object_name" in roles or roles.get("object") == ""):
        able = {*free}
        alike, on_columns = columns_of_one_quantity(table, [name for name in numbers if name in able], times)
        wide, states = bool(alike) or None, take(alike)
    begun = np.cumsum(np.diff(times, prepend=times[:1]) < 0) if roles.get("restarts") == "trials" else runs
    order = np.lexsort((times, begun, runs, owners))
    changes = np.any([np.diff(codes[order]) != 0 for codes in (owners, runs, np.asarray(begun))], axis=0)
    trials = np.split(order, np.flatnonzero(changes) + 1)
    if "states" not in roles and "inputs" not in roles:
        driving = input_columns(table, numbers, times, trials)
        driving = common_inputs(table, driving, numbers) if is_given else driving
        taken = take(driving)
        inputs, reasons = (*inputs, *taken), reasons | {name: driving[name] for name in taken}
        switches = [name for name in free if table.is_switch(name)]
        changing = [name for name in switches if any(np.ptp(readable(table, name)[rows]) > 0 for rows in trials)]
        inputs += take(changing, "its words are 1 and 0")
    notes = [f"columns left out, as they number the rows: {', '.join(indices)}"] if indices else []
    notes += [f"{name}: empty cells are amounts of zero" for name in inputs if np.isnan(readable(table, name)).any()]
    notes += map(note_on_pulses, pulsed_inputs(table, inputs, trials))
    if not states:
        states = tuple(name for name in free if table.is_numeric(name))
        reasons |= dict.fromkeys(states[1:], "")  # which may be inputs
        free = [name for name in free if not table.is_numeric(name)]
        notes += wide_hint(table, states) if not (wide or owner or on_columns) else ()
    notes += on_columns
    if trial is not None and trial not in named and owner is None and (absent := absent_states(table, states, runs)):
        # An object without a species has no coefficients of its equation
        remedy = "" if any(absent.values()) else f"; if it names objects, read it with `object={trial!r}`"
        notes.append(f"{trial} labels trials of one object, as some have no {', '.join(absent)}{remedy}")
    idle = {*left_out, *free}
    if unused := [name for name in table.columns if name in idle]:
        notes.append(f"columns left out: {', '.join(unused)}")
    if not states:
        if held := [name for name in properties or () if given is None and table.is_numeric(name)]:
            raise CommonlawError(
                "nothing-changes",
                where=table.source,
                columns=held,
                verb="is" if len(held) == 1 else "are",
                states=held[:1],
            )
        words = [f"{name!r} begins with {str(table.columns[name][0])!r}" for name in free if not table.is_numeric(name)]
        raise CommonlawError("no-state", where=table.source, columns=[", ".join(table.columns), *words[:1]])
    guessed = bool(reasons) or ("time" not in roles and time.casefold() not in ("t", "time"))
    return ColumnRoles(time, owner, trial, states, inputs, properties, noise, wide, reasons, guessed, tuple(notes))


def _labels(
    table: Table, roles: Reading, times: Floats, free: Sequence[str]
) -> tuple[str | None, Codes, str | None, Codes]:
    """Return the columns of objects and of trials, None where there is none, each with the codes of the rows."""
    owner, trial = _label_column(table, roles, "object"), _label_column(table, roles, "trial")
    free = [name for name in free if name not in (trial or "").split(", ")]
    guess, one = not roles.get("wide"), np.zeros(len(table), dtype=np.int64)
    is_guessed = owner is None and guess and "object_name" not in roles and roles.get("object") != ""
    if is_guessed:
        owner = object_column(table, times, [name for name in free if name != trial])
    owners = one if owner is None else object_codes(table.joined(owner), owner)[0]
    if is_guessed and owner in free and trial is None and roles.get("trial") != "":
        others = [name for name in free if name != owner and table.is_numeric(name)]
        others = [*_found(table, roles["states"])] if roles.get("states") else others
        if absent_states(table, others, owners):  # Treatments of one system, not objects
            replicate = trial_column(table, times, [name for name in free if name != owner], owners, named=True)
            both = owner if replicate is None else f"{owner}, {replicate}"
            return None, one, both, object_codes(table.joined(both), both, "trial")[0]
    if trial is None and guess and roles.get("trial") != "":
        others = [name for name in free if name != owner]
        trial = trial_column(table, times, others, owners, named=owner is not None)
    runs = runs_of_labels(owners, times) if trial is None else object_codes(table, trial, "trial")[0]
    if is_guessed and not increase_within(owners * len(table) + runs, times):
        owner = ", ".join(joint_objects(table, times, [name for name in free if name != trial], runs)) or owner
        owners = owners if owner is None else object_codes(table.joined(owner), owner)[0]
    return owner, owners, trial, runs


def _label_column(table: Table, roles: Roles, role: Literal["object", "trial", "time"]) -> str | None:
    """Return the column that has a role because it is named so by the user, or called like the role."""
    named = roles.get(role)
    if named == "":
        return None
    # the schema of a table without such a column has the default for its name, and may be what names the columns here
    if named is not None and (named != role or named in table.columns):
        return table.find(named)
    if role == "time":
        return None
    return next((name for name in (role, *table.columns) if name.casefold() == role and name in table.columns), None)


def _named_columns(table: Table, roles: Reading) -> list[str]:
    """Return the columns whose roles are given, each as often as it has one; a property may name the objects."""
    given = roles.get("properties")
    named = [name for role in _LABELS if (name := _label_column(table, roles, role)) is not None]
    for names in (roles.get("states") or (), roles.get("inputs") or (), [*(roles.get("noise_columns") or {}).values()]):
        named += dict.fromkeys(_found(table, names))
    properties = _found(table, given) if given is not None and _names_columns(table, given) else ()
    return named + [name for name in properties if name != _label_column(table, roles, "object")]


def _found(table: Table, names: Any) -> tuple[str, ...]:
    if not isinstance(names, Iterable):
        raise CommonlawError("column-names", names=names)
    return tuple(table.find(name) for name in ([names] if isinstance(names, str) else names))


def _noise_columns(table: Table, roles: Roles, states: Sequence[str], free: Sequence[str]) -> dict[str, str]:
    numbers = [name for name in free if table.is_numeric(name)]
    given = roles.get("noise_columns")
    if given is None:
        pairs = deviation_columns(table, [*states, *numbers])
        return {state: name for state, name in pairs.items() if name in numbers and state in (states or numbers)}
    try:
        return {find_name(state, states or numbers, "state"): table.find(name) for state, name in given.items()}
    except CommonlawError as error:
        raise CommonlawError("noise-columns-unknown", table.source, error=error) from None


def _names_columns(table: Table, given: Any) -> bool:
    """Say whether properties are given as names of columns and not as a second table."""
    if isinstance(given, str):
        return given in table.columns or not (Path(given).suffix or is_file(given) or is_folder(given))
    return isinstance(given, Sequence)
