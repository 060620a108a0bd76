"""Long tables: a column that names quantities, and one with their values."""

import numpy as np
import pytest

from commonlaw.trials import Trials
from tests.refusals import refused
from tests.unit.tables import text

TIMES = [0.0, 0.5, 1.0, 2.0, 4.0]
VALUES = {
    (owner, name): [round(size * np.exp(-rate * t), 4) for t in TIMES]
    for owner, rate in (("Anna", 0.5), ("Ben", 0.9))
    for name, size in (("drug", 5.0), ("metabolite", 0.8))
}


def rows(header, line, by_time=False):
    lines = [
        (t, line(owner, name, t, x)) for (owner, name), xs in VALUES.items() for t, x in zip(TIMES, xs, strict=True)
    ]
    ordered = sorted(lines, key=lambda pair: pair[0]) if by_time else lines
    return "\n".join([header, *(line for _, line in ordered)]) + "\n"


def check(trials, names=("drug", "metabolite")):
    assert (trials.objects, trials.schema.states) == (("Anna", "Ben"), names)
    for trial in trials:
        assert trial.times.tolist() == TIMES
        assert trial.states.T.tolist() == [VALUES[trial.object, name] for name in ("drug", "metabolite")]


@pytest.mark.parametrize("by_time", [False, True])
def test_quantities_that_a_column_names_become_states(tmp_path, by_time):
    content = rows(
        "subject,time [h],analyte,conc [mg/L]", lambda *cells: f"{cells[0]},{cells[2]},{cells[1]},{cells[3]}", by_time
    )
    trials = Trials.read(text(tmp_path / "blood.csv", content))
    check(trials)
    assert trials.schema.units == {"time": "h", "drug": "mg/L", "metabolite": "mg/L"}
    assert any(note.startswith("read as a long table: drug, metabolite in analyte") for note in trials.notes)


def test_units_properties_deviations_and_remarks_go_with_their_quantities(tmp_path):
    def line(owner, name, t, x):
        unit = {"drug": "mg/L", "metabolite": "nmol/L"}[name]
        return f"{owner},{60 if owner == 'Anna' else 80},{t},{name},{x},{0.1 * len(name)},{unit},kit {name[0]}"

    content = rows("subject,weight [kg],time [h],analyte,value,value_sd,unit,kit", line)
    trials = Trials.read(text(tmp_path / "blood.csv", content))
    check(trials)
    assert trials.schema.units == {"time": "h", "drug": "mg/L", "metabolite": "nmol/L", "weight": "kg"}
    assert trials.properties["Ben"] == {"weight": 80}
    assert {*trials[0].noise[:, 0].tolist()} == {0.4}
    assert {*trials[0].noise[:, 1].tolist()} == {1.0}
    assert any("differ between quantities: kit" in note for note in trials.notes)
    with refused("long-table-units", quantity="drug"):
        Trials.read(
            text(
                tmp_path / "b.csv",
                content.replace("nmol/L", "mg/L").replace("4.0,drug,0.6767,0.4,mg/L", "4.0,drug,0.6767,0.4,g/L"),
            )
        )


def test_numbers_of_quantities_stand_behind_the_name_of_their_values(tmp_path):
    kinds = {"drug": 1, "metabolite": 2}
    content = rows("id,time,y,dvid", lambda owner, name, t, x: f"{owner},{t},{x},{kinds[name]}")
    check(Trials.read(text(tmp_path / "pk.csv", content)), ("y1", "y2"))


def test_quantities_at_other_times_and_repeated_measurements_are_kept(tmp_path):
    lines = ["0,a,1", "0,b,5", "1,a,2", "1.5,b,6", "2,a,3", "2,a,5", "2,b,7"]
    trials = Trials.read(text(tmp_path / "a.csv", "\n".join(["time,quantity,value", *lines])))
    assert trials[0].times.tolist() == [0, 1, 1.5, 2]
    assert np.array_equal(trials[0].states.T, [[1, 2, np.nan, 4], [5, np.nan, 6, 7]], equal_nan=True)
    assert any("averaged" in note for note in trials.notes)


PETAB = (
    "observableId\tpreequilibrationConditionId\tsimulationConditionId\tmeasurement\ttime\tobservableParameters"
    "\tnoiseParameters"
)


def test_the_measurements_of_a_petab_problem_are_trials_of_one_object(tmp_path):
    content = rows(PETAB, lambda owner, name, t, x: f"{name}\t\t{owner}\t{x}\t{t}\t\tsd_{name}")
    trials = Trials.read(text(tmp_path / "measurements.tsv", content))
    assert trials.objects == ("measurements",)
    assert [trial.name for trial in trials] == ["Anna", "Ben"]
    assert trials.schema.states == ("drug", "metabolite")
    for trial in trials:
        assert trial.states.T.tolist() == [VALUES[trial.name, name] for name in ("drug", "metabolite")]
    assert "noiseParameters" in "; ".join(trials.notes)
    objects = Trials.read(tmp_path / "measurements.tsv", object="simulationConditionId")
    assert objects.objects == ("Anna", "Ben")
    starved = rows(PETAB, lambda owner, name, t, x: f"{name}\tstarved\t{owner}\t{x}\t{t}\t\tsd_{name}")
    both = Trials.read(text(tmp_path / "b.tsv", starved))
    assert [trial.name for trial in both] == ["starved, Anna", "starved, Ben"]


def test_replicates_of_a_petab_problem_are_trials_and_names_of_data_sets_are_left_out(tmp_path):
    lines = [
        f"{name}\tc{condition}\t{t}\t{t + condition + size + 0.01 * replicate:.3f}\td{name}{condition}\tr{replicate}"
        for size, name in enumerate("pq") for condition in (1, 2) for replicate in (1, 2) for t in range(5)
    ]  # fmt: skip
    header = "observableId\tsimulationConditionId\ttime\tmeasurement\tdatasetId\treplicateId"
    trials = Trials.read(text(tmp_path / "a.tsv", "\n".join([header, *lines])))
    assert [trial.name for trial in trials] == ["c1, r1", "c1, r2", "c2, r1", "c2, r2"]
    assert trials[3].states[:, 1].tolist() == [3.02, 4.02, 5.02, 6.02, 7.02]


def test_quantities_below_doses_are_states_too(tmp_path):
    rows = [
        "1,0,100,,",
        *(f"1,{t},,{name},{size / (1 + t):.3f}" for t in (1, 2, 4) for name, size in (("a", 9), ("b", 2))),
    ]
    trials = Trials.read(text(tmp_path / "pk.csv", "\n".join(["id,time,amt,analyte,conc [mg/L]", *rows])))
    assert trials.schema.states == ("a", "b")
    assert trials[0].states.tolist() == [[4.5, 1.0], [3.0, 0.667], [1.8, 0.4]]
    assert [dose.amount for dose in trials[0].doses] == [100]
    assert trials.schema.units["b"] == "mg/L"


def test_what_names_quantities_may_also_name_objects_if_that_is_said(tmp_path):
    content = rows("subject,time,analyte,conc", lambda *cells: f"{cells[0]},{cells[2]},{cells[1]},{cells[3]}")
    path = text(tmp_path / "blood.csv", content)
    assert Trials.read(path, object="analyte", trial="subject").objects == ("drug", "metabolite")
    assert Trials.read(path, object="subject", trial="analyte", states=["conc"]).schema.states == ("conc",)


def test_several_columns_of_values_are_refused(tmp_path):
    content = rows(
        "subject,time,analyte,p,q", lambda *cells: f"{cells[0]},{cells[2]},{cells[1]},{cells[3]},{cells[3] ** 2:.4f}"
    )
    with refused("long-table-values", column="analyte", values=["p", "q"]):
        Trials.read(text(tmp_path / "a.csv", content))


def test_what_may_be_sensors_are_states_if_these_are_named(tmp_path):
    content = rows("subject,time,channel,value", lambda *cells: f"{cells[0]},{cells[2]},{cells[1]},{cells[3]}")
    path = text(tmp_path / "logger.csv", content)
    check(Trials.read(path, states=["drug", "metabolite"]))
    only = rows("time,channel,value", lambda *cells: f"{cells[2]},{cells[1]},{cells[3]}").splitlines()[:11]
    with refused("long-table", column="channel", names=["drug", "metabolite"]):
        Trials.read(text(tmp_path / "one.csv", "\n".join(only)))
    assert Trials.read(tmp_path / "one.csv", object="channel").objects == ("drug", "metabolite")
    assert (
        Trials.read(tmp_path / "one.csv", states=["metabolite"])[0].states[:, 0].tolist()
        == VALUES["Anna", "metabolite"]
    )
