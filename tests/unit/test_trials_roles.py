"""Roles of columns that nobody names, by their names, units and values."""

import time

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.errors import CommonlawError
from commonlaw.trials import Trials
from commonlaw.trials.recognition import units_in_names
from commonlaw.trials.transformations import refuse_amounts
from tests.refusals import refused

T = np.linspace(0, 4, 21)
RNG = np.random.default_rng(0)


def stacked(labels, **columns):
    """Return a table with a run for each pair of labels; columns are functions of time and the number of the run."""
    runs = [
        pd.DataFrame({**label, "t": T, **{name: column(T, i) for name, column in columns.items()}})
        for i, label in enumerate(labels)
    ]
    return pd.concat(runs, ignore_index=True)


def decay(t, i):
    return (i + 1) * np.exp(-t) + RNG.normal(0, 0.01, len(t))


def pairs(first, second, firsts=("a", "b"), seconds=(1, 2)):
    return [{first: one, second: other} for one in firsts for other in seconds]


def roles_of(frame, **named):
    schema = (trials := Trials.from_frame(frame, **named)).schema
    properties = {name for attribute in trials.properties.values() for name in attribute}
    return schema.object, schema.trial, schema.time, schema.states, schema.inputs, properties


@pytest.mark.parametrize(
    ("first", "second", "seconds"),
    [
        ("Ball", "Drop", (1, 2)),
        ("strain", "replicate", (1, 2)),
        ("rig", "run", ("r1", "r2")),
        ("Sample", "No", (1, 2)),
        ("kind", "w", (1, 2)),
        ("star", "w", (0, 1)),
        ("experiment", "rep", (1, 2)),
    ],
)
def test_text_names_objects_and_what_repeats_within_them_labels_trials(first, second, seconds):
    frame = stacked(pairs(first, second, seconds=seconds), x=decay)
    assert roles_of(frame) == (first, second, "t", ("x",), (), set())
    shuffled = frame.sample(frac=1, random_state=1)[["x", "t", second, first]]
    if second not in ("w", "No"):  # Names that say nothing need the order of rows
        assert roles_of(shuffled) == (first, second, "t", ("x",), (), set())


def test_what_is_constant_within_an_object_is_its_property_and_a_coarser_text_too():
    frame = stacked(pairs("ball", "drop", firsts=("golf", "tennis", "squash")), x=decay)
    frame["mass"] = frame["ball"].map({"golf": 0.046, "tennis": 0.058, "squash": 0.024})
    frame.insert(0, "maker", frame["ball"].map({"golf": "A", "tennis": "B", "squash": "B"}))
    assert roles_of(frame) == ("ball", "drop", "t", ("x",), (), {"mass", "maker"})


def test_numbers_name_objects_under_the_name_of_one_and_trials_under_that_of_a_trial():
    frame = stacked([{"subject": i} for i in (101, 205, 317)], x=decay)
    assert roles_of(frame)[:2] == ("subject", "trial")
    assert roles_of(frame.rename(columns={"subject": "run"}))[:2] == ("object", "run")
    groups = frame.assign(group=frame["subject"].map({101: "a", 205: "b", 317: "b"}))
    assert roles_of(groups) == ("subject", "trial", "t", ("x",), (), {"group"})
    assert roles_of(stacked(pairs("group", "mouse"), x=decay))[:2] == ("group", "mouse")
    assert roles_of(frame, object="", restarts="trials")[3:5] == (("x",), ("subject",))


def test_numbers_that_separate_repeated_times_name_objects_whatever_they_are_called():
    frame = stacked([{"c": i + 1} for i in range(4)], x=decay)
    assert roles_of(frame) == ("c", "trial", "t", ("x",), (), set())
    assert roles_of(frame.sort_values(["t", "c"], ignore_index=True))[0] == "c"
    held = stacked([{"heat": 20.5 + 10 * i} for i in range(3)], x=decay)
    assert roles_of(held.assign(pH=7.0 + held["heat"] // 30)) == ("heat", "trial", "t", ("x",), (), {"pH"})
    runs = stacked(pairs("heat", "run", firsts=(20.5, 31.0)), x=decay)
    assert roles_of(runs)[:2] == ("heat", "run")
    both = stacked(pairs("heat", "c", firsts=(20.5, 31.0), seconds=(1.5, 2.5)), x=decay)  # Neither alone does
    assert roles_of(both) == ("heat, c", "trial", "t", ("x",), (), {"heat", "c"})
    assert roles_of(held[held["heat"] == 20.5])[0] == "object"


@pytest.mark.parametrize("names", [("10 mg", "25 mg"), ("1a", "2b"), ("A", "T"), ("T1", "T2")])
def test_names_may_begin_with_digits_and_clocks_are_no_names(names):
    frame = stacked([{"kind": name} for name in names], x=decay)
    clocks = frame.assign(clock=[f"{9 + i % 4}:30 am" for i in range(len(frame))])
    assert roles_of(frame)[0] == roles_of(clocks)[0] == "kind"


def test_remarks_name_nothing_and_are_left_out():
    frame = stacked([{"unit": "A"}], x=decay).assign(phase=["heat"] * 10 + ["cool"] * 11)
    assert roles_of(frame)[:2] == ("unit", "trial")
    assert roles_of(frame.drop(columns="unit"))[:2] == ("object", "trial")
    switching = frame.assign(unit=["A", "B", "A"] * 7)
    assert roles_of(switching)[0] == "object"
    frame = stacked(pairs("kind", "w"), x=decay)
    remarked = frame.assign(remark=np.where(frame["t"] > 2, "late", "early"))
    assert roles_of(remarked) == ("kind", "w", "t", ("x",), (), set())


def test_columns_that_may_name_objects_or_quantities_are_asked_about():
    frame = stacked([{"variable": "x"}, {"variable": "y"}], value=decay)
    with refused("long-table", column="variable"):
        Trials.from_frame(frame)
    assert Trials.from_frame(frame, object="variable").objects == ("x", "y")
    tidy = pd.concat([frame.assign(batch=batch) for batch in ("B1", "B2")]).sort_values(["batch", "t"])
    with refused("long-table", column="variable"):
        Trials.from_frame(tidy.assign(unit="g/L").reset_index(drop=True))
    frame = stacked(pairs("medium", "operator", seconds=("Ann", "Bob")), x=decay)
    with refused("object-ambiguous", first="medium", second="operator"):
        Trials.from_frame(frame)
    assert roles_of(frame, object="medium")[:2] == ("medium", "operator")


@pytest.mark.parametrize(
    ("header", "name"),
    [
        ("minutes", "minutes"),
        ("hour", "hour"),
        ("year", "year"),
        ("Age", "Age"),
        ("sec", "sec"),
        ("Zeit [min]", "Zeit"),
        ("elapsed_s", "elapsed_s"),
        ("Time since start (h)", "Time since start"),
        ("clock [s]", "clock"),
        ("duration [ms]", "duration"),
        ("n", "n"),
        ("t_min", "t_min"),
    ],
)
def test_a_column_that_increases_and_is_called_like_a_time_is_the_time_whatever_else_is_called_t(header, name):
    frame = pd.DataFrame({"T": 80 * np.exp(-T) + 20, header: T, "Response [s]": np.cos(9 * T)})
    schema = Trials.from_frame(frame).schema
    assert (schema.time, schema.states) == (name, ("T", "Response"))


def test_a_time_that_is_called_like_a_unit_has_it():
    frame = pd.DataFrame({"hours": T, "x": np.exp(-T)})
    assert Trials.from_frame(frame).schema.units == {"hours": "h"}
    assert Trials.from_frame(frame, units={"hours": ""}).schema.units == {}
    assert Trials.from_frame(frame.rename(columns={"hours": "age"})).schema.units == {}


@pytest.mark.parametrize(
    ("names", "units"),
    [
        (["x_mm", "y_mm"], {"x_mm": "mm", "y_mm": "mm"}),
        (["temp_C", "mass_g"], {"temp_C": "degC", "mass_g": "g"}),
        (["voltage_V", "current_A"], {"voltage_V": "V", "current_A": "A"}),
        (["outdoor air temperature_K", "speed_m_s"], {"outdoor air temperature_K": "K", "speed_m_s": "m/s"}),
        (["V_m", "T_s", "T_C", "E_g", "k_B", "v_m", "x_m", "m_s", "I_A", "pop_h"], {}),
        (["x_cm", "pos_cm", "x_in", "x_bar", "x_min", "x_max", "x_ref"], {}),
        (["temp_in", "pressure_at", "mass_t", "speed_c", "temp_s", "mass_m", "voltage_A", "light_V"], {}),
        (["temp_A", "Temp_B", "temp_C"], {}),
        (["current_A", "current_B"], {}),
        (["mass_g", "mass_kg"], {}),
        (["temp_C", "temp_C_sd"], {"temp_C": "degC"}),
    ],
)
def test_names_of_quantities_may_end_in_units_and_other_names_do_not(names, units):
    trials = Trials.from_frame(stacked([{}], **dict.fromkeys(names, decay)), inputs=[], object="")
    assert dict(trials.schema.units) == units
    assert set(trials.schema.states) | {*trials.schema.noise_columns.values()} == set(names)
    assert any("units read from names" in note for note in trials.notes) == bool(units)
    chosen = dict.fromkeys(trials.schema.states, "")
    assert not Trials.from_frame(
        stacked([{}], **dict.fromkeys(names, decay)), inputs=[], object="", units=chosen
    ).schema.units


def test_of_two_times_the_user_is_asked_and_another_clock_is_no_state():
    frame = pd.DataFrame({"minutes": T, "seconds": 60 * T, "x": np.exp(-T)})
    with refused("time-ambiguous"):
        Trials.from_frame(frame)
    trials = Trials.from_frame(frame, time="minutes")
    assert trials.schema.states == ("x",)
    assert trials.notes[-1] == "columns left out: seconds"
    with refused("time-ambiguous"):
        Trials.from_frame(pd.DataFrame({"n": T, "T": 20 + T, "x": np.exp(-T)}))
    assert Trials.from_frame(pd.DataFrame({"n": T, "T [degC]": 20 + T})).schema.time == "n"


@pytest.mark.parametrize(
    ("force", "reason"),
    [
        (lambda t, i: (i + 1) * np.where((t > 1) & (t < 3), 5.0, 0.0), "held at levels"),
        (lambda t, i: np.repeat([0.0, 7.0, 3.0, 9.0, 1.0, 4.0, 8.0], 3) + i + 0 * t, "held at levels"),
        (lambda t, i: np.where(np.arange(len(t)) % 7 == i, 100.0, 0.0), "held at levels"),
        (lambda t, i: 2.5 * (i % 2) + 0 * t, "constant in each trial"),
        (lambda t, i: np.random.default_rng(i % 2).normal(0, 1, len(t)), "the same in several trials"),
        (lambda t, i: np.round(np.sin(t + i), 3), "smooth to its last digit"),
        (lambda t, i: np.round(np.sin(0.4 * np.arange(len(t)) + i), 6), "smooth to its last digit"),
    ],
)
def test_what_was_set_is_an_input(force, reason):
    frame = stacked(pairs("rig", "run"), x=decay, F=force)
    assert roles_of(frame) == ("rig", "run", "t", ("x",), ("F",), set())
    assert f"input: F ({reason})" in Trials.from_frame(frame).notes[0]
    assert roles_of(frame, states=["x", "F"])[3:5] == (("x", "F"), ())
    assert roles_of(frame, inputs=[])[3:5] == (("x", "F"), ())


def test_u_is_an_input_unless_it_is_a_velocity():
    frame = pd.DataFrame({"t": T, "u": decay(T, 0), "y": decay(T, 1)})
    assert roles_of(frame)[3:5] == (("y",), ("u",))
    assert roles_of(frame.rename(columns={"y": "v"}))[3:5] == (("u", "v"), ())


def test_amounts_given_at_single_samples_are_said_to_be_interpolated(tmp_path):
    frame = stacked([{"subject": i} for i in (3, 5, 8)], conc=decay).assign(amt=0.0)
    frame.loc[frame["t"] == 0, "amt"] = 100.0
    path = tmp_path / "drug.csv"
    frame.to_csv(path, index=False)
    for trials in (Trials.read(path), Trials.read(path, states="conc", inputs="amt")):
        assert trials.schema.inputs == ("amt",)
        assert any("amt is zero but for single samples" in note and "doses=['amt']" in note for note in trials.notes)
    assert not any("single samples" in note for note in Trials.from_frame(frame.assign(amt=frame["t"] > 2)).notes)


def test_a_search_refuses_amounts_that_are_given_between_measurements():
    """On lines between samples they would be an input of another shape and size."""
    frame = stacked([{"subject": i} for i in (3, 5)], conc=decay).assign(amt=0.0)
    first, later = frame["t"] == 0, frame["t"] == frame["t"][3]
    with refused("doses-in-search", name="amt"):
        cl.discover(Trials.from_frame(frame.assign(amt=100.0 * (first | later))))
    refuse_amounts(Trials.from_frame(frame.assign(amt=100.0 * first)))
    refuse_amounts(Trials.from_frame(frame.assign(pulse=100.0 * later), inputs="pulse"))


def test_data_sets_of_pharmacology_have_doses_and_no_columns_of_records(tmp_path):
    path = tmp_path / "theo.csv"
    rows = ["ID,TIME,AMT,DV,MDV,EVID"]
    for subject in (1, 2):
        rows += [f"{subject},0,320,.,1,1", *(f"{subject},{t},.,{8 / (t + subject):.3f},0,0" for t in (1, 2, 4, 8))]
    path.write_text("\n".join(rows))
    trials = Trials.read(path)
    assert (trials.schema.states, trials.schema.inputs, trials.schema.object) == (("DV",), (), "ID")
    assert [[dose.amount for dose in trial.doses] for trial in trials] == [[320.0], [320.0]]
    path.write_text(path.read_text().replace("AMT", "flow"))
    with refused("cell-value"):
        Trials.read(path, inputs="flow")


@pytest.mark.parametrize(
    "y",
    [
        decay,
        lambda t, i: np.round(decay(t, i), 1),  # a coarse sensor goes from level to level
        lambda t, i: np.maximum(decay(t, i) - 0.5 * (i + 1), 0.0),  # zero below a limit
        lambda t, i: np.cos(t + i),  # all digits of a simulation
        lambda t, i: np.round(np.cos(t + i) + RNG.normal(0, 0.01, len(t)), 3),
    ],
)
def test_what_was_measured_is_a_state(y):
    assert roles_of(stacked(pairs("rig", "run"), x=decay, y=y))[3:5] == (("x", "y"), ())


def test_standard_deviations_go_with_the_state_that_their_name_has():
    frame = pd.DataFrame({"t": T, "x": np.exp(-T), "y": np.cos(T), "sd_x": 0.1, "y err": 0.2 + 0 * T, "sigma": 1 + T})
    trials = Trials.from_frame(frame)
    assert trials.schema.noise_columns == {"x": "sd_x", "y": "y err"}
    assert trials.schema.states == ("x", "y", "sigma")
    assert Trials.from_frame(frame, noise_columns={}, properties=[]).schema.states[2:] == ("sd_x", "y err", "sigma")
    mean = pd.DataFrame({"t": T, "OD mean": np.exp(-T), "OD sd": 0.1})
    assert Trials.from_frame(mean).schema.noise_columns == {"OD mean": "OD sd"}
    assert Trials.from_frame(frame.assign(sd_x=0.0)).schema.noise_columns == {"y": "y err"}


def test_nothing_is_noted_where_nothing_is_guessed():
    frame = stacked(pairs("Ball", "Drop"), height=decay)
    assert Trials.from_frame(frame, object="Ball", trial="Drop", time="t", states="height").notes == ()
    frame.columns = ["object", "trial", "time", "x"]
    assert Trials.from_frame(frame).notes == ()


@pytest.mark.parametrize("named", [{}, {"object": "Ball"}])
def test_a_table_in_which_no_state_changes_is_refused_as_such(named):
    still = stacked(pairs("Ball", "Drop"), height=lambda t, i: 0 * t + i // 2)
    with refused("nothing-changes", verb="is"):
        Trials.from_frame(still, **named)
    assert Trials.from_frame(still, states=["height"], **named).schema.states == ("height",)


@pytest.mark.parametrize(
    "times",
    [
        np.arange(20.0),
        np.round(np.arange(20) / 3, 3),
        np.tile(np.arange(10) * 0.25, 2),
        [f"2024-03-{day:02d}" for day in range(1, 21)],
        [f"{hour:02d}:15:00" for hour in range(20)],
    ],
)
def test_dates_clocks_and_equal_steps_are_the_time_whatever_it_is_called(times):
    frame = pd.DataFrame({"czas": times, "napięcie": decay(T[:20], 0)})
    restarts = "trials" if len(set(times)) < len(times) else None
    assert Trials.from_frame(frame, restarts=restarts).schema.time == "czas"


def test_counts_of_rows_and_measurements_are_no_times():
    uneven = np.cumsum(np.linspace(1, 2, 20))
    for frame in (
        pd.DataFrame({"lp": np.arange(20), "moment": uneven, "x": decay(T[:20], 0)}),
        pd.DataFrame({"moment": uneven, "x": np.round(np.linspace(0, 5, 20) ** 0.9)}),
        pd.DataFrame({"a": np.arange(20) * 0.5, "b": np.arange(20) * 2.0}),
    ):
        with pytest.raises(CommonlawError) as raised:
            Trials.from_frame(frame)
        assert raised.value.code in ("time-missing", "time-ambiguous")


@pytest.mark.parametrize("header", ["setpoint", "Outdoor T (degC)", "T_amb", "Tenv", "solar radiation"])
def test_what_acts_from_outside_is_an_input_by_its_name(header):
    random = np.random.default_rng(0)
    columns = {"t": np.arange(40.0), "T (degC)": random.normal(20, 1, 40), header: random.normal(10, 1, 40)}
    assert Trials.from_frame(pd.DataFrame(columns)).schema.inputs == (header.removesuffix(" (degC)"),)


@pytest.mark.parametrize("name", ["Frame", "Index", "Sample", "nr", "whatever"])
@pytest.mark.parametrize("label", ["run", "ball", "Trial", None])
@pytest.mark.parametrize("first", [0, 1, 37])
def test_counters_are_neither_inputs_nor_states_nor_names(name, label, first):
    names = ("R1", "R2", "R3") if label != "Trial" else (1, 2, 3)
    labels = [{label: value} for value in names] if label else [{}]
    frame = stacked(labels, x=decay).assign(**{name: first})
    frame[name] += np.tile(np.arange(len(T)), len(labels))
    trials = Trials.from_frame(frame[[name, *frame.columns.drop(name)]])
    assert (trials.schema.states, trials.schema.inputs) == (("x",), ())
    assert len(trials) == len(labels)
    assert not any(trials.properties.values())


def test_whole_numbers_that_are_measured_are_states():
    counts = np.round(50 * np.exp(-T)) + np.arange(len(T)) % 2
    assert Trials.from_frame(pd.DataFrame({"t": T, "cells": counts, "x": decay(T, 0)})).schema.states == ("cells", "x")


def test_units_in_names_take_time_in_proportion_to_the_number_of_columns():
    names = [f"speed{i}_m_s" for i in range(4000)] + ["temp_C", "temp_C_sd", "current_A", "current_B"]
    begin = time.process_time()
    units = units_in_names(names)
    assert time.process_time() - begin < 5
    assert (units["temp_C"], "current_A" in units, len(units)) == ("degC", False, 1)
