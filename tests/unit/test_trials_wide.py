"""Tables with a column for each object, and how they are recognised."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.discovery.hints import outcomes_of_separate_states
from commonlaw.law.parameters import named_parameters
from commonlaw.trials import Trials
from commonlaw.trials.equation_columns import as_named
from tests.refusals import message, refused

HOURS = np.arange(6.0)
WELLS = {name: 0.1 * np.exp(rate * HOURS) for name, rate in (("A1", 0.3), ("A2", 0.4), ("B1", 0.5), ("B12", 0.6))}
PLATE = pd.DataFrame({"time [h]": HOURS, **WELLS})
LONG = pd.concat([pd.DataFrame({"object": name, "time [h]": HOURS, "OD [OD]": x}) for name, x in WELLS.items()])


def plate(folder, rows="", text=None):
    path = folder / "plate.csv"
    header, _, body = (text or PLATE.to_csv(index=False)).partition("\n")
    path.write_text(f"{header}\n{rows}{body}")
    return path


def test_a_plate_has_the_trials_of_a_long_table_and_is_recognised():
    trials, same = Trials.from_frame(PLATE, wide="OD [OD]"), Trials.from_frame(LONG)
    assert replace(trials.schema, wide=()) == same.schema
    assert trials.schema.wide == tuple(WELLS)
    assert trials.schema.units == {"time": "h", "OD": "OD"}
    assert [(trial.label, trial.times.tolist(), trial.states.tolist()) for trial in trials] == [
        (each.label, each.times.tolist(), each.states.tolist()) for each in same
    ]
    trials = Trials.from_frame(PLATE)
    assert (trials.objects, trials.schema.states) == (tuple(WELLS), ("value",))
    assert "state: A1, A2, ..., B12 (4 columns), each of an object" in trials.notes[0]
    assert len(Trials.from_frame(PLATE, states=list(WELLS))) == 1
    assert Trials.from_frame(PLATE, wide=True).schema == trials.schema


@pytest.mark.parametrize(
    ("names", "wide"),
    [
        (["rat 1", "rat 2", "rat 3"], True),
        (["Temp rep1", "Temp rep2", "Temp rep3"], True),
        (["pos1", "pos2", "pos3"], False),
        (["OD A1", "OD A2", "OD B1", "OD B2"], True),
        (["A1", "A2"], True),
        (["25 °C", "35 °C"], True),
        (["0.5 mg/L", "1 mg/L", "2 mg/L"], True),
        (["10 cm", "20 cm", "30 cm"], False),
        (["25 °C", "35 K"], False),
        (["theta_1", "theta_2", "omega_1", "omega_2"], False),
        (["pos_1", "vel_1", "pos_2", "vel_2"], False),
        (["tank_1", "tank_2", "tank_3"], True),
        (["Cup A", "Cup B"], True),
        (["pos_x", "pos_y"], False),
        (["temp in", "temp out"], False),
        (["prey_1", "prey_2", "hunter_1", "hunter_2"], False),
        (["C1", "C2", "C3", "C4"], True),
        ([f"C{i}" for i in range(1, 9)], True),
        (["prey", "predator", "grass"], False),
        (["x1", "x2", "x3", "x4", "x5"], False),
    ],
)
def test_columns_of_replicates_are_objects_and_states_are_not(names, wide):
    frame = pd.DataFrame({"t": HOURS, **{name: (i + 1) * np.exp(-HOURS) for i, name in enumerate(names)}})
    trials = Trials.from_frame(frame)
    assert trials.objects == (tuple(names) if wide else ("object",))
    assert trials.schema.states == (("OD" if "OD" in names[0] else "value",) if wide else tuple(names))


def test_columns_of_a_single_word_are_replicates_where_they_nearly_agree():
    noise = np.random.default_rng(0).normal(0, 0.01, (6, 3))
    frame = pd.DataFrame({"t": HOURS, **{f"WT_{i + 1}": np.exp(-HOURS) + noise[:, i] for i in range(3)}})
    assert Trials.from_frame(frame).objects == ("WT_1", "WT_2", "WT_3")
    two = frame.assign(mut_1=0.5 * frame["WT_1"], mut_2=0.5 * frame["WT_2"])
    assert Trials.from_frame(two).objects == ("WT_1", "WT_2", "WT_3", "mut_1", "mut_2")
    assert Trials.from_frame(frame.assign(WT_3=2 * frame["WT_3"])).objects == ("WT_1", "WT_2", "WT_3")
    blanks = {f"blank_{i + 1}": 0.05 + 0.1 * noise[:, i] for i in range(2)}
    assert len(Trials.from_frame(two.assign(**blanks)).objects) == 7


def test_columns_of_standard_deviations_go_with_those_of_the_same_number():
    deviations = {f"std{i}": 0.01 * i + 0 * HOURS for i in range(1, 5)}
    curves = {f"G{i}": 1 - np.exp(-i * HOURS) for i in range(1, 5)}
    trials = Trials.from_frame(pd.DataFrame({"t": HOURS, **curves, **deviations}))
    assert trials.objects == ("G1", "G2", "G3", "G4")
    assert trials.schema.noise_columns == {"value": "value noise"}
    assert [trial.noise[0, 0] for trial in trials] == [0.01, 0.02, 0.03, 0.04]
    frame = pd.DataFrame({"t": HOURS, **curves, **deviations}).drop(columns="std3")
    with refused("wide-without-deviations", columns="G3"):
        Trials.from_frame(frame, wide="G")
    assert Trials.from_frame(frame, wide="G", states=list(curves), noise_columns={}).schema.noise_columns == {}


@pytest.mark.parametrize(
    ("names", "hinted"),
    [
        (["x 1", "x 2", "x 3", "x 4"], True),
        (["x1", "x2", "x3"], False),
        (["x", "y", "z", "w"], False),
        (list("abcdefgh"), True),
    ],
)
def test_columns_that_may_be_objects_are_hinted_at(names, hinted):
    frame = pd.DataFrame({"t": HOURS, **{name: HOURS + i for i, name in enumerate(names)}})
    trials = Trials.from_frame(frame)
    assert trials.schema.states == tuple(names)
    assert any("if each is an object of its own, read them with `wide=" in note for note in trials.notes) == hinted


def test_rows_ahead_of_the_times_are_properties(tmp_path):
    path = plate(tmp_path, "glucose,1,2,1,2\nstrain,wt,wt,mut,mut\n")
    trials = Trials.read(path, wide="OD")
    assert trials.properties["A2"] == {"glucose": 2.0, "strain": "wt"}
    assert trials.properties["B1"] == {"glucose": 1.0, "strain": "mut"}
    assert trials[3].states[:, 0] == pytest.approx(WELLS["B12"])


def test_other_columns_and_units_are_those_of_all_objects():
    frame = PLATE.assign(temperature=37 + 0.1 * HOURS, plate="P")
    trials = Trials.from_frame(frame, wide="OD", inputs="temperature")
    assert trials.schema.inputs == ("temperature",)
    assert all(trial.inputs[:, 0].tolist() == frame["temperature"].tolist() for trial in trials)
    assert trials.properties["A1"] == {"plate": "P"}
    frame = PLATE.rename(columns={name: f"{name} [mg/L]" for name in WELLS})
    assert Trials.from_frame(frame, wide="mass").schema.units["mass"] == "mg/L"
    with refused("wide-units"):
        Trials.from_frame(frame.rename(columns={"A1 [mg/L]": "A1 [g/L]"}), wide="mass")


def test_gaps_and_errors_are_told_by_row_and_column(tmp_path):
    text = PLATE.to_csv(index=False)
    cell = text.splitlines()[3].split(",")[2]
    notes = Trials.read(plate(tmp_path, text=text.replace(cell, "")), wide="OD").notes
    assert notes[-1:] == ("rows without a measured state left out: A2, trial 1: 1 (row 3 (line 4), column 'A2')",)
    with refused("cell-not-a-number", cell="lost"):
        Trials.read(plate(tmp_path, text=text.replace(cell, "lost")), wide="OD")


@pytest.mark.parametrize(
    ("frame", "roles", "expected"),
    [
        (PLATE.assign(object="P"), {"wide": "OD"}, message("wide-with-object", column="object")),
        (PLATE, {"wide": "time"}, message("wide-name-taken", name="time")),
        (PLATE, {"wide": 5}, message("argument-type", name="wide")),
        (PLATE[["time [h]"]].assign(word="a"), {"wide": "OD"}, "no-state"),
    ],
)
def test_what_cannot_be_read_so_is_refused(frame, roles, expected):
    with refused(expected):
        Trials.from_frame(frame, **roles)


def test_an_equation_names_the_quantity_of_a_guessed_wide_table_and_another_than_the_given_one_is_refused():
    assert as_named(Trials.from_frame(PLATE), ["OD"]).schema.states == ("OD",)
    with refused("columns-of-objects", name="OD"):
        cl.fit("OD' = r OD", Trials.from_frame(PLATE, wide="N"))
    both = Trials.from_frame(PLATE[["time [h]", "A1", "A2"]])
    with refused("equation-or-input"):
        cl.fit("A1' = r A1 + b A2", both)


@pytest.mark.parametrize(
    ("header", "objects"),
    [
        ("Run 1: Time (s),Run 1: x (m),Run 2: Time (s),Run 2: x (m)", ("Run 1", "Run 2")),
        ("Time (s) Run #1,x (m) Run #1,Time (s) Run #2,x (m) Run #2", ("Run #1", "Run #2")),
        ("t (s),x (m),t (s),x (m)", ("1", "2")),
        ("time_1 [s],x_1 [m],time_2 [s],x_2 [m]", ("1", "2")),
    ],
)
def test_runs_with_times_next_to_each_other_are_an_object_each(tmp_path, header, objects):
    path = tmp_path / "runs.csv"
    path.write_text(f"{header}\n0,1.0,0,2.0\n0.1,1.1,0.2,2.2\n0.2,1.3,0.4,2.5\n0.3,1.4,,\n")
    trials = Trials.read(path)
    assert (trials.objects, trials.schema.states) == (objects, ("x",))
    assert [trial.times.tolist() for trial in trials] == [[0.0, 0.1, 0.2, 0.3], [0.0, 0.2, 0.4]]
    assert {*trials.schema.units.values()} == {"s", "m"}


def test_runs_that_differ_in_what_was_measured_are_not_read(tmp_path):
    path = tmp_path / "runs.csv"
    path.write_text("Run 1: Time (s),Run 1: x (m),Run 2: Time (s),Run 2: y (m)\n0,1,0,2\n1,1,1,3\n")
    with refused("time-ambiguous"):
        Trials.read(path)


def test_inputs_of_all_objects_are_no_object_of_a_wide_table():
    cups = {f"{name} (degC)": 20 + np.exp(-rate * HOURS) for name, rate in (("mug", 1), ("paper", 2), ("control", 3))}
    power = np.repeat([0.0, 5.0], 3)
    table = {"time (h)": HOURS, **cups, "Ambient (degC)": 20 + 0.01 * HOURS**0.5, "power (W)": power}
    trials = Trials.from_frame(table, wide="T")
    assert (trials.objects, trials.schema.inputs) == (("mug", "paper", "control"), ("Ambient", "power"))


@pytest.mark.parametrize(
    ("equations", "codes"),
    [
        ("x' = 1 - 2 x; y' = 1 - 3 y", ["states-separate"]),
        ("x'' = -x - 0.1 v_x; y'' = -2 y - 0.3 v_y", ["states-separate"]),
        ("x' = 1 - 2 x; y' = 1 - 3 y^2", []),
        ("x' = -x; y' = -x", []),
        ("x'' = 1; y'' = 2", []),
    ],
)
def test_states_with_the_same_law_each_may_be_objects(equations, codes):
    law = cl.Law.from_text(equations)
    units = {"x": "degC", "y": "degC"}
    assert [
        note.code for note in outcomes_of_separate_states(replace(law, schema=replace(law.schema, units=units)))
    ] == codes
    units = {"x": "degC", "y": "m"}
    assert outcomes_of_separate_states(replace(law, schema=replace(law.schema, units=units))) == ()


def cooled(rates, samples=16):
    times, random = np.arange(samples) * 2.0, np.random.default_rng(5)
    columns = {
        name: (21 + 60 * np.exp(-rate * times) + random.normal(0, 0.2, samples)).round(1)
        for name, rate in rates.items()
    }
    return pd.DataFrame({"minutes": times, **columns})


def test_letters_with_an_index_are_objects_and_called_by_the_letter():
    trials = Trials.from_frame(cooled({"T1": 0.08, "T2": 0.05}).assign(Tamb=21.0))
    assert (trials.objects, trials.schema.states) == (("T1", "T2"), ("T",))
    law = cl.fit("T' = -k (T - 21)", trials, errors="white")
    np.testing.assert_allclose(named_parameters(law).values[:, 0], [0.08, 0.05], rtol=0.02)
    assert len(Trials.from_frame(cooled({"T1": 0.08, "T2": 0.05}), object="")) == 1


@pytest.mark.parametrize("noise", [1e-6, 0.01])
@pytest.mark.parametrize(
    ("equations", "start"),
    [
        ("a' = a - 0.7 a b; b' = 0.5 a b - 0.8 b", [1.0, 1.0]),
        ("a'' = -a + 0.3 b; b'' = -1.2 b + 0.3 a", [1.0, 0.0, 0.0, 0.0]),
    ],
)
def test_columns_of_one_stem_that_act_on_each_other_are_states(equations, start, noise):
    times = np.linspace(0, 20, 60)
    (curve,) = cl.Law.from_text(equations).simulate(times, start).values()
    values = curve.states[:, :2] + noise * np.random.default_rng(0).normal(0, 1, (60, 2))
    frame = pd.DataFrame({"t": times, "species 1": values[:, 0], "species 2": values[:, 1]})
    trials = Trials.from_frame(frame)
    assert trials.schema.states == ("species 1", "species 2")
    assert any("`wide='value'`" in note for note in trials.notes)
    assert Trials.from_frame(frame, wide="N").objects == ("species 1", "species 2")


@pytest.mark.parametrize("noise", [0.0, 0.003, 0.03])
def test_growth_curves_of_one_stem_do_not_act_on_each_other(noise):
    times, random = np.linspace(0, 20, 30), np.random.default_rng(1)
    curves = [1 / (1 + 40 * np.exp(-rate * times)) + random.normal(0, noise, 30) for rate in (0.5, 0.7, 0.6)]
    trials = Trials.from_frame(pd.DataFrame({"t": times, **{f"species {i}": x for i, x in enumerate(curves, 1)}}))
    assert trials.objects == ("species 1", "species 2", "species 3")


def test_equations_in_the_columns_take_them_for_states():
    trials = Trials.from_frame(cooled({"T1": 0.08, "T2": 0.05}))
    law = cl.fit("T1' = -k (T1 - 21); T2' = -h (T2 - 21)", trials, errors="white")
    assert law.schema.states == ("T1", "T2")
    np.testing.assert_allclose(named_parameters(law).values[0], [0.08, 0.05], rtol=0.02)
    assert law.predict(trials).score() > 0.99
    with refused("equations-of-other-states"):
        cl.fit("T1' = -k (T1 - T2)", trials)


def test_a_letter_that_is_a_column_of_a_guessed_property_is_asked_about():
    frame = pd.concat([cooled({"T": k}).assign(cup=f"c{i}", k=i) for i, k in enumerate((0.05, 0.08, 0.07), 1)])
    trials = Trials.from_frame(frame)
    with refused("letter-of-column", name="k"):
        cl.fit("T' = -k (T - 21)", trials)
    declared = Trials.from_frame(frame, properties="k")
    for taken, equation in ((declared, "k"), (trials, "`k`"), (trials, "{k}")):
        assert not cl.fit(f"T' = -{equation} (T - 21)", taken, errors="white").uncertainty.covariance.any()
    in_trials = Trials.from_frame(frame.drop(columns="cup").assign(run=frame["k"] + 1), object="")
    assert in_trials.schema.inputs == ("k",)
    with refused("letter-of-column", name="k"):
        cl.fit("T' = -k (T - 21)", in_trials)
    word = Trials.from_frame(frame.rename(columns={"k": "rate"}))
    assert as_named(word, ["T"], "T' = -rate (T - 21)") is word


def test_a_column_that_is_not_read_is_no_parameter():
    frame = cooled({"T": 0.05}).assign(note=lambda table: np.where(np.arange(len(table)) % 2, "ok", "bad"))
    with refused("column-of-text-in-equation", name="note"):
        cl.fit("T' = -note (T - 21)", Trials.from_frame(frame, states="T"))
    left_out = Trials.from_frame(frame.assign(note=np.arange(len(frame)) % 7), states="T")
    with refused("column-left-out-in-equation", name="note"):
        cl.fit("T' = -note (T - 21)", left_out)
    assert as_named(left_out, ["T"], "T' = -k T") is left_out
    with_rates = Trials.from_frame(frame.assign(v=frame["T"].diff().fillna(0.0)), states="T")
    assert as_named(with_rates, ["T"], "T'' = -k v") is with_rates
    trials = Trials.from_frame(frame.rename(columns={"note": "exp"}), states="T")
    assert as_named(trials, ["T"], "T' = exp(-k t)") is trials
