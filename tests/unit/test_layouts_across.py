"""Runs, pairs and points next to each other in columns."""

import numpy as np
import pytest

from commonlaw.trials import Trials
from tests.refusals import refused
from tests.unit.tables import text, workbook

TIMES = np.round(np.arange(30) * 0.1, 3)
RATES = {"A": 1.0, "B": 0.5, "C": 0.2}
NOISE = np.random.default_rng(0).standard_normal((3, 30))
DECAYS = {name: np.round(np.exp(-rate * TIMES) + 0.01 * NOISE[i], 4) for i, (name, rate) in enumerate(RATES.items())}


def table(header, columns):
    return header + "\n" + "".join(",".join(map(str, row)) + "\n" for row in zip(*columns, strict=True))


def pairs(header):
    return table(header, [column for values in DECAYS.values() for column in (TIMES, values)])


@pytest.mark.parametrize(
    ("header", "objects", "state"),
    [
        ("t1,x1,t2,x2,t3,x3", ("1", "2", "3"), "x"),
        ("t,x,t,x,t,x", ("1", "2", "3"), "x"),
        ("t,x,t.1,x.1,t.2,x.2", ("1", "2", "3"), "x"),
        ("time A,OD A,time B,OD B,time C,OD C", ("A", "B", "C"), "OD"),
        ("time (s) wild type,OD wild type,time (s) mutA,OD mutA,time (s) mutB,OD mutB", (), "OD"),
        ("A time,A OD,B time,B OD,C time,C OD", ("A", "B", "C"), "OD"),
        ("Cup A,,Cup B,,Cup C,\nX,Y,X,Y,X,Y", ("Cup A", "Cup B", "Cup C"), "Y"),
        ("Cup A,,Cup B,,Cup C,\nt [s],x [m],t [s],x [m],t [s],x [m]", ("Cup A", "Cup B", "Cup C"), "x"),
        ("A,,B,,C,\nt,x,t,x,t,x\ns,m,s,m,s,m", ("A", "B", "C"), "x"),
    ],
)
def test_runs_with_times_of_their_own_are_objects(tmp_path, header, objects, state):
    trials = Trials.read(text(tmp_path / "runs.csv", pairs(header)))
    assert trials.objects == (objects or ("wild type", "mutA", "mutB"))
    assert trials.schema.states == (state,)
    for trial, values in zip(trials, DECAYS.values(), strict=True):
        assert trial.times.tolist() == TIMES.tolist()
        assert trial.states[:, 0].tolist() == values.tolist()
    units = {"t": "s", "x": "m"} if "m" in header and "s" in header and "OD" not in header else {}
    assert trials.schema.units == (units or ({"time": "s"} if "(s)" in header else {}))


def test_pairs_of_other_quantities_are_objects_or_states_as_is_said(tmp_path):
    path = text(tmp_path / "pairs.csv", pairs("time [h],WT,time [h],mutA,time [h],mutB"))
    with refused("pairs-ambiguous", states=["WT", "mutA", "mutB"]):
        Trials.read(path)
    objects = Trials.read(path, wide="OD [OD]")
    assert (objects.objects, objects.schema.states) == (("WT", "mutA", "mutB"), ("OD",))
    assert objects.schema.units == {"time": "h", "OD": "OD"}
    states = Trials.read(path, states=["WT", "mutA", "mutB"])
    assert states[0].states.T.tolist() == [values.tolist() for values in DECAYS.values()]


def test_pairs_in_different_units_are_states_at_their_own_times(tmp_path):
    header, late = "time [h],glucose [g/L],time [h],OD,time [h],T [°C]", np.round(TIMES + 0.05, 3)
    columns = (TIMES, DECAYS["A"], late, DECAYS["B"], TIMES, DECAYS["C"])
    trials = Trials.read(text(tmp_path / "reactor.csv", table(header, columns)))
    assert (len(trials), trials.schema.states) == (1, ("glucose", "OD", "T"))
    assert trials[0].times.tolist() == sorted({*TIMES.tolist(), *late.tolist()})
    for values, measured in zip(DECAYS.values(), trials[0].states.T, strict=True):
        assert measured[np.isfinite(measured)].tolist() == values.tolist()
    assert trials.schema.units == {"time": "h", "glucose": "g/L", "T": "°C"}


def tracked(first, second):
    lines = ["#multi:", "\tcm A\t\tcm B\t\t\t", "t\tx\ty\tx\ty\t"]
    lines += ["\t".join(map(str, row)) for row in zip(TIMES, *first, *second, strict=True)]
    return "\n".join(lines) + "\n"


FALL = np.round(5 - 4.9 * TIMES**2 + 0.001 * NOISE[0], 4)


def test_points_of_tracker_at_common_times_are_objects_or_states(tmp_path):
    first, second = (np.round(1.3 * TIMES, 4), FALL), (np.round(7 - 0.4 * TIMES, 4), np.round(FALL + TIMES, 4))
    path = text(tmp_path / "pucks.txt", tracked(first, second))
    trials = Trials.read(path, states=["x", "y"])
    assert (trials.objects, trials.schema.states) == (("cm A", "cm B"), ("x", "y"))
    assert trials[1].states.T.tolist() == [values.tolist() for values in second]
    assert "read as 2 points, cm A, cm B, each an object" in "; ".join(trials.notes)
    one = Trials.read(path, object="", states=["x_cm_A", "y_cm_A", "x_cm_B", "y_cm_B"])
    assert one[0].states.T.tolist() == [values.tolist() for values in (*first, *second)]


def test_points_that_act_on_each_other_are_states_of_one_object(tmp_path):
    sums, differences = np.cos(3 * TIMES), np.cos(5.2 * TIMES)  # Two masses with a spring between them
    noise = 1e-3 * NOISE
    first, second = ((sums + differences) / 2 + noise[0], sums + noise[1]), ((sums - differences) / 2 + noise[2], sums)
    rounded = [[np.round(values, 4) for values in point] for point in (first, second)]
    path = text(tmp_path / "masses.txt", tracked(*rounded))
    trials = Trials.read(path)
    assert len(trials.objects) == 1
    assert {"x_cm_A", "x_cm_B"} <= {*trials.schema.states}
    assert Trials.read(path, object="point").objects == ("cm A", "cm B")


def test_groups_of_columns_in_a_sheet_are_points_too(tmp_path):
    header = [["", "left", "", "right", ""], ["t [s]", "x [m]", "v [m/s]", "x [m]", "v [m/s]"]]
    columns = (TIMES, DECAYS["A"], DECAYS["B"], DECAYS["C"], DECAYS["A"] + 1)
    rows = [[*map(float, row)] for row in zip(*columns, strict=True)]
    trials = Trials.read(workbook(tmp_path / "a.xlsx", {"A": [*header, *rows]}), object="point", states=["x", "v"])
    assert trials.objects == ("left", "right")
    assert trials.schema.units == {"t": "s", "x": "m", "v": "m/s"}
