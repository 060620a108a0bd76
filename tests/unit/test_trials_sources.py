"""Tables in memory, and arrays, as other libraries hold them."""

from datetime import datetime, timedelta
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pint
import pytest

import commonlaw as cl
from commonlaw.trials import Trials
from tests.refusals import refused

TIMES = np.linspace(0.0, 2.0, 21)
X, Y = np.exp(-TIMES), np.cos(TIMES)
UNITS = pint.UnitRegistry()


class Dataset:
    """What is used of an xarray Dataset: two trials of the same times."""

    data_vars = ("x",)

    def __init__(self):
        units = {"trial": {}, "t": {"units": "s"}, "x": {"units": "cm", "long_name": "height"}}
        self.variables = {name: SimpleNamespace(attrs=own) for name, own in units.items()}

    def to_dataframe(self):
        index = pd.MultiIndex.from_product([["a", "b"], TIMES], names=["trial", "t"])
        return pd.DataFrame({"x": np.tile(X, 2)}, index=index)


def records(kind):
    rows = list(zip(TIMES, X, ["ball"] * 21, strict=True))
    return np.array(rows, dtype=[("t", kind), ("x", "<f4"), ("object", "S4")])


@pytest.mark.parametrize(
    "table",
    [
        {"t": TIMES, "x": X, "object": "ball"},
        {"t": TIMES.tolist(), "x": pd.Series(X, index=range(21, 0, -1)), "object": ["ball"] * 21},
        records("<f8"),
        records(">f8"),
        records("<f8").view(np.recarray),
    ],
    ids=["mapping", "other indices", "structured", "big-endian", "records"],
)
def test_columns_by_name_are_a_table(table):
    trials = Trials.from_frame(table)
    assert trials.objects == ("ball",)
    assert trials[0].times == pytest.approx(TIMES)
    assert trials[0].states[:, 0] == pytest.approx(X)


def test_quantities_have_their_unit():
    trials = Trials.from_frame({"t": TIMES * UNITS.ms, "x [cm]": X, "y": list(Y * UNITS.m / UNITS.s)})
    assert trials.schema.units == {"t": "ms", "x": "cm", "y": "m/s"}
    assert trials[0].states == pytest.approx(np.column_stack([X, Y]))
    metres = [X * UNITS.m, 100 * X * UNITS.cm]
    trials = Trials.from_arrays(TIMES * UNITS.s, metres, noise=[0.01 * X * UNITS.m, X * UNITS.cm], names=["h"])
    assert trials.schema.units == {"t": "s", "h": "m"}
    assert trials[1].states[:, 0] == pytest.approx(X)
    assert trials[1].noise[:, 0] == pytest.approx(0.01 * X)
    with refused("noise-in-other-unit", unit="mm", state_unit="m"):
        Trials.from_arrays(TIMES, X * UNITS.m, noise=X * UNITS.mm)


def test_a_dataset_is_a_table_of_its_coordinates():
    trials = Trials.from_frame(Dataset())
    assert [trial.name for trial in trials] == ["a", "b"]
    assert trials.schema.units == {"t": "s", "x": "cm"}
    assert trials[1].states[:, 0] == pytest.approx(X)


def test_columns_of_different_lengths_are_refused():
    with refused("columns-unequal"):
        Trials.from_frame({"t": TIMES, "x": X[:-1]})
    with refused("columns-unequal"):
        Trials.from_frame({"t": TIMES, "x": np.column_stack([X, Y])})


@pytest.mark.parametrize(
    ("states", "count"),
    [([X, Y], 2), ([np.column_stack([X, Y])] * 3, 3), (np.zeros((4, 21, 2)), 4), (np.column_stack([X, Y]), 1)],
)
@pytest.mark.parametrize("times", [TIMES, TIMES.tolist(), 0.1, np.float32(0.1)])
def test_times_of_all_trials_are_given_once(times, states, count):
    trials = Trials.from_arrays(times, states)
    assert len(trials) == count
    assert all(trial.times == pytest.approx(TIMES, rel=1e-6) for trial in trials)


def test_a_time_step_goes_with_trials_of_different_lengths():
    trials = Trials.from_arrays(0.5, [X, Y[:8]], object=["a", "b"])
    assert [len(trial) for trial in trials] == [21, 8]
    assert trials[1].times == pytest.approx(0.5 * np.arange(8))
    assert len(Trials.from_arrays(0.5, [[1.0, 2.0], [1.1, 2.1], [1.2, 2.2]], names=["x", "y"])) == 1
    for step in (0.0, -1.0, np.nan):
        with refused("time-step"):
            Trials.from_arrays(step, X)


def test_dates_in_a_mapping_are_times_since_the_earliest():
    stamps = [datetime(2024, 3, 1, 12) + timedelta(seconds=time) for time in TIMES]
    for given in (stamps, pd.Series(stamps), np.array(stamps, dtype="datetime64[ns]")):
        trials = Trials.from_frame({"t": given, "x": X})
        assert trials[0].times == pytest.approx(TIMES)
        assert trials.notes == ("t: dates taken as time in seconds since 2024-03-01 12:00:00",)


def test_a_table_is_fitted_as_the_trials_in_it_are():
    table = {"t": TIMES, "x": X}
    assert cl.fit("x' = -k x", table).coefficients == pytest.approx(np.full((1, 1, 1), -1.0))
    with refused("arguments-swapped"):
        cl.fit(table, "x' = -k x")
