"""Which column is what: as the user says, as the columns are named, and as what stands in them shows."""

import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypedDict

import numpy as np

from commonlaw.errors import CommonlawError, check_choice, unknown
from commonlaw.trials.columns import Codes, Table
from commonlaw.trials.grouping import Restarts
from commonlaw.trials.headers import find_name
from commonlaw.trials.properties import constant_columns, object_codes
from commonlaw.trials.trial import PropertyTable
from commonlaw.trials.wide import check_wide

_CLOCKS = (
    *("sec", "second", "seconds", "minute", "minutes", "hour", "hours", "day", "days", "year", "years", "age"),
    *("date", "datetime", "timestamp"),
)
"""Columns of times where there is no t or time, and one of these."""


class Roles(TypedDict, total=False):
    """Which column is what; a column is named by its header with or without the unit in it.

    Parameters
    ----------
    object
        Column of the objects' names. Default: ``object`` if there is such a column, else the table is of one object.
    object_name
        Name of the one object of a table without such a column.
    trial
        Column of the trials' labels. Default: ``trial`` if there is such a column, else every object has one trial.
    time
        Column of the times. Default: ``t`` or ``time``, or the only column like ``year``, ``hours`` or ``date``. Dates
        in the form 2020-03-31, and dates of a frame, become days since the earliest, or seconds if hours are given too.
    states
        Columns of the measured states. Default: the columns of numbers that have no other role and are not constant
        for each object.
    inputs
        Columns of the measured inputs. Default: none.
    noise_columns
        Columns of standard deviations of the measurements, by state: ``{"x": "sx"}``. Default: none.
    properties
        Columns of the objects' properties; or a second table (a file, a frame) with a row for each object; or a
        mapping from object to property values by name. Default: the columns without another role that are constant
        for each of at least two objects.
    units
        Units by column; they take precedence over those in the headers.
    """

    object: str | None
    object_name: str | None
    trial: str | None
    time: str | None
    states: str | Sequence[str] | None
    inputs: str | Sequence[str]
    noise_columns: Mapping[str, str]
    properties: str | os.PathLike[str] | Sequence[str] | PropertyTable | Any
    units: Mapping[str, str] | None


class Reading(Roles, total=False):
    """Which column is what, and how the rows of a whole table are to be read.

    Parameters
    ----------
    wide
        What was measured, with its unit or without, such as ``"OD"``, in a table that has a column for each object, as
        plate readers write it; True is for ``"value"``. The columns are those of `states`, by default all columns of
        numbers without another role. Rows ahead of the first time, with a name in place of the time, are properties.
    restarts
        What it means where times go back within a trial: ``"trials"``, that a new trial begins there; ``"sort"``, that
        rows of one trial are out of order. Default: rows in reverse or random order, and a few single ones
        out of place, are sorted; all else is refused.
    """

    wide: bool | str | None
    restarts: Restarts | None


def checked(roles: Roles, kind: type = Roles) -> Any:
    """Return the keywords that say something, having refused those that there are not."""
    for name in roles:
        if name not in kind.__annotations__:
            raise unknown("keyword", name, [*kind.__annotations__, "sheet"])
    said = {name: value for name, value in roles.items() if value is not None}
    if not isinstance(said.get("noise_columns", {}), Mapping):
        raise CommonlawError(f"noise_columns are {said['noise_columns']!r}: name them by state, such as {{'x': 'sx'}}")
    for name in ("states", "inputs", "noise_columns"):
        if name in said and not said[name]:
            del said[name]
    if "restarts" in said:
        check_choice("restarts", said["restarts"], ("trials", "sort"))
    return said


@dataclass(frozen=True)
class Identity:
    """Columns that say of which object and trial a row is, None where there is none, and when it was measured."""

    object: str | None
    trial: str | None
    time: str

    @property
    def columns(self) -> list[str]:
        """Those that there are."""
        return [each for each in (self.object, self.trial, self.time) if each is not None]


def identity_columns(table: Table, roles: Roles) -> Identity:
    """Return the columns of objects, trials and times, named by the user or found by their names."""
    time = _time(table, roles)
    if time is None:
        raise CommonlawError(
            f"{table.source}: which column holds the time? Name it with time=...; columns: {', '.join(table.columns)}"
        )
    return Identity(_role(table, roles, "object", ("object",)), _role(table, roles, "trial", ("trial",)), time)


def recognised_roles(table: Table, roles: Reading) -> dict[str, Any]:
    """Return the columns by role as far as they are clear, also where others are not or the rows make no trials."""
    finders: dict[str, Callable[[], Any]] = {
        "object": lambda: _role(table, roles, "object", ("object",)),
        "trial": lambda: _role(table, roles, "trial", ("trial",)),
        "time": lambda: _time(table, roles),
        "states": lambda: _found(table, roles.get("states", ())),
        "inputs": lambda: _found(table, roles.get("inputs", ())),
        "properties": lambda: _found(table, roles.get("properties", ())),
    }
    found: dict[str, Any] = {}
    for role, find in finders.items():
        with suppress(CommonlawError):
            found[role] = find()
    if found.get("time") and not found["states"]:
        with suppress(CommonlawError):
            found |= _values_of(table, roles)
    return found


def _values_of(table: Table, roles: Reading) -> dict[str, Any]:
    """Return the columns of states, inputs and properties, by role."""
    identity = identity_columns(table, roles)
    owners = (
        np.zeros(len(table), dtype=np.int64) if identity.object is None else object_codes(table, identity.object)[0]
    )
    # As if it was wide, so that columns of wells are shown as what they would be
    columns = value_columns(table, {**roles, "wide": True}, identity, owners)
    return {"states": columns.states, "inputs": columns.inputs, "properties": columns.properties or ()}


def _time(table: Table, roles: Roles) -> str | None:
    clocks = [name for name in table.columns if name.casefold() in _CLOCKS]
    return _role(table, roles, "time", ("t", "time")) or (clocks[0] if len(clocks) == 1 else None)


def _role(table: Table, roles: Roles, role: Literal["object", "trial", "time"], defaults: Sequence[str]) -> str | None:
    """Return the column that has a role, named by the user or found by its name, capitals not counting."""
    named = roles.get(role)
    # the schema of a table without such a column has the default for its name, and may be what names the columns here
    if named is not None and (named != role or named in table.columns):
        return table.find(named)
    folded = {name.casefold(): name for name in reversed(list(table.columns))}
    exact = [name for name in defaults if name in table.columns]
    # of time and T, time is the time and T may be a temperature
    alike = [folded[name] for name in reversed(defaults) if name in folded]
    return next(iter((*exact, *alike)), None)


@dataclass(frozen=True)
class ValueColumns:
    """Columns of states, inputs and properties (None: they are elsewhere), and what was noticed."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    properties: list[str] | None
    notes: tuple[str, ...]


def value_columns(table: Table, roles: Reading, identity: Identity, owners: Codes) -> ValueColumns:
    """Give the columns that are not taken their roles: as named; else properties where constant, and states."""
    inputs = _found(table, roles.get("inputs", ()))
    states = _found(table, roles.get("states", ()))
    given = roles.get("properties")
    properties = _found(table, given) if _names_columns(table, given) else []
    noise = dict.fromkeys(_found(table, [*(roles.get("noise_columns") or {}).values()]))
    roles_of = Counter([*identity.columns, *inputs, *states, *properties, *noise])
    name, count = roles_of.most_common(1)[0]
    if count > 1:
        raise CommonlawError(f"{table.source}: column {name!r} is given two roles: give it one")
    rest = [name for name in table.columns if name not in roles_of]
    notes = []
    if indices := [name for name in rest if table.is_index(name)]:
        notes.append(f"columns left out, as indices of pandas without a name: {', '.join(indices)}")
    rest = [name for name in rest if name not in indices]
    if given is None and (properties := constant_columns(table, rest, owners, others_are_states=not states)):
        notes.append(f"{', '.join(properties)}: taken as properties, being constant for each object")
    rest = [name for name in rest if name not in properties]
    if not states:
        states = tuple(name for name in rest if table.is_numeric(name))
        if identity.object is None and not roles.get("wide"):
            notes += check_wide(table, states)
    left = [name for name in rest if name not in states]
    if left:
        notes.append(f"columns left out: {', '.join(left)}")
    if not states:
        raise CommonlawError(
            f"{table.source}: no column of numbers is left for the states; name them with states=[...]; "
            f"columns: {', '.join(table.columns)}"
        )
    elsewhere = given is not None and not _names_columns(table, given)
    return ValueColumns(states, inputs, None if elsewhere else list(properties), tuple(notes))


def _found(table: Table, names: Any) -> tuple[str, ...]:
    if not isinstance(names, Iterable):
        raise CommonlawError(f"columns are named by {names!r}: give the name of one, or a list of names")
    return tuple(table.find(name) for name in ([names] if isinstance(names, str) else names))


def noise_columns_of(table: Table, roles: Roles, states: Sequence[str]) -> dict[str, str]:
    """Return the columns of standard deviations by state."""
    given = roles.get("noise_columns") or {}
    try:
        return {find_name(state, states, "state"): table.find(name) for state, name in given.items()}
    except CommonlawError as error:
        raise CommonlawError(f"{table.source}: noise_columns=...: {error}") from None


def _names_columns(table: Table, given: Any) -> bool:
    """Say whether properties are given as names of columns and not as a second table."""
    if isinstance(given, str):
        return given in table.columns or not (Path(given).suffix or Path(given).exists())
    return isinstance(given, Sequence)
