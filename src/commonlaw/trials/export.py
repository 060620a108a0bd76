"""Trials as tables again: frames, CSV and Parquet files."""

import io
import json
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.files import write_whole
from commonlaw.trials.headers import join_header
from commonlaw.trials.sources import METADATA
from commonlaw.trials.trials import Trials
from commonlaw.trials.units import check_unit

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa


def to_frame(trials: Trials) -> "pd.DataFrame":
    """Return a frame with a row for each sample.

    Its columns are the object, the trial, the time, the states, the inputs and the properties of the objects, under
    the names that the schema has for them.
    """
    frame: pd.DataFrame = _table(trials).to_pandas()
    return frame


def to_csv(trials: Trials, path: str | os.PathLike[str]) -> None:
    """Write a CSV file with the columns of `to_frame`, their units in the headers: ``height [m]``.

    Numbers are written so that they come back bit for bit. Reading the file with the same roles gives the same trials;
    only a property in text that looks like a number comes back as a number, as CSV knows no difference.

    Raises
    ------
    CommonlawError
        If pint does not know a unit, or the file cannot be written.
    """
    import pyarrow.csv as arrow_csv

    content = io.BytesIO()
    arrow_csv.write_csv(_with_units(trials), content)
    write_whole(path, content.getvalue())


def to_parquet(trials: Trials, path: str | os.PathLike[str]) -> None:
    """Write a Parquet file that holds the roles of its columns and so comes back exactly without a keyword.

    Raises
    ------
    CommonlawError
        If pint does not know a unit, or the file cannot be written.
    """
    import pyarrow.parquet as pq

    schema = trials.schema
    roles = {
        "object": schema.object,
        "trial": schema.trial,
        "time": schema.time,
        "states": schema.states,
        "inputs": schema.inputs,
        "properties": _property_names(trials),
    }
    kept = json.dumps({"roles": roles, "notes": trials.notes}).encode()
    content = io.BytesIO()
    pq.write_table(_with_units(trials).replace_schema_metadata({METADATA: kept}), content)
    write_whole(path, content.getvalue())


def _table(trials: Trials) -> "pa.Table":
    """Return the Arrow table of all samples."""
    import pyarrow as pa

    schema = trials.schema
    row_trials = pa.array(np.repeat(np.arange(len(trials)), [len(trial) for trial in trials]))

    def per_trial(values: Sequence[Any]) -> "pa.Array":
        return pa.array(values).take(row_trials)

    columns = {
        schema.object: per_trial([trial.object for trial in trials]),
        schema.trial: per_trial([trial.name for trial in trials]),
        schema.time: pa.array(np.concatenate([trial.times for trial in trials])),
    }
    values = np.concatenate([np.hstack([trial.states, trial.inputs]) for trial in trials])
    names = (*schema.states, *schema.inputs)
    # A missing state is an empty cell
    columns |= {name: pa.array(column, from_pandas=True) for name, column in zip(names, values.T, strict=True)}
    for name in _property_names(trials):
        columns[name] = per_trial([trials.properties.get(trial.object, {}).get(name) for trial in trials])
    return pa.table(columns)


def _with_units(trials: Trials) -> "pa.Table":
    """Return the Arrow table with units in its headers."""
    table = _table(trials)
    units = {name: check_unit(unit, f"column {name!r}") for name, unit in trials.schema.units.items() if unit.strip()}
    return table.rename_columns([join_header(name, units.get(name, "")) for name in table.column_names])


def _property_names(trials: Trials) -> list[str]:
    return list(dict.fromkeys(name for values in trials.properties.values() for name in values))
