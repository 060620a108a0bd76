"""Columns of numbers that label objects and trials."""

import numpy as np
import pandas as pd

import commonlaw as cl
from commonlaw.law.tables import coefficients_by_object
from commonlaw.trials import Trials


def test_masses_and_counted_releases_are_objects_and_trials():
    times = np.linspace(0, 1, 11)
    rows = [
        (mass, release, time, release * np.cos(time / mass))
        for mass in (0.2, 0.5, 1.0)
        for release in (1, 2)
        for time in times
    ]
    trials = Trials.from_frame(pd.DataFrame(rows, columns=["mass (kg)", "release", "time (s)", "x (cm)"]))
    assert (trials.objects, [trial.name for trial in trials]) == (("0.2", "0.5", "1"), ["1", "2"] * 3)
    assert trials.schema.states == ("x",)
    assert {name: values["mass"] for name, values in trials.properties.items()} == {"0.2": 0.2, "0.5": 0.5, "1": 1.0}


def test_what_names_the_objects_is_their_property_also_in_a_saved_table_and_no_number_of_theirs_is(tmp_path):
    times = np.tile(np.linspace(0, 1, 11), 3)
    for header, values, expected in (("R (Ohm)", (10, 22, 47), {"R"}), ("mouse", (101, 102, 107), set())):
        table = {header: np.repeat(values, 11), "t": times, "x": np.cos(times)}
        trials = Trials.from_frame(pd.DataFrame(table))
        assert {name for values in trials.properties.values() for name in values} == expected
        trials.to_csv(path := tmp_path / "table.csv")
        assert Trials.read(path) == trials
        assert Trials.read(path, object=trials.schema.object, properties=sorted(expected)) == trials


def test_a_parameter_that_names_the_objects_is_shown_once():
    times = np.tile(np.linspace(0, 3, 20), 3)
    resistances = np.repeat([1.0, 2.0, 5.0], 20)
    voltages = np.exp(-times / resistances) + 0.01 * np.random.default_rng(0).standard_normal(60)
    trials = Trials.from_frame({"R (kOhm)": resistances, "t (ms)": times, "U (V)": voltages})
    frame = coefficients_by_object(cl.fit("U' = -k U/R", trials))
    assert len(frame.columns) == 2
    assert frame["R"].tolist() == ["1", "2", "5"]
