"""Workbooks, Parquet files and frames that would take memory, other files or the process with them."""

import json
import os

import numpy as np
import openpyxl
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import commonlaw as cl
from commonlaw.trials import parquet

FRAME = pd.DataFrame({"t": [0.0, 1.0, 2.0, 3.0, 4.0], "x": [0.0, 1.0, 4.0, 9.0, 16.0]})


@pytest.mark.parametrize("cell", ["XFD1048576", "GR1048576"])
def test_a_workbook_with_a_value_far_away_is_refused(tmp_path, cell):
    book = openpyxl.Workbook()
    book.active.append(["t", "x"])
    book.active[cell] = 1
    book.save(tmp_path / "far.xlsx")
    with pytest.raises(cl.CommonlawError, match=r"far.xlsx cannot be read as a workbook in 2 GiB .* delete the rows"):
        cl.Trials.read(tmp_path / "far.xlsx")


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
    "a pipe of properties": json.dumps({"roles": {"properties": "pipe"}}).encode(),
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
    os.mkfifo(tmp_path / "pipe")
    path = parquet_file(tmp_path / "drops.parquet", kept)
    for read in (cl.Trials.read, cl.TrialStream.from_parquet):
        with pytest.raises(cl.CommonlawError, match=r"drops.parquet: what the file says .* damaged .*; write the file"):
            read(path)


def test_a_parquet_file_that_unpacks_to_more_than_memory_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(parquet, "LARGEST_FILE", 2**26)
    path, rows = tmp_path / "repeated.parquet", 20_000
    text = pa.DictionaryArray.from_arrays(np.zeros(rows, dtype=np.int32), ["y" * 100_000])
    pq.write_table(pa.table({"t": range(rows), "x": text}), path, store_schema=False)
    assert path.stat().st_size < 200_000
    with pytest.raises(cl.CommonlawError, match=r"repeated.parquet holds more than 67108864 bytes once it is unpacked"):
        cl.Trials.read(path)


def test_a_parquet_file_cut_or_changed_inside_is_refused(tmp_path):
    content = parquet_file(tmp_path / "drops.parquet", b"{}").read_bytes()
    for damaged in (content[:200] + content[300:], content[:40] + b"\xff" * 40 + content[80:]):
        (tmp_path / "drops.parquet").write_bytes(damaged)
        with pytest.raises(cl.CommonlawError, match=r"drops.parquet is a damaged Parquet file"):
            cl.Trials.read(tmp_path / "drops.parquet")
