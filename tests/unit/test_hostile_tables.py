"""Workbooks, Parquet files and frames that would take memory, other files or the process with them."""

import json
from decimal import Decimal

import numpy as np
import openpyxl
import pandas as pd
import polars as pl
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.trials import files, stream
from tests.refusals import refused

FRAME = pd.DataFrame({"t": [0.0, 1.0, 2.0, 3.0, 4.0], "x": [0.0, 1.0, 4.0, 9.0, 16.0]})


@pytest.mark.parametrize("cell", ["XFD1048576", "GR1048576"])
def test_a_workbook_with_a_value_far_away_is_refused(tmp_path, cell):
    book = openpyxl.Workbook()
    book.active.append(["t", "x"])
    book.active[cell] = 1
    book.save(tmp_path / "far.xlsx")
    with refused("workbook-too-large", source="far.xlsx", memory=2.0):
        cl.Trials.read(tmp_path / "far.xlsx")


def test_a_million_empty_rows_are_passed_over(tmp_path):
    book = openpyxl.Workbook()
    for row in (list(FRAME), *FRAME.to_numpy().tolist(), [None] * 9):
        book.active.append(row)
    book.active["A1048576"] = 5
    book.save(tmp_path / "far.xlsx")
    trials = cl.Trials.read(tmp_path / "far.xlsx")
    assert trials[0].times.tolist() == [*FRAME.t, 5.0]


def test_what_lies_in_the_working_folder_is_not_run_to_read_a_workbook(tmp_path, monkeypatch):
    FRAME.to_excel(tmp_path / "drops.xlsx", index=False)
    monkeypatch.chdir(tmp_path)
    for name in ("python_calamine", "pickle", "io"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('run')")
    assert len(cl.Trials.read("drops.xlsx")[0]) == 5


def parquet_file(path, kept):
    table = pa.Table.from_pandas(FRAME).replace_schema_metadata({b"commonlaw": kept})
    pq.write_table(table, path)
    return path


KEPT = {
    "a file of properties": json.dumps({"roles": {"properties": "secret.csv"}}).encode(),
    "numbers for names": b'{"roles": {"time": 5}}',
    "an empty name": b'{"roles": {"states": [null]}}',
    "a list": b"[]",
    "notes that are no texts": b'{"notes": [1]}',
    "no JSON": b"\xff{",
    "nested without end": b"[" * 100_000,
}


@pytest.mark.parametrize("kept", KEPT.values(), ids=KEPT)
def test_what_a_parquet_file_says_of_its_columns_are_names_of_them(tmp_path, monkeypatch, kept):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "secret.csv").write_text("object,password\ndrops,xyzzy\n")
    path = parquet_file(tmp_path / "drops.parquet", kept)
    for read in (cl.Trials.read, cl.TrialStream.from_parquet):
        with refused("parquet-metadata", where="drops.parquet"):
            read(path)


def streamed(path):
    return list(cl.TrialStream.from_parquet(path, object="object", trial="trial", time="t", states=["x"]))


def test_a_text_that_is_in_every_row_of_a_parquet_file_is_in_memory_once(tmp_path):
    path, rows = tmp_path / "repeated.parquet", np.arange(2_000.0)
    text = pa.DictionaryArray.from_arrays(np.zeros(len(rows), dtype=np.int32), ["y" * 600_000])
    lists = pa.ListArray.from_arrays(np.arange(len(rows) + 1) * 10, pa.array(["a"]).take([0] * 10 * len(rows)))
    named = {"object": ["ball"] * len(rows), "trial": ["1"] * len(rows), "t": rows, "x": rows}
    pq.write_table(pa.table(named | {"text": text, "lists": lists}), path, store_schema=False)
    assert path.stat().st_size < 500_000
    assert [len(trial) for trials in (cl.Trials.read(path), streamed(path)) for trial in trials] == 2 * [len(rows)]
    assert pa.default_memory_pool().max_memory() < 2**30


def test_a_parquet_file_that_unpacks_to_more_than_memory_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "LARGEST_FILE", 2**16)
    texts = [f"{i:0100}" for i in range(1000)]
    pq.write_table(pa.table({"t": range(1000), "x": texts}), tmp_path / "texts.parquet")
    with refused("parquet-too-large", source="texts.parquet", limit=65536):
        cl.Trials.read(tmp_path / "texts.parquet")


def test_a_trial_of_a_stream_that_memory_does_not_hold_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(stream, "MOST_CELLS", 50)
    cl.datasets.linear_drag(drag=-0.1, trials=1).to_parquet(tmp_path / "long.parquet")
    with refused("trial-too-large", trial="Ball 1, trial 1", limit=50):
        list(cl.TrialStream.from_parquet(tmp_path / "long.parquet"))


def test_a_text_that_the_dictionary_of_a_damaged_parquet_file_lacks_is_refused(tmp_path):
    path, rows = tmp_path / "drops.parquet", range(32)
    table = pa.table({"object": ["a", "b", "c", "d"] * 8, "t": rows, "x": list(map(float, rows))})
    pq.write_table(table, path, compression="none")
    whole, refusals = path.read_bytes(), []
    for i in range(4, 80):
        path.write_bytes(whole[:i] + bytes([whole[i] ^ 1]) + whole[i + 1 :])
        try:
            cl.Trials.read(path)
        except cl.CommonlawError as refusal:
            refusals.append(str(refusal))
    assert any("a damaged Parquet file" in refusal and "Dictionary indices invalid" in refusal for refusal in refusals)


def test_a_parquet_file_whose_columns_are_not_what_it_says_does_not_end_the_process(tmp_path):
    path = parquet_file(tmp_path / "drops.parquet", b"{}")
    optional, required = b"\x25\x02\x18\x01x", b"\x25\x00\x18\x01x"
    content = path.read_bytes()
    assert content.count(optional) == 1
    path.write_bytes(content.replace(optional, required))
    with refused("parquet-damaged", source="drops.parquet"):
        cl.Trials.read(path)


def test_a_parquet_file_that_has_fewer_rows_than_it_says_is_refused(tmp_path):
    path = tmp_path / "drops.parquet"
    pq.write_table(pa.table({"object": ["a"] * 5, "trial": ["1"] * 5, "t": np.arange(5.0), "x": np.arange(5.0)}), path)
    # In the words of the file, numbers of rows are written as twice as much
    path.write_bytes(path.read_bytes().replace(b"\x16\x0a", b"\x16\x0c"))
    for read in (cl.Trials.read, streamed):
        with refused("parquet-damaged"):
            read(path)


ODD = {
    "complex states": (
        FRAME.assign(x=FRAME.x + 1j),
        {"states": "x"},
        Diagnostic("column-not-numbers", {"column": "x", "kind": "complex"}),
    ),
    "long doubles beyond doubles": (FRAME.assign(x=FRAME.x.to_numpy(np.longdouble) * 1e300 * 1e300), {}, "cell-value"),
    "an integer beyond doubles": (FRAME.assign(x=[10**400, 1, 2, 3, 4]), {}, "cell-value"),
    "a lazy frame of a column that is not there": (
        pl.DataFrame({"t": [0.0], "x": [1.0]}).lazy().select("t", "z"),
        {},
        Diagnostic("frame-not-computed", {"source": "the frame"}),
    ),
    "a number as unit": (FRAME, {"units": {"x": 5}}, Diagnostic("argument-type", {"name": "units of x"})),
    "a unit that cancels": (FRAME, {"units": {"x": "m^0"}}, Diagnostic("unit-unknown", {"unit": "m^0"}, "column 'x'")),
    "a text as units": (FRAME, {"units": "m"}, Diagnostic("argument-type", {"name": "units"})),
    "a number as states": (FRAME, {"states": 5}, Diagnostic("argument-type", {"name": "states"})),
    "a list as a property": (
        FRAME,
        {"properties": {"object": {"mass": [1]}}},
        Diagnostic("property-value", {"property": "property 'mass' of object"}),
    ),
}


@pytest.mark.parametrize(("frame", "roles", "message"), ODD.values(), ids=ODD)
def test_odd_frames_and_roles_are_refused(frame, roles, message):
    with refused(message):
        cl.Trials.from_frame(frame, **roles)


@pytest.mark.parametrize("kind", [pl.Int128, pl.UInt64, pl.Decimal(20, 2), pl.Float32])
def test_numbers_of_every_kind_are_read(kind):
    frame = pl.DataFrame({"t": FRAME.t.to_numpy(), "x": pl.Series(FRAME.x.to_numpy()).cast(kind)})
    assert cl.Trials.from_frame(frame)[0].states[:, 0].tolist() == FRAME.x.tolist()


def test_integers_above_two_to_the_63_are_read():
    assert cl.Trials.from_frame(FRAME.assign(x=[2**63, 2**64, 2**65, 0, 1]))[0].states[1, 0] == 2.0**64


@pytest.mark.parametrize("name", ["sNaN", "-sNaN7", "NaN"])
def test_a_decimal_that_is_no_number_is_missing(name):
    values = [Decimal(-1), Decimal(name), *map(Decimal, range(4))]
    frame = pd.DataFrame({"t": range(6), "x": values})
    assert cl.Trials.from_frame(frame)[0].times.tolist() == [0.0, 2.0, 3.0, 4.0, 5.0]
    with refused("cell-value", value="is missing"):
        cl.Trials.from_frame(frame.assign(t=values, x=range(6)))


ARRAYS = {
    "complex times": (FRAME.t.to_numpy() + 1j, FRAME.x, {}, "not-an-array"),
    "a number as times": (3, 3, {}, Diagnostic("array-dimensions", {"dimensions": 2})),
    "rows of several lengths": (FRAME.t, [[1], [1, 2]], {}, "not-an-array"),
    "an integer beyond doubles": ([10**400, 1], [1, 2], {}, "not-an-array"),
    "a number as name": (FRAME.t, FRAME.x, {"names": [1]}, Diagnostic("argument-type", {"name": "item 1 of names"})),
    "a number as unit": (
        FRAME.t,
        FRAME.x,
        {"units": {"x": 5}},
        Diagnostic("argument-type", {"name": "units of x"}),
    ),
}


@pytest.mark.parametrize(("times", "states", "options", "message"), ARRAYS.values(), ids=ARRAYS)
def test_odd_arrays_are_refused(times, states, options, message):
    with refused(message):
        cl.Trials.from_arrays(times, states, **options)


def test_a_property_may_have_any_name_in_a_selection():
    trials = cl.Trials.from_frame(FRAME, properties={"object": {"self": 1.0}})
    assert len(trials.select(self=1)) == 1
    with refused("unknown-name", kind="property", name="cls"):
        trials.split(cls=1)
