"""Tables of experiments as packages of statistics export them: row names, classes, and several conditions."""

from itertools import product

import numpy as np
import pandas as pd
import pytest

from commonlaw.trials import Trials
from tests.refusals import refused

T = np.arange(6.0)


def experiment(**conditions):
    """Return a table with a run for each combination of the conditions."""
    runs = [
        pd.DataFrame({**dict(zip(conditions, cells, strict=True)), "Time": T})
        for cells in product(*conditions.values())
    ]
    frame = pd.concat(runs, ignore_index=True)
    return frame.assign(conc=np.random.default_rng(0).normal(5, 1, len(frame)).round(2))


def read(tmp_path, frame, **roles):
    frame.to_csv(tmp_path / "table.csv", index=False)
    return Trials.read(tmp_path / "table.csv", **roles)


NUMBERED = [(header, "F") for header in ("rownames", "row.names", "Unnamed: 0", "...1")] + [("id", "C"), ("X", "C")]


@pytest.mark.parametrize(("header", "order"), NUMBERED)
def test_numbers_of_rows_are_neither_states_nor_times(tmp_path, header, order):
    frame = experiment(Subject=[1, 2, 3])
    numbers = np.arange(1, len(frame) + 1).reshape((3, -1), order=order).ravel()  # Sorted by time before, or not
    frame.insert(0, header, numbers)
    trials = read(tmp_path, frame)
    assert (trials.schema.object, trials.schema.time, trials.schema.states) == ("Subject", "Time", ("conc",))
    assert header in " ".join(trials.notes)


@pytest.mark.parametrize("header", ["rownames", "Unnamed: 0"])
def test_a_table_without_times_is_refused(tmp_path, header):
    rate = [76, 47, 97, 107, 123, 139, 159, 152]
    frame = pd.DataFrame({header: range(1, 9), "conc": np.repeat([0.02, 0.06, 0.11, 0.22], 2), "rate": rate})
    with refused("time-missing"):
        read(tmp_path, frame)
    assert read(tmp_path, frame, time=header).schema.states == ("conc", "rate")


def test_times_of_day_label_trials(tmp_path):
    trials = read(tmp_path, experiment(Subject=[1, 2], Meal=["10am", "2pm", "6 pm"]))
    assert (trials.schema.object, trials.schema.trial, len(trials)) == ("Subject", "Meal", 6)
    clock = pd.DataFrame({"time": ["11am", "12pm", "1 PM", "2pm"], "x": [1.5, 2, 4, 3]})
    assert read(tmp_path, clock)[0].times.tolist() == [39600, 43200, 46800, 50400]


def test_classes_beyond_a_limit_are_words(tmp_path):
    frame = experiment(Subject=[1, 2, 3])
    frame["score"] = np.where(frame["Subject"] == 2, "< 5", ">= 5")
    assert read(tmp_path, frame).properties["2"] == {"score": "< 5"}
    below = experiment(Subject=[1, 2, 3]).astype({"conc": object})
    below.loc[::2, "conc"] = "<0.5"
    assert read(tmp_path, below)[0].below.size


@pytest.mark.parametrize("second", ["medium", "dose"])
def test_conditions_name_objects_together_where_none_alone_separates_the_times(tmp_path, second):
    cells = {"medium": ["LB", "M9"], "dose": [0, 0.24, 15.6]}[second]
    frame = experiment(strain=["D", "T"], replicate=[1, 2], **{second: cells})
    trials = read(tmp_path, frame)
    assert (trials.schema.object, trials.schema.trial) == (f"strain, {second}", "replicate")
    assert len(trials) == len(frame) / len(T)
    assert trials.properties[f"T, {cells[1]}"] == {"strain": "T", second: cells[1]}
    named = read(tmp_path, frame.sample(frac=1, random_state=1), object=trials.schema.object, trial="replicate")
    assert {*named.objects} == {*trials.objects}


@pytest.mark.parametrize("passes", [False, True])
def test_hours_and_minutes_without_a_colon_are_times_of_day(tmp_path, passes):
    minutes = (1320 if passes else 500) + np.delete(np.arange(0, 240, 10), 7)
    frame = pd.DataFrame({"day": 346 + minutes // 1440, "time": minutes // 60 % 24 * 100 + minutes % 60})
    frame["temp"] = 36 + np.random.default_rng(0).normal(0, 0.1, len(frame)).round(2)
    trials = read(tmp_path, frame)
    assert (trials[0].times / 60).tolist() == minutes.tolist()
    assert (trials.schema.states, trials.schema.units["time"]) == (("temp",), "s")
    seconds = read(tmp_path, frame.assign(time=np.delete(np.arange(0, 240, 10), 7)))
    assert seconds[0].times[-1] == 230


def test_doses_in_consecutive_rows_are_amounts(tmp_path):
    frame = experiment(Subject=[1, 2])
    frame["dose"] = np.where(frame["Time"] % 3 == 0, np.nan, 10.0)
    frame.loc[frame["dose"].notna(), "conc"] = np.nan
    assert {dose.amount for trial in read(tmp_path, frame) for dose in trial.doses} == {10.0}
    assert any("doses=['dose']" in note for note in read(tmp_path, frame, inputs="dose").notes)


@pytest.mark.parametrize(
    ("names", "hinted"), [("T_milk T_tea", True), ("pos_x pos_y", False), ("T_milk OD_tea", False)]
)
def test_one_quantity_of_two_things_may_be_an_object_each(tmp_path, names, hinted):
    frame = pd.DataFrame({"t": T, **{name: np.exp(-T / (2 + i)) for i, name in enumerate(names.split())}})
    assert any("wide='value'" in note for note in read(tmp_path, frame).notes) == hinted


def test_numbers_that_are_never_used_twice_name_objects_without_their_group(tmp_path):
    frame = experiment(plot=[3, 5, 58, 59])
    frame["treatment"] = np.where(frame["plot"] < 50, "ozone", "control")
    trials = read(tmp_path, frame)
    assert trials.schema.object == "plot"
    assert trials.properties["58"] == {"treatment": "control"}


def test_counts_of_the_samples_of_each_trial_are_left_out(tmp_path):
    frame = experiment(Subject=[1, 2, 3])
    frame["Occasion"], frame["Time"] = frame["Time"] + 1, frame["Time"] ** 1.5 + 0.1 * (frame["Subject"] == 2)
    trials = read(tmp_path, frame)
    assert (trials.schema.states, trials.schema.inputs) == (("conc",), ())


@pytest.mark.parametrize(
    ("header", "cells", "is_property"),
    [("mass (g)", [50, 100, 200], True), ("length_m", [0.25, 0.5, 1], True), ("r", [0.5, 1, 2], False)],
)
def test_a_quantity_that_names_objects_is_a_property_of_them(tmp_path, header, cells, is_property):
    trials = read(tmp_path, experiment(**{header: cells}))
    name = header.split()[0]
    assert (trials.schema.object, len(trials.objects)) == (name, 3)
    values = {owner: {name: float(owner)} for owner in trials.objects} if is_property else {}
    assert trials.properties == values
    trials.to_csv(tmp_path / "again.csv")
    again = Trials.read(tmp_path / "again.csv", **({} if is_property else {"object": name}))
    assert (again.objects, again.properties) == (trials.objects, values)
    named = read(tmp_path, experiment(**{header: cells}), object=name, properties=[name])
    assert named.properties == {owner: {name: float(owner)} for owner in trials.objects}
