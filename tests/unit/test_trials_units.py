"""Units of what is counted."""

import subprocess
import sys

import numpy as np
import pandas as pd
import pytest

from commonlaw.trials import Schema, Trial, Trials
from commonlaw.trials.headers import known_unit, registry
from commonlaw.trials.transformations import in_units, with_logarithms, with_starts, without_rates


@pytest.mark.parametrize("unit", ["cells", "individuals", "CFU", "OD", "IU", "counts", "people", "copies"])
def test_counts_are_units_without_a_dimension(unit):
    assert known_unit(unit).dimensionless
    trials = Trials.from_frame(pd.DataFrame({f"N [{unit}/mL]": [1.0, 2.0], "t [min]": [0.0, 1.0]}))
    assert trials.schema.states == ("N",)
    assert trials.schema.units == {"N": f"{unit}/mL", "t": "min"}


def test_counts_are_converted_as_numbers():
    assert registry().Quantity(1, "cells/mL").m_as("1/L") == pytest.approx(1000)
    assert registry().Quantity(0.01, "OD/min").m_as("OD/h") == pytest.approx(0.6)


@pytest.mark.parametrize(("unit", "name"), [("m", "meter"), ("cd", "candela"), ("pF", "picofarad"), ("P", "poise")])
def test_counts_take_no_unit_of_physics_away(unit, name):
    assert str(known_unit(unit)) == name


def test_units_can_be_compared_where_several_threads_use_them_first():
    program = (
        "from concurrent.futures import ThreadPoolExecutor as Pool; from commonlaw.trials.headers import registry;"
        "print(len({id(each) for each in Pool(8).map(lambda _: registry(), range(8))}))"
    )
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "1\n"


def test_limits_of_quantification_change_with_their_state():
    states, below = np.array([[3.0, 0.0], [np.nan, 1.0], [2.0, 1.0]]), np.full((3, 2), np.nan)
    below[1, 0] = 500.0
    trial = Trial("a", "1", [0.0, 1.0, 2.0], states, below=below)
    trials = Trials((trial,), Schema(("m", "v"), units={"m": "mg"}))
    assert in_units(trials, {"m": "g"})[0].below[1, 0] == pytest.approx(0.5)
    logarithmic = with_logarithms(trials, ["m"])
    assert logarithmic[0].below[1, 0] == pytest.approx(np.log(500))
    assert in_units(logarithmic, {"m": "g"})[0].below[1, 0] == pytest.approx(np.log(0.5))
    np.testing.assert_array_equal(without_rates(trials, {"m": "v"})[0].below, below[:, :1])
    assert with_starts(trials, {"s": 1.0}, -1.0)[0].below[2, 0] == 500.0
