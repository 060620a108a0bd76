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
from commonlaw.trials.trial import TrialData
from commonlaw.trials.units import check_unit

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa


def to_frame(data: TrialData) -> "pd.DataFrame":
    """Return a frame with a row for each sample, see `Trials.to_frame`."""
    frame: pd.DataFrame = _table(data).to_pandas()
    return frame


def to_csv(data: TrialData, path: str | os.PathLike[str]) -> None:
    """Write a CSV file, see `Trials.to_csv`."""
    import pyarrow.csv as arrow_csv

    content = io.BytesIO()
    arrow_csv.write_csv(_with_units(data), content)
    write_whole(path, content.getvalue())


def to_parquet(data: TrialData, path: str | os.PathLike[str]) -> None:
    """Write a Parquet file, see `Trials.to_parquet`."""
    import pyarrow.parquet as pq

    schema = data.schema
    roles = {
        "object": schema.object,
        "trial": schema.trial,
        "time": schema.time,
        "states": schema.states,
        "inputs": schema.inputs,
        "properties": _property_names(data),
    }
    kept = json.dumps({"roles": roles, "notes": data.notes}).encode()
    content = io.BytesIO()
    pq.write_table(_with_units(data).replace_schema_metadata({METADATA: kept}), content)
    write_whole(path, content.getvalue())


def _table(data: TrialData) -> "pa.Table":
    """Return the Arrow table of all samples."""
    import pyarrow as pa

    trials, schema, properties, _ = data
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
    for name in _property_names(data):
        columns[name] = per_trial([properties.get(trial.object, {}).get(name) for trial in trials])
    return pa.table(columns)


def _with_units(data: TrialData) -> "pa.Table":
    """Return the Arrow table with units in its headers."""
    table = _table(data)
    units = {name: check_unit(unit, f"column {name!r}") for name, unit in data.schema.units.items() if unit.strip()}
    return table.rename_columns([join_header(name, units.get(name, "")) for name in table.column_names])


def _property_names(data: TrialData) -> list[str]:
    return list(dict.fromkeys(name for values in data.properties.values() for name in values))
