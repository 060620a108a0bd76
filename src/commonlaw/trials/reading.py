"""What a user says of a table: which column is what, and how cells and rows are read."""

import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypedDict, get_args

from commonlaw.errors import CommonlawError, check_choice, unknown
from commonlaw.trials.cells import DecimalMark, Notation
from commonlaw.trials.trial import PropertyTable

READ_AS = "read as "
"""What the note on the layout of a file begins with."""

DateOrder = Literal["dmy", "mdy", "ymd", "h:mm", "m:ss"]
"""How dates are written, and times of day."""

Restarts = Literal["trials", "sort"]
"""What times that go back mean: new trials, or rows of one trial that are out of order."""


class _Columns(TypedDict, total=False):
    object: str | None
    object_name: str | None
    trial: str | None
    time: str | None
    states: str | Sequence[str] | None
    inputs: str | Sequence[str] | None
    noise_columns: Mapping[str, str] | None
    units: Mapping[str, str] | None


class _Rules(TypedDict, total=False):
    wide: bool | str | None
    restarts: Restarts | None
    missing: str | float | Sequence[str | float] | None
    below: Mapping[str, float] | Sequence[tuple[str, float]] | None
    decimal: DecimalMark | None
    dates: DateOrder | None


class Roles(_Columns, total=False):
    """Roles of columns, named by their headers with or without the unit.

    Other roles are inferred; `Trials.notes` lists them.

    Parameters
    ----------
    object
        Column of the names of objects. Default: ``object``, or a column of repeated text, or of whole numbers with a
        name such as ``subject``; otherwise, or with ``""``, there is one object.
    object_name
        Name of the object in a table without such a column.
    trial
        Column of the trials' labels. Default: ``trial``, or a column with a name such as ``run``, or that of text or of
        counts without which the times of an object would go back; else every object has one trial, as with ``""``.
    time
        Column of the times. Default: ``t`` or ``time``, or a column with a word or a unit of time in its header that
        increases. Dates and counts since 1970 become days since the earliest, or seconds if they have hours; the date
        may stand in a column of its own. Durations such as 1:30:00 become seconds.
    states
        Columns of the measured states. Default: the columns of numbers without another role.
    inputs
        Columns of the measured inputs, ``[]`` for none. Default, where no states are named: columns of numbers that are
        held at levels, recur in several trials, or are smooth to the last digit where others scatter.
    noise_columns
        Columns of standard deviations of the measurements, by state: ``{"x": "sx"}``; ``{}`` for none. Default:
        positive columns with a name such as ``x_std`` or ``std1`` that goes with a state.
    properties
        Columns of the objects' properties; or a second table (a file, a frame) with a row for each object; or a mapping
        from object to values by name. Default: the columns without another role that are constant for each object.
    units
        Units by column, in place of those in the headers.
    """

    properties: str | os.PathLike[str] | Sequence[str] | PropertyTable | Any


class Reading(Roles, _Rules, total=False):
    """Roles of columns, and rules for reading the rows of a table.

    Parameters
    ----------
    wide
        What was measured, such as ``"OD"`` with its unit or without, in a table with a column for each object; True is
        for ``"value"``. The columns are those of `states`, by default all of numbers without another role. Rows ahead
        of the first time, with a name in place of the time, are properties. Default: True for columns that are named
        like wells or replicates, or by a common stem (``Cup A``, ``T1``) unless they act on each other or are
        coordinates (``x1``); not where objects or states are named.
    restarts
        Meaning of times that go back within a trial: ``"trials"``, a new trial begins; ``"sort"``, rows are out of
        order. Default: rows in reverse or random order, and a few single ones, are sorted; other tables are refused.
    missing
        Marks of missing values, such as ``-999`` or ``["<0.5", "BLQ"]``, besides empty cells, NA, NaN, ``-``, n.d. and
        the like.
    below
        Marks of values below a limit of quantification, with the limit, ``{"BLQ": 0.5}``, besides ``<0.5``. `fit`
        treats them as left-censored; elsewhere they are missing.
    decimal
        The decimal mark, ``"."`` or ``","``. Default: inferred; ambiguous columns, as of 1,000, are refused.
    dates
        Format of ambiguous dates, ``"dmy"``, ``"mdy"`` or ``"ymd"``, and times of day, ``"h:mm"`` or ``"m:ss"``.
        Default: the one that is possible in all rows.
    """


class WrittenReading(_Columns, _Rules, total=False):
    """The same as a file or the page of the app says it: without tables of properties, which may be any file."""

    properties: Sequence[str] | None


def notation_of(roles: Reading) -> Notation:
    """Return how numbers are written, as far as the user says."""
    missing = roles.get("missing", ())
    marks = [missing] if isinstance(missing, str | int | float) else list(missing or ())
    below = {str(mark).strip(): float(limit) for mark, limit in dict(roles.get("below") or {}).items()}
    return Notation(roles.get("decimal"), missing=tuple(str(mark).strip() for mark in marks), below=below)


def checked(roles: Mapping[str, Any], kind: type = Reading) -> Any:
    """Return the keywords that say something, having refused those that there are not."""
    for name in roles:
        if name not in kind.__annotations__:
            raise unknown("keyword", name, dict.fromkeys([*kind.__annotations__, "sheet"]))
    given = {name: value for name, value in roles.items() if value is not None}
    if not isinstance(given.get("noise_columns", {}), Mapping):
        raise CommonlawError("noise-columns-not-by-state", value=given["noise_columns"])
    if "states" in given and not given["states"]:
        del given["states"]
    for name, choices in (("restarts", Restarts), ("decimal", DecimalMark), ("dates", DateOrder)):
        if name in given:
            check_choice(name, given[name], get_args(choices))
    return given
