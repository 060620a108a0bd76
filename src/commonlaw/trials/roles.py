"""The keywords that say which column of a table is what."""

import os
from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

Property = float | str
PropertyTable = Mapping[Any, Mapping[str, Property]]


class Roles(TypedDict, total=False):
    """Which column is what; a column is named by its header with or without the unit in it.

    Parameters
    ----------
    object
        Column of the objects' names. Default: ``object`` if there is such a column, else the table is of one object.
    trial
        Column of the trials' labels. Default: ``trial`` if there is such a column, else every object has one trial.
    time
        Column of the times. Default: ``t`` or ``time``.
    states
        Columns of the measured states. Default: the columns of numbers that have no other role and are not constant
        for each object.
    inputs
        Columns of the measured inputs. Default: none.
    properties
        Columns of the objects' properties; or a second table (a file, a frame) with a row for each object; or a
        mapping from object to property values by name. Default: the columns without another role that are constant
        for each of at least two objects.
    units
        Units by column; they take precedence over those in the headers.
    """

    object: str | None
    trial: str | None
    time: str | None
    states: str | Sequence[str] | None
    inputs: str | Sequence[str]
    properties: str | os.PathLike[str] | Sequence[str] | PropertyTable | Any
    units: Mapping[str, str] | None
