"""Trials as tables again: frames, CSV and Parquet files."""

import os
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.runtime.files import write_whole
from commonlaw.trials.columns import Column
from commonlaw.trials.headers import join_header
from commonlaw.trials.parquet import write_parquet
from commonlaw.trials.trial import Property, Trial, TrialData, property_names
from commonlaw.trials.units import check_unit

if TYPE_CHECKING:
    import pandas as pd


def to_frame(data: TrialData) -> "pd.DataFrame":
    """Return a frame with a row for each sample, see `Trials.to_frame`."""
    import pandas as pd

    return pd.DataFrame({name: pd.Series(column).infer_objects() for name, column in _columns(data).items()})


def to_csv(data: TrialData, path: str | os.PathLike[str]) -> None:
    """Write a CSV file, see `Trials.to_csv`."""
    columns = _with_units(data)
    rows = zip(*(_cells(column) for column in columns.values()), strict=True)
    lines = [",".join(map(_quoted, columns)), *map(",".join, rows), ""]
    write_whole(path, "\n".join(lines).encode())


def to_parquet(data: TrialData, path: str | os.PathLike[str]) -> None:
    """Write a Parquet file, see `Trials.to_parquet`."""
    schema = data.schema
    roles = {
        "object": schema.object,
        "trial": schema.trial,
        "time": schema.time,
        "states": schema.states,
        "inputs": schema.inputs,
        "noise_columns": schema.noise_columns,
        "properties": property_names(data.properties),
    }
    write_parquet(path, _with_units(data), roles, data.notes)


def _columns(data: TrialData) -> dict[str, Column]:
    """Return the columns of all samples; a missing state or property is NaN among numbers and None among texts."""
    trials, schema, properties = data.trials, data.schema, data.properties
    rows = [_rows(trial) for trial in trials]
    row_trials = np.repeat(np.arange(len(trials)), [len(times) for times, *_ in rows])
    times, states, inputs, noise = (np.concatenate(each) for each in zip(*rows, strict=True))

    def per_trial(values: Sequence[Property | None]) -> Column:
        is_text = any(isinstance(value, str) for value in values)
        return np.array(values, dtype=object if is_text else np.float64)[row_trials]

    columns = {
        schema.object: per_trial([trial.object for trial in trials]),
        schema.trial: per_trial([trial.name for trial in trials]),
        schema.time: times,
    }
    values = np.hstack([states, inputs])
    columns |= dict(zip((*schema.states, *schema.inputs), values.T, strict=True))
    columns |= {name: noise[:, schema.states.index(state)] for state, name in schema.noise_columns.items()}
    for name in property_names(data.properties):
        columns[name] = per_trial([properties.get(trial.object, {}).get(name) for trial in trials])
    return columns


def _rows(trial: Trial) -> tuple[Floats, Floats, Floats, Floats]:
    """Return times, states, inputs and noise of a trial, from its first input before its first sample on."""
    own = trial.times, trial.states, trial.inputs, trial.noise
    if not len(trial.earlier):
        return own
    unknown = np.full((len(trial.earlier), trial.states.shape[1]), np.nan)
    before = trial.earlier[:, 0], unknown, trial.earlier[:, 1:], unknown
    times, states, inputs, noise = (np.concatenate(pair) for pair in zip(before, own, strict=True))
    return times, states, inputs, noise


def _with_units(data: TrialData) -> dict[str, Column]:
    """Return the columns with units in their names."""
    units = {name: check_unit(unit, f"column {name!r}") for name, unit in data.schema.units.items() if unit.strip()}
    return {join_header(name, units.get(name, "")): column for name, column in _columns(data).items()}


def _cells(column: Column) -> list[str]:
    """Return the cells of a column as CSV has them: text in quotes, numbers with all their digits, nothing if empty."""
    if column.dtype == object:
        return ["" if value is None else _quoted(value) for value in column]
    return ["" if value != value else repr(value) for value in column.tolist()]


def _quoted(text: str) -> str:
    return '"' + text.replace('"', '""') + '"'
