"""Plates of wells, as readers of microplates write them."""

import datetime

import numpy as np
import pytest

from commonlaw.trials import Trials
from tests.refusals import refused
from tests.unit.tables import text, workbook

SECONDS = [600.0 * i for i in range(6)]
WELLS = ["A1", "A2", "B1", "B12"]
DENSITIES = {well: [round(0.05 * (2 + i) ** (t / 1500), 4) for t in SECONDS] for i, well in enumerate(WELLS)}
LIGHT = {well: [round(100 + 50 * x, 3) for x in DENSITIES[well]] for well in WELLS}
DEGREES = [37.0, 37.1, 37.0, 37.0, 37.1, 37.0]
SETTINGS = [
    ["Application: Tecan i-control", "", "", "", "Tecan i-control, 1.11.1.0"],
    ["Date:", "2024-02-11"],
    [],
    ["Kinetic duration", "", "", "", 1, "h"],
    ["Mode", "", "", "", "Absorbance"],
    ["Wavelength", "", "", "", 600, "nm"],
    ["Start Time:", "2024-02-11 15:12:11"],
    [],
]


def clock(seconds):
    return f"{int(seconds) // 3600}:{int(seconds) // 60 % 60:02d}:{int(seconds) % 60:02d}"


def down(values, time="", times=(), others=(), wells=WELLS):
    """Return rows of a block with wells down and times across."""
    return [[time, *times], *others, *([well, *values[well]] for well in wells)]


def across(values, title, time=clock, degrees=None):
    """Return rows of a block with wells across and times down."""
    rows = zip(SECONDS, degrees or DEGREES, *values.values(), strict=True)
    return [["Time", f"T° {title}", *WELLS], *([time(t), *cells] for t, *cells in rows)]


def tecan(title, values):
    others = [["Temp. [°C]", *DEGREES]]
    return [[title], ["Cycle Nr.", *range(1, 7)], *down(values, "Time [s]", SECONDS, others), []]


def lines(rows, separator=","):
    return "".join(separator.join(map(str, row)) + "\n" for row in rows)


def check(trials, states=("value",), unit="s"):
    assert trials.objects == tuple(WELLS)
    assert trials.schema.states == states
    scale = {"s": 1, "min": 60}[unit]
    for trial in trials:
        assert trial.times.tolist() == [t / scale for t in SECONDS]
        assert trial.states[:, 0].tolist() == DENSITIES[trial.object]
    assert trials.schema.units[trials.schema.time] == unit


@pytest.mark.parametrize(
    ("head", "times", "unit"),
    [
        ("Well", [f"{t:.0f}s" for t in SECONDS], "s"),
        ("", [f"{t:.0f}s" for t in SECONDS], "s"),
        ("", [f"{t / 60:.0f} min" for t in SECONDS], "min"),
        ("Well", [clock(t) for t in SECONDS], "s"),
        ("Time [min]", [f"{t / 60:.0f}" for t in SECONDS], "min"),
        ("Well", [f"0 h {t // 60:.0f} min" for t in SECONDS], "s"),
    ],
)
def test_wells_down_and_times_across_are_read_whatever_the_times_look_like(tmp_path, head, times, unit):
    trials = Trials.read(text(tmp_path / "plate.csv", lines(down(DENSITIES, head, times))))
    check(trials, unit=unit)
    assert any("read as" in note for note in trials.notes)


def test_a_utf_16_text_of_a_reader_has_temperatures_that_are_left_out_by_name_or_an_input(tmp_path):
    others = [["", *(f"{degrees:.1f} °C" for degrees in DEGREES)]]
    rows = [*down(DENSITIES, "", [f"{t:.0f}s" for t in SECONDS], others), [], ["Date of measurement: 2015-02-11"]]
    path = text(tmp_path / "plate.asc", lines(rows, "\t").encode("utf-16"))
    trials = Trials.read(path)
    check(trials)
    notes = "; ".join(trials.notes)
    assert "read as a plate: 4 wells, 6 times in s" in notes
    assert "columns left out: temperature" in notes
    assert "'Date of measurement: 2015-02-11'" in notes
    heated = Trials.read(path, wide="OD", inputs=["temperature"])
    assert heated[0].inputs[:, 0].tolist() == DEGREES
    assert (heated.schema.states, heated.schema.units["temperature"]) == (("OD",), "°C")


def test_one_block_below_the_settings_of_a_workbook_is_read(tmp_path):
    rows = [*SETTINGS, *tecan("OD600", DENSITIES), ["End Time:", "2024-02-11 16:12:11"]]
    trials = Trials.read(workbook(tmp_path / "tecan.xlsx", {"Result sheet": rows}))
    check(trials)
    notes = "; ".join(trials.notes)
    assert "4 wells, 6 times in s, OD600" in notes
    assert "Cycle Nr., Temp." in notes
    samples = [[i + 1, t, 37.0, *(DENSITIES[well][i] for well in WELLS)] for i, t in enumerate(SECONDS)]
    rows = [*SETTINGS, ["Cycle Nr.", "Time [s]", "Temp. [°C]", *WELLS], *samples]
    check(Trials.read(workbook(tmp_path / "down.xlsx", {"Sheet1": rows})))


def test_several_blocks_are_a_state_each(tmp_path):
    rows = [*SETTINGS, *tecan("OD600", DENSITIES), [], *tecan("GFP", LIGHT), ["End Time:", "2024-02-11 16:12:11"]]
    trials = Trials.read(workbook(tmp_path / "tecan.xlsx", {"Result sheet": rows}))
    check(trials, ("OD600", "GFP"))
    assert [trial.states[:, 1].tolist() for trial in trials] == [LIGHT[well] for well in WELLS]
    assert any("2 blocks: OD600: 4 wells" in note for note in trials.notes)


@pytest.mark.parametrize("kind", ["text", "workbook"])
def test_blocks_of_wells_across_are_read_with_their_titles_and_results_below_are_left_out(tmp_path, kind):
    results = [["Results"], ["Well", *WELLS], ["Max V [OD:600]", 1.0, 2.0, 3.0, 4.0]]
    settings = [["Software Version", "3.08"], [], ["Plate Number", "Plate 1"], ["Time", "3:12:11 PM"], []]
    time = clock if kind == "text" else lambda t: datetime.time(0, int(t) // 60)
    blocks = [
        [[title], [], *across(values, title, time), []] for title, values in (("OD:600", DENSITIES), ("GFP", LIGHT))
    ]
    rows = [*settings, *blocks[0], *blocks[1], *results]
    if kind == "text":
        trials = Trials.read(text(tmp_path / "gen5.txt", lines(rows, "\t")))
    else:
        trials = Trials.read(workbook(tmp_path / "gen5.xlsx", {"Plate 1": rows}))
    check(trials, ("OD_600", "GFP"))
    notes = "; ".join(trials.notes)
    assert "left out around the table: " in notes
    assert "columns left out: T° OD:600, T° GFP" in notes


def test_blocks_measured_at_other_times_or_of_other_wells_are_joined(tmp_path):
    later = [t + 7 for t in SECONDS]
    rows = [["OD"], *down(DENSITIES, "Time [s]", SECONDS), [], ["GFP"], *down(LIGHT, "Time [s]", later)]
    trials = Trials.read(text(tmp_path / "a.csv", lines(rows)))
    assert trials[0].times.tolist() == sorted([*SECONDS, *later])
    assert np.isnan(trials[0].states).sum() == 12
    halves = [down(DENSITIES, "Time [s]", SECONDS, wells=wells) for wells in (WELLS[:2], WELLS[2:])]
    check(Trials.read(text(tmp_path / "b.csv", lines([["OD"], *halves[0], [], ["OD"], *halves[1]]))), ("OD",))


def test_blocks_of_the_same_wells_without_titles_are_refused(tmp_path):
    rows = [*down(DENSITIES, "Time [s]", SECONDS), [], *down(LIGHT, "Time [s]", SECONDS)]
    with refused("plate-blocks"):
        Trials.read(text(tmp_path / "a.csv", lines(rows)))
    rows = [["OD"], *rows[:5], [], ["GFP"], *down(LIGHT, "Time [min]", SECONDS)]
    with refused("plate-blocks"):
        Trials.read(text(tmp_path / "a.csv", lines(rows)))


def test_columns_between_wells_and_times_are_properties_and_empty_times_are_none(tmp_path):
    rows = down(DENSITIES, "Well", [*map(clock, SECONDS), "0:00:00", "0:00:00"])
    rows[0].insert(1, "Content")
    for row, content in zip(rows[1:], ["blank", "WT", "WT", "mut"], strict=True):
        row.insert(1, content)
        row += ["", ""]
    trials = Trials.read(text(tmp_path / "plate.csv", lines(rows)))
    check(trials)
    assert [trials.properties[well]["Content"] for well in WELLS] == ["blank", "WT", "WT", "mut"]


def test_conditions_are_named_above_the_times_where_these_have_a_header(tmp_path):
    head, names = ["Well", "Content", *["Raw Data (600)"] * 6], ["", "Time", *(f"{t / 60:.0f} min" for t in SECONDS)]
    rows = [["User: Anna"], [], head, names, *([well, f"S{i}", *DENSITIES[well]] for i, well in enumerate(WELLS))]
    trials = Trials.read(text(tmp_path / "omega.csv", lines(rows)))
    check(trials, unit="min")
    assert [trials.properties[well]["Content"] for well in WELLS] == ["S0", "S1", "S2", "S3"]


def test_wells_in_a_later_column_and_times_beyond_a_day_are_read(tmp_path):
    down_in_b = [["", *row] for row in down(DENSITIES, "Time [s]", SECONDS)]
    check(Trials.read(workbook(tmp_path / "b.xlsx", {"A": [["Reader 7"], [], *down_in_b]})))
    hours = [9 * i for i in range(6)]
    rows = across(DENSITIES, "600")
    rows = [[600], rows[0], *([datetime.timedelta(hours=t), *row[1:]] for t, row in zip(hours, rows[1:], strict=True))]
    trials = Trials.read(workbook(tmp_path / "gen5.xlsx", {"A": rows}))
    assert trials[0].times.tolist() == [3600 * t for t in hours]
    rows += [[], ["GFP"], ["Time", *WELLS], *([datetime.timedelta(hours=t), 1.0, 2.0, 3.0, t + 1.0] for t in hours)]
    trials = Trials.read(workbook(tmp_path / "gen5.xlsx", {"A": rows}))
    assert trials.schema.states == ("value_600", "GFP")
    assert trials[0].times.tolist() == [3600 * t for t in hours]


def test_plates_in_several_sheets_are_refused_with_the_option_that_chooses(tmp_path):
    sheets = {name: down(DENSITIES, "Time [s]", SECONDS) for name in ("OD600", "GFP")}
    path = workbook(tmp_path / "a.xlsx", {**sheets, "Info": [["Anna"]]})
    with refused("workbook-layouts", sheets=["OD600", "GFP"]):
        Trials.read(path)
    check(Trials.read(path, sheet="OD600"))


def test_a_cell_without_a_number_is_refused_with_its_place(tmp_path):
    values = {**DENSITIES, "B1": [*DENSITIES["B1"][:5], "OVER"]}
    path = text(tmp_path / "plate.csv", lines(down(values, "", [f"{t:.0f}s" for t in SECONDS])))
    with refused("cell-unreadable", cell="OVER", where="plate.csv: column 'B1', column 7"):
        Trials.read(path)
    assert len(Trials.read(path, missing="OVER").select(object="B1")[0].times) == 6


@pytest.mark.parametrize("by_time", [False, True])
@pytest.mark.parametrize("objects", [("P0", "P1", "P2"), ("A1", "A2"), ("X1", "B1")])
def test_objects_that_are_called_as_wells_do_not_make_a_long_table_a_plate(tmp_path, objects, by_time):
    rows = [[name, t, 0.5 * t**2 + i + 3, 20.0 + 2 * t**2 + i] for i, name in enumerate(objects) for t in range(2, 8)]
    rows = sorted(rows, key=lambda row: row[1]) if by_time else rows
    (tmp_path / "pairs.csv").write_text(lines([["object", "t", "x", "y"], *rows]))
    trials = Trials.read(tmp_path / "pairs.csv")
    assert (trials.objects, trials.schema.states) == (objects, ("x", "y"))
    assert [trial.times.tolist() for trial in trials] == [list(range(2, 8))] * len(objects)
