"""Workbooks of several sheets: objects, quantities, and what is no measurement."""

import numpy as np
import pytest

from commonlaw.trials import Trials
from tests.refusals import refused
from tests.unit.tables import workbook

TIMES = [0.0, 0.5, 1.0, 1.5]
INFO = [["Date", "2024-02-11"], ["Operator", "Anna"], ["Room", 12]]
DEVICE = [["property", "value"], ["version", "1.1.9"], ["deviceModel", "X"]]
CLOCK = [
    ["event", "experiment time", "system time", "system time text"],
    ["START", 0.0, 1.6e9, "2020-09-13 12:26:40"],
    ["PAUSE", 1.5, 1.6e9 + 1.5, "2020-09-13 12:26:41"],
]


def sheet(header, values, times=TIMES):
    return [["Time (s)", header], *([t, x] for t, x in zip(times, values, strict=True))]


def test_sheets_of_objects_are_read_without_those_that_hold_no_times(tmp_path):
    cups = {f"Cup {name}": sheet("T (°C)", [80 - i, 70, 62, 55]) for i, name in enumerate("ABC")}
    masses = [["cup", "mass [kg]"], ["Cup A", 1.0], ["Cup B", 2.0]]
    path = workbook(tmp_path / "cups.xlsx", {"Info": INFO, **cups, "Masses": masses, "Notes": [["stirred"]]})
    trials = Trials.read(path)
    assert trials.objects == ("Cup A", "Cup B", "Cup C")
    assert [trial.states[0, 0] for trial in trials] == [80, 79, 78]
    assert trials.schema.units == {"Time": "s", "T": "°C"}
    assert any("3 sheets left out: Info, Masses, Notes" in note for note in trials.notes)
    assert any(note.startswith("read as 3 sheets") for note in trials.notes)
    assert len(Trials.read(path, sheet="Cup B")) == 1


def test_a_measurement_of_phyphox_is_read_without_its_metadata(tmp_path):
    sheets = {"Raw Data": sheet("Acceleration x (m/s^2)", [1.0, 0.5, 0.2, 0.1])}
    path = workbook(tmp_path / "spring.xlsx", {**sheets, "Metadata Device": DEVICE, "Metadata Time": CLOCK})
    trials = Trials.read(path)
    assert trials.schema.units == {"Time": "s", "Acceleration x": "m/s^2"}
    assert trials[0].times.tolist() == TIMES
    assert any("left out: Metadata Device, Metadata Time" in note for note in trials.notes)


@pytest.mark.parametrize("shift", [0.0, 0.25])
def test_quantities_in_sheets_of_their_own_are_states_at_the_times_of_each(tmp_path, shift):
    later = [t + shift for t in TIMES]
    heights, speeds = sheet("Height (m)", [4.0, 3.0, 1.0, 0.0]), sheet("Velocity (m/s)", [0, -3, -5, -2], later)
    sheets = {"Height": heights, "Velocity": speeds, "Metadata Device": DEVICE, "Metadata Time": CLOCK}
    trials = Trials.read(workbook(tmp_path / "lift.xlsx", sheets))
    assert (len(trials), trials.schema.states) == (1, ("Height", "Velocity"))
    assert trials[0].times.tolist() == sorted({*TIMES, *later})
    heights, speeds = trials[0].states.T
    assert heights[np.isfinite(heights)].tolist() == [4, 3, 1, 0]
    assert speeds[np.isfinite(speeds)].tolist() == [0, -3, -5, -2]
    assert bool(np.isnan(heights).any()) == bool(shift)


def test_sheets_that_may_be_objects_or_quantities_are_refused_with_the_option_that_decides(tmp_path):
    sheets = {"first": sheet("a (m)", [1, 2, 3, 4]), "second": sheet("b (m)", [1, 2, 3, 5])}
    with refused("workbook-sheets"):
        Trials.read(workbook(tmp_path / "a.xlsx", sheets))
    assert Trials.read(tmp_path / "a.xlsx", sheet="second").schema.states == ("b",)


def test_sheets_are_trials_by_their_names_or_as_is_said(tmp_path):
    values = {"golf 1": [1, 2, 3, 4], "golf 2": [1, 3, 5, 7], "tennis 1": [0, 1, 4, 9]}
    path = workbook(tmp_path / "a.xlsx", {name: sheet("x (m)", column) for name, column in values.items()})
    assert [trial.label for trial in Trials.read(path)] == ["golf, trial 1", "golf, trial 2", "tennis, trial 1"]
    path = workbook(
        tmp_path / "b.xlsx", {"Sheet1": sheet("x (m)", [1, 2, 3, 4]), "Sheet2": sheet("x (m)", [1, 3, 5, 7])}
    )
    assert Trials.read(path).objects == ("Sheet1", "Sheet2")
    assert [trial.label for trial in Trials.read(path, object="", trial="object")] == [
        "b, trial Sheet1",
        "b, trial Sheet2",
    ]
