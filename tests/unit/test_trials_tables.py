"""Tables in: the same trials from every kind of table."""

from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import openpyxl
import pandas as pd
import pint
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import commonlaw as cl
from commonlaw.errors import CommonlawError
from commonlaw.trials import Schema, Trials
from tests.refusals import refused
from tests.unit.tables import FRAME, HEADER, ROLES, ROWS, text, workbook


def german(path):
    content = FRAME.to_csv(index=False, sep=";", decimal=",", float_format="%.17g")
    return text(path, content)


SOURCES = {
    "csv": lambda folder: text(folder / "drops.csv", FRAME.to_csv(index=False)),
    "csv of Windows": lambda folder: text(
        folder / "drops.csv", b"\xef\xbb\xbf" + FRAME.to_csv(index=False, lineterminator="\r\n").encode()
    ),
    "csv without last line end": lambda folder: text(folder / "drops.csv", FRAME.to_csv(index=False).strip()),
    "csv of old Macs": lambda folder: text(folder / "drops.csv", FRAME.to_csv(index=False, lineterminator="\r")),
    "tsv": lambda folder: text(folder / "drops.txt", FRAME.to_csv(index=False, sep="\t")),
    "semicolons": lambda folder: text(folder / "drops.csv", FRAME.to_csv(index=False, sep=";")),
    "semicolons and decimal commas": lambda folder: german(folder / "drops.csv"),
    "parquet by another name": lambda folder: (FRAME.to_parquet(folder / "drops.dat"), folder / "drops.dat")[1],
    "workbook": lambda folder: workbook(folder / "drops.xlsx", {"Sheet": [HEADER, *ROWS], "Empty": []}),
    "workbook by another name": lambda folder: workbook(folder / "drops.xls", {"Sheet": [HEADER, *ROWS]}),
    "pandas": FRAME,
    "pandas with categories": FRAME.astype({"ball": "category", "height [m]": object}),
    "pandas of Arrow": FRAME.convert_dtypes(dtype_backend="pyarrow"),
    "polars": pl.DataFrame(ROWS, schema=HEADER, orient="row", strict=False),
    "polars lazy": pl.DataFrame(ROWS, schema=HEADER, orient="row", strict=False).lazy(),
    "pyarrow": pa.Table.from_pandas(FRAME),
}


def load(source, **roles):
    return Trials.from_frame(source, **roles) if not isinstance(source, Path) else Trials.read(source, **roles)


@pytest.mark.parametrize("kind", SOURCES)
def test_every_kind_of_table_gives_the_same_trials(kind, tmp_path):
    source = SOURCES[kind](tmp_path) if callable(SOURCES[kind]) else SOURCES[kind]
    trials = load(source, **ROLES, states="height", properties=["mass"])
    units = {"time": "s", "height": "m", "mass": "kg"}
    assert trials.schema == Schema(("height",), ("wind",), "ball", "drop", "time", units)
    assert [trial.label for trial in trials] == ["golf, trial 1", "golf, trial 2", "tennis, trial 1"]
    assert trials.properties == {"golf": {"mass": 0.046}, "tennis": {"mass": 0.057}}
    assert [trial.times.tolist() for trial in trials] == [[0.0, 0.1], [0.0], [0.0, 0.25]]
    assert [trial.states[:, 0].tolist() for trial in trials] == [[50.0, 49.95], [40.12345678901234], [30.0, 1 / 3]]
    assert [trial.inputs[:, 0].tolist() for trial in trials] == [[0.1, 0.2], [0.3], [0.4, 0.5]]


def test_columns_without_a_named_role_are_states_properties_or_left_out():
    remarks = {"remark": ["", "a", "b", "c", "d"], "video": [[1], [2], [3], [4], [5]]}
    frame = FRAME.assign(material=["balata"] * 3 + ["felt"] * 2, **remarks)
    trials = Trials.from_frame(frame, object="ball", trial="drop")
    assert trials.schema.states == ("height", "wind")
    assert trials.properties["tennis"] == {"mass": 0.057, "material": "felt"}
    assert trials.notes[0].startswith(
        "columns recognized as time: time; object: ball; trial: drop; state: height, wind; "
        "property: mass, material. To correct them, use `time=...`, `object=...`, "
    )
    assert trials.notes[1] == "columns left out: remark, video"
    trials = Trials.from_frame(FRAME[:3], object="ball", trial="drop")
    assert trials.schema.states == ("height", "wind")
    assert trials.properties == {"golf": {"mass": 0.046}}
    still = pd.DataFrame({"t": range(3), "x": 1.0, "y": 2.0})
    assert Trials.from_frame(still).schema.states == ("x", "y")


def test_object_trial_and_time_are_found_by_their_names(tmp_path):
    path = text(tmp_path / "drops.csv", "Object,TRIAL,Time,x\na,1,0,1\na,2,0,1\n")
    assert Trials.read(path).schema == Schema(("x",), (), "Object", "TRIAL", "Time")
    trials = Trials.read(text(tmp_path / "one ball.csv", "T,t,x\n300,0,1\n301,1,2\n"))
    assert (trials.schema.time, trials.schema.states) == ("t", ("T", "x"))
    assert trials[0].label == "one ball, trial 1"


def test_names_of_columns_stand_with_and_without_units_and_other_brackets():
    for name in ("height", "height [m]", "height (m)"):
        assert Trials.from_frame(FRAME, **ROLES, states=[name]).schema.states == ("height",)
    units = {"height [m]": "cm", "wind": "m/s", "mass": ""}
    assert Trials.from_frame(FRAME, **ROLES, units=units).schema.units == {"time": "s", "height": "cm", "wind": "m/s"}
    frame = pd.DataFrame(
        {"t": [0.0], "x(t)": [1.0], "y (raw)": [2.0], "v (m/(s*s))": [3.0], "z (m)": 1.0, "z (ft)": 3.3}
    )
    schema = Trials.from_frame(frame).schema
    assert schema.states == ("x(t)", "y (raw)", "v", "z (m)", "z (ft)")
    assert schema.units == {"v": "m/(s*s)", "z (m)": "m", "z (ft)": "ft"}
    frame = pd.DataFrame({"t": [0.0, 1.0], "Ho\u0308he": [1.0, 2.0]})
    properties = {"Cafe\u0301": {"Ho\u0308he 2": 1.0}}
    trials = Trials.from_frame(frame, states="H\u00f6he", object_name="Caf\u00e9", properties=properties)
    assert trials.schema.states == ("H\u00f6he",)


def test_quantities_over_units_are_read_where_the_time_is_one():
    frame = pd.DataFrame(
        {"t/s": [0.0, 1.0, 2.0], "U/V": [1.0, 2.0, 1.5], "I / mA": [3.0, 1.0, 2.0], "gain/loss": [1.0, 4.0, 2.0]}
    )
    schema = Trials.from_frame(frame).schema
    assert (schema.time, schema.states) == ("t", ("U", "I", "gain/loss"))
    assert schema.units == {"t": "s", "U": "V", "I": "mA"}
    assert Trials.from_frame(frame, time="t/s", states=["U/V"]).schema.states == ("U",)
    assert Trials.from_frame(frame.rename(columns={"t/s": "t"})).schema.states == ("U/V", "I / mA", "gain/loss")


def test_unsorted_times_are_sorted_with_a_note():
    trials = Trials.from_frame(FRAME.iloc[[4, 1, 0, 2, 3]], **ROLES)
    assert trials[0].times.tolist() == [0.0, 0.25]
    assert trials[0].states[:, 0].tolist() == [1 / 3 if t else 30.0 for t in trials[0].times]
    assert [trial.object for trial in trials] == ["tennis", "golf", "golf"]
    assert trials.notes[-1] == "sorted by time: tennis, trial 1; golf, trial 1"


def test_rows_in_which_nothing_stands_are_passed_over(tmp_path):
    content = ",,\nt,x,\n0,1,\n,,\n1,2,\n,,\n".removeprefix(",,\n")
    assert Trials.read(text(tmp_path / "a.csv", content))[0].states.tolist() == [[1], [2]]
    path = workbook(tmp_path / "a.xlsx", {"A": [["t", "x"], [0, 1], [None, None], [1, 2]]})
    assert Trials.read(path)[0].states.tolist() == [[1], [2]]


def test_properties_come_from_a_file_a_frame_or_a_mapping_and_lacking_ones_are_noted(tmp_path):
    frame = pd.DataFrame({"ball": ["tennis", "golf"], "mass [g]": [57.0, None], "maker": ["A", "B"]})
    path = tmp_path / "balls.csv"
    frame.to_csv(path, index=False)
    given = {"tennis": {"mass": 57.0, "maker": "A"}, "golf": {"maker": "B"}}
    main = FRAME.drop(columns="mass [kg]")
    for properties in (path, str(path), frame, pl.from_pandas(frame), given):
        trials = Trials.from_frame(main, **ROLES, properties=properties)
        assert trials.properties == given
        assert trials.schema.units.get("mass") == ("g" if properties is not given else None)
    trials = Trials.from_frame(FRAME, **ROLES, states="height", properties={"golf": {"mass": 1}})
    assert "no properties are given for tennis" in trials.notes


def test_text_and_numbers_are_what_the_column_says(tmp_path):
    frame = FRAME.assign(code=["007"] * 3 + ["011"] * 2)
    assert Trials.from_frame(frame, **ROLES, states="height").properties["golf"]["code"] == "007"
    frame = pd.DataFrame({"t": ["0", " 0.1 "], "x": ["+1.5", "1e-3"]}, dtype="str")
    assert Trials.from_frame(frame, states="x")[0].states.tolist() == [[1.5], [1e-3]]
    path = text(tmp_path / "a.csv", "t;x;note\n0;1.000;see 1,2\n1;2.000;a\n2;4.000;b\n")
    assert Trials.read(path)[0].states[:, 0].tolist() == [1, 2, 4]
    assert Trials.read(path).notes == ("columns left out: note",)


def test_sheets_of_the_same_header_are_an_object_each(tmp_path):
    rows = [["Drop #", "t", "x"], [1, 0.0, 1.0], [2, 0.0, 2.0]]
    path = workbook(tmp_path / "balls.xlsx", {"Golf": rows, "Sheet2": [], "Tennis": rows[:2]})
    trials = Trials.read(path, trial="Drop #")
    assert [trial.label for trial in trials] == ["Golf, trial 1", "Golf, trial 2", "Tennis, trial 1"]
    assert Trials.read(path, trial="Drop #", sheet="Golf").objects == ("balls",)


def test_titles_above_and_remarks_below_a_sheet_are_left_out(tmp_path):
    title, header, units = ["Apple slices, 60 °C", None, None], ["sample", "t", "x"], [None, "min", "g"]
    rows = [["S1", 0, 6.0], ["S1", 15, 3.5], ["S2", 0, 5.5], ["S2", 15, 2.5]]
    sheets = {"A": [title, [None] * 3, header, units, *rows], "B": [header, *rows, ["read by eye", None, None]]}
    path = workbook(tmp_path / "a.xlsx", sheets)
    for sheet, count, given in ((None, 4, True), ("A", 2, True), ("B", 2, False)):
        trials = Trials.read(path, sheet=sheet)
        assert [trial.states[:, 0].tolist() for trial in trials] == [[6.0, 3.5], [5.5, 2.5]] * (count // 2)
        assert trials.schema.units == ({"t": "min", "x": "g"} if given else {})


def test_the_measured_ball_drops_are_read_as_they_are(ball_drops_folder):
    trials = Trials.read(ball_drops_folder / "Ball_drops_data.xls", trial="Drop #", states="Height")
    assert len(trials) == 22
    assert trials.schema == Schema(("Height",), (), "object", "Drop #", "Time", {"Time": "s", "Height": "m"})
    with (ball_drops_folder / "Ball_drops_data.xls").open("rb") as file:
        heights = [row[2] for row in openpyxl.load_workbook(file)["Golf Ball"].values if row[0] == 2]
    assert trials.select(object="Golf Ball", trial=2)[0].states[:, 0].tolist() == heights


def test_a_file_of_its_own_says_which_column_is_what(tmp_path):
    trials = Trials.from_frame(FRAME, **ROLES, properties=["mass"])
    trials.to_parquet(tmp_path / "drops.parquet")
    assert Trials.read(tmp_path / "drops.parquet").schema == trials.schema
    assert Trials.read(tmp_path / "drops.parquet", inputs=()).schema.inputs == ()
    assert Trials.read(tmp_path / "drops.parquet", states=["wind"], inputs=["height"]).schema.states == ("wind",)
    assert pq.read_table(tmp_path / "drops.parquet").column_names == [
        "ball", "drop", "time [s]", "height [m]", "wind", "mass [kg]",
    ]  # fmt: skip


def test_a_unit_that_no_reader_would_know_is_not_written(tmp_path):
    trials = Trials.from_arrays([0, 1], [1, 2])
    trials = Trials(trials.trials, Schema(("x",), units={"x": "furlog"}))
    with refused("unit-unknown", unit="furlog", where="column 'x'"):
        trials.to_csv(tmp_path / "a.csv")
    assert not list(tmp_path.iterdir())


PANDAS = {
    "parquet": lambda frame, folder: (frame.to_parquet(folder / "a.parquet"), Trials.read(folder / "a.parquet"))[1],
    "csv read again": lambda frame, folder: (
        frame.to_csv(folder / "a.csv"),
        Trials.from_frame(pd.read_csv(folder / "a.csv")),
    )[1],
    "arrow": lambda frame, _: Trials.from_frame(pa.Table.from_pandas(frame)),
    "frame": lambda frame, _: Trials.from_frame(frame),
    "reset": lambda frame, _: Trials.from_frame(frame.reset_index()),
}


@pytest.mark.parametrize("kind", PANDAS)
def test_an_index_without_a_name_is_no_measurement(kind, tmp_path):
    frame = pd.DataFrame({"t": np.arange(6.0), "x": np.arange(6.0) ** 2})
    assert PANDAS[kind](frame[frame["t"] != 2], tmp_path).schema.states == ("x",)


@pytest.mark.parametrize("kind", ["parquet", "arrow", "frame", "reset"])
def test_an_index_with_names_is_columns(kind, tmp_path):
    frame = FRAME.rename(columns={"ball": "object", "drop": "trial"}).set_index(["object", "trial"])
    trials = PANDAS[kind](frame, tmp_path)
    assert [trial.label for trial in trials] == ["golf, trial 1", "golf, trial 2", "tennis, trial 1"]
    assert trials.schema.states == ("height", "wind")


def test_an_index_is_named_apart_and_counts_are_a_column_where_asked_for(tmp_path):
    frame = FRAME.set_index("ball", drop=False)
    with refused("index-twice", name="ball"):
        Trials.from_frame(frame)
    pd.DataFrame({"x": [1.0, 2.0, 4.0]}, index=[0, 1, 3]).to_parquet(tmp_path / "a.parquet")
    assert Trials.read(tmp_path / "a.parquet", time="__index_level_0__")[0].times.tolist() == [0, 1, 3]


@pytest.mark.parametrize("name", ["object", "trial"])
def test_a_label_that_is_written_in_several_ways_is_one_and_noted(name):
    ways = ["1", "1.0", "1.00", "Caf\u00e9", "Cafe\u0301"]
    trials = Trials.from_frame(pd.DataFrame({name: ways, "t": np.arange(5.0), "x": np.arange(5.0)}))
    assert [getattr(trial, {"trial": "name"}.get(name, name)) for trial in trials] == ["1", "Caf\u00e9"]
    assert trials.notes[0] == f"{name} '1' is written in 3 ways, taken as one: '1', '1.0', '1.00'"
    assert trials.notes[1] == f"{name} 'Caf\u00e9' is written in 2 ways, taken as one: 'Caf\\xe9', 'Cafe\\u0301'"


@pytest.mark.parametrize("wrong", [0.46, None])
def test_one_wrong_cell_does_not_make_a_property_a_state(wrong):
    frame = pd.DataFrame({"object": ["a"] * 6 + ["b"] * 6, "t": [*range(6)] * 2, "x": np.arange(12.0) ** 2})
    frame["mass"] = [0.046] * 3 + [wrong] + [0.046] * 2 + [0.057] * 6
    said = "empty" if wrong is None else wrong
    with refused("property-or-state", cell=str(said)):
        Trials.from_frame(frame)
    assert Trials.from_frame(frame, states="x").schema.states == ("x",)
    doses = frame.assign(mass=[1.0, 0, 0, 0, 0, 0] * 2)
    assert Trials.from_frame(doses).schema.inputs == ("mass",)


@pytest.mark.parametrize("missing", [pd.NA, pd.NaT, None, np.nan])
@pytest.mark.parametrize("column", ["object", "trial", "t", "x", "note"])
@pytest.mark.parametrize("row", [0, 3])
def test_what_pandas_has_for_a_missing_cell_is_one(missing, column, row):
    frame = pd.DataFrame({"object": "a", "trial": 1, "t": range(8), "x": np.arange(8.0), "note": "n"}, dtype=object)
    frame[column] = pd.Series([missing if i == row else cell for i, cell in enumerate(frame[column])], dtype=object)
    if column in ("x", "note"):
        assert len(Trials.from_frame(frame, states="x")[0]) == (7 if column == "x" else 8)
    else:
        with pytest.raises(CommonlawError) as raised:
            Trials.from_frame(frame, states="x")
        assert raised.value.code in ("cell-value", "label-missing")
        assert f"column '{column}', row {row + 1}" in str(raised.value)


TIMES = np.linspace(0.0, 2.0, 21)
X, Y = np.exp(-TIMES), np.cos(TIMES)
UNITS = pint.UnitRegistry()


class Dataset:
    """What is used of an xarray Dataset: two trials of the same times."""

    data_vars = ("x",)

    def __init__(self):
        units = {"trial": {}, "t": {"units": "s"}, "x": {"units": "cm", "long_name": "height"}}
        self.variables = {name: SimpleNamespace(attrs=unit) for name, unit in units.items()}

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


def test_a_dataset_is_a_table_of_its_coordinates_and_columns_have_one_length():
    trials = Trials.from_frame(Dataset())
    assert [trial.name for trial in trials] == ["a", "b"]
    assert trials.schema.units == {"t": "s", "x": "cm"}
    assert trials[1].states[:, 0] == pytest.approx(X)
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


def test_a_table_is_fitted_as_the_trials_in_it_are():
    table = {"t": TIMES, "x": X}
    assert cl.fit("x' = -k x", table).coefficients == pytest.approx(np.full((1, 1, 1), -1.0))
    with refused("arguments-swapped"):
        cl.fit(table, "x' = -k x")


METHODS = (cl.TrajectoryLikelihood, cl.DerivativeRegression, cl.WeakRegression, cl.DiscreteTimeRegression)
NUMBERS = [(method, each.name) for method in METHODS for each in fields(method) if type(each.default) in (int, float)]


@pytest.mark.parametrize(("method", "name"), NUMBERS, ids=[f"{method.__name__} {name}" for method, name in NUMBERS])
def test_text_is_no_number(method, name):
    with pytest.raises(cl.CommonlawError) as raised:
        method(**{name: "2"})
    assert "'2'" in str(raised.value)
    assert name in str(raised.value).replace(" ", "_") or raised.value.code == name.replace("_", "-")


@pytest.mark.parametrize(
    ("cells", "values", "limits"),
    [
        (["1.5", "<1.2", "0.9"], [1.5, np.nan, 0.9], [np.nan, 1.2, np.nan]),
        (["1,5", "1,25", "0,9"], [1.5, 1.25, 0.9], [np.nan] * 3),
        (["1.5", "n.d.", "0.9"], [1.5, 0.9], [np.nan] * 2),
    ],
    ids=["below a limit", "decimal commas", "missing"],
)
def test_numbers_that_one_cell_made_text_are_read_from_a_frame(cells, values, limits):
    trials = Trials.from_frame(pd.DataFrame({"t": [0.0, 1.0, 2.0], "conc": cells, "lot": ["7", "7", "8"]}))
    assert trials.schema.states == ("conc",)
    np.testing.assert_array_equal(trials.trials[0].states[:, 0], values)
    np.testing.assert_array_equal(trials.trials[0].below[:, 0], limits)
