"""Tables that cannot be used are refused, and errors name the place and the remedy."""

import io
import zipfile
from collections import ChainMap

import pandas as pd
import polars as pl
import pytest

from commonlaw.trials import Trials
from tests.refusals import message, refused
from tests.unit.tables import FRAME, ROLES, text, workbook

GOOD = "object,trial,t,height,mass\n" + "".join(f"a,1,{i},{50 - i},2\n" for i in range(20))


def changed(row, column, cell):
    lines = GOOD.splitlines()
    cells = lines[row].split(",")
    cells[column] = cell
    return "\n".join([*lines[:row], ",".join(cells), *lines[row + 1 :], ""])


def archive(**contents):
    """Return a zip archive of files with these contents."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as files:
        for name, content in contents.items():
            files.writestr(f"{name}.csv", content)
    return packed.getvalue()


MASS_AND_HEIGHT = {"states": "mass", "inputs": "height"}
BAD_TEXT = {
    "empty": ("", message("table-empty", name="drops.csv")),
    "blank": (" \n\n", message("table-empty", name="drops.csv")),
    "header only": ("t,x\n", message("table-without-rows", "drops.csv")),
    "header without line end": ("t,x", "table-without-rows"),
    "no such state": (GOOD, message("unknown-name", "drops.csv", kind="column", name="hieght"), {"states": ["hieght"]}),
    "no such object": (GOOD, message("unknown-name", "drops.csv", kind="column", name="ball"), {"object": "ball"}),
    "no such time": (GOOD, message("unknown-name", "drops.csv", kind="column", name="sec"), {"time": "sec"}),
    "no such property": (GOOD, message("unknown-name", kind="column", name="mas"), {"properties": "mas"}),
    "no such unit column": (GOOD, message("unknown-name", kind="column", name="heigt"), {"units": {"heigt": "m"}}),
    "no such keyword": (GOOD, message("unknown-name", kind="keyword", name="stats"), {"stats": "x"}),
    "unknown unit": (
        GOOD,
        message("unit-unknown", "column 'height'", unit="metrez", hint=" (did you mean 'metre'?)"),
        {"units": {"height": "metrez"}},
    ),
    "unknown unit in a product": (
        GOOD,
        message("unit-unknown", unit="secnd", whole=" in 'm/secnd'"),
        {"units": {"height": "m/secnd"}},
    ),
    "role-twice": (GOOD, message("role-twice", column="t"), {"states": ["height", "t"]}),
    "no time": ("a,b\n1,2\n", "time-missing"),
    "no state": ("t,b\n1,q\n", "no-state"),
    "text in numbers": (
        changed(17, 3, "abc"),
        message("cell-not-a-number", "drops.csv: column 'height', row 17 (line 18), a, trial 1", cell="abc"),
    ),
    "text in times": (changed(17, 2, "1:30"), message("cell-not-a-number", cell="1:30")),
    "text in a text column": (GOOD, "role-twice", {"states": "object"}),
    "first of all": (changed(1, 3, "x"), "cell-not-a-number"),
    "last of all": (changed(20, 3, "x"), "cell-not-a-number"),
    "after blank lines": ("\n" + changed(4, 3, "x\n\n"), message("row-length", row=4, line=6, cells=4, width=5)),
    "line of a row after a blank line": (changed(17, 3, "abc").replace("\na,1,3,", "\n\na,1,3,"), "cell-not-a-number"),
    "missing input": (changed(9, 3, ""), message("cell-value", value="is missing"), MASS_AND_HEIGHT),
    "missing inputs": (
        changed(9, 3, "NA").replace("a,1,18,32", "a,1,18,nan"),
        message("cell-value", value="is missing"),
        MASS_AND_HEIGHT,
    ),
    "infinite value": (changed(9, 3, "-inf"), message("cell-value", value="is infinite")),
    "missing time": (changed(9, 2, " "), message("cell-value", value="is missing")),
    "missing object": (
        changed(9, 0, ""),
        message("label-missing", column="object", row="row 9 (line 10)", label="object", count=1),
    ),
    "missing trial": (
        changed(9, 1, '""'),
        message("label-missing", column="trial", row="row 9 (line 10)", label="trial"),
    ),
    "time twice": (changed(17, 2, "3.0"), "name-trials"),
    "property of two values": (
        changed(5, 4, "3"),
        message(
            "property-differs",
            property="mass",
            object="a",
            first=2.0,
            first_row="row 1 (line 2)",
            second=3.0,
            second_row="row 5 (line 6)",
        ),
        {"properties": ["mass"]},
    ),
    "header twice": ("t,x,x\n0,1,2\n", message("header-twice", "drops.csv", name="x", first=2, second=3)),
    "header twice but for blanks": ("t,x, x\n0,1,2\n", message("header-twice", name="x", first=2, second=3)),
    "mark of Excel and no more": (b"\xef\xbb\xbf\n", message("table-empty", name="drops.csv")),
    "a quotation mark without end": (
        '"t,x\n' + "0,1\n" * 40_000,
        message("quotation-marks-in-line", source="drops.csv"),
    ),
    "no header": (",t,x\n0.5,1,2\n", message("header-missing", "drops.csv", number=1)),
    "no header in the middle": ("t,,x\n0,1,2\n", message("header-missing", "drops.csv", number=2)),
    "too many cells": ("t,x\n0,1\n1,2,3\n", message("row-length", "drops.csv", row=2, line=3, cells=3, width=2)),
    "Latin text": ("t,x\n0,1\n1,\u00e9\n2,3\n".encode("latin1"), "cell-not-a-number"),
    "bytes that are no text": (b"t,x\n0,1\n1,\x02\xff\n", "not-a-table"),
    "a cut UTF-16": ("t,x\n0,1\n".encode("utf-16")[:-1], "not-a-table"),
    "binary": (b"t,x\n\x00\x01\n", "not-a-table"),
    "damaged Parquet": (b"PAR1 and no more", message("parquet-damaged", source="drops.csv")),
    "damaged workbook": (b"PK\x03\x04 and no more", message("workbook-damaged", source="drops.csv")),
    "a zip archive": (archive(drops=GOOD), message("workbook-is-archive", source="drops.csv")),
    "a sheet of text": (GOOD, message("sheet-of-text", name="drops.csv", sheet="A"), {"sheet": "A"}),
}


@pytest.mark.parametrize("case", BAD_TEXT)
def test_a_file_that_cannot_be_used_is_refused_with_place_and_remedy(case, tmp_path):
    content, expected, *roles = BAD_TEXT[case]
    with refused(expected):
        Trials.read(text(tmp_path / "drops.csv", content), **ChainMap(*roles))


def test_a_missing_file_is_named_with_the_nearest_one(tmp_path):
    text(tmp_path / "drops.csv", GOOD)
    with refused("file-missing", file="drop.csv"):
        Trials.read(tmp_path / "drop.csv")
    with refused("folder-missing"):
        Trials.read(tmp_path / "nowhere" / "drops.csv")
    (tmp_path / "empty").mkdir()
    with refused("file-is-folder"):
        Trials.read(tmp_path / "empty")


def test_workbooks_that_cannot_be_used_are_refused(tmp_path):
    path = workbook(tmp_path / "a.xlsx", {"A": [["t", "x"], [0, 1]], "B": [["t", "y"], [0, "abc"], [1, 2], [2, 3]]})
    with refused("workbook-sheets"):
        Trials.read(path)
    with refused("unknown-name", kind="sheet", name="a", where="a.xlsx"):
        Trials.read(path, sheet="a")
    with refused("cell-not-a-number", cell="abc", where="a.xlsx: column 'y', row 1, a, trial 1"):
        Trials.read(path, sheet="B")
    with refused("workbook-empty", part="workbook"):
        Trials.read(workbook(tmp_path / "b.xlsx", {"A": []}))
    rows = [["t", "x"], [0, 1], [None, 2]]
    with refused("cell-value", value="is missing"):
        Trials.read(workbook(tmp_path / "c.xlsx", {"A": [*rows[:2], [1, 2]], "B": rows}))


BAD_FRAMES = {
    "not a frame": ([1, 2], message("frame-unknown", type="list")),
    "header twice": (pd.DataFrame([[1, 2]], columns=["t", "t"]), "column-twice"),
    "no rows": (pd.DataFrame({"t": [], "x": []}), message("table-without-rows", "the frame")),
    "dates": (
        pd.DataFrame({"t": 1.0, "x": pd.to_datetime(["2020-01-01"])}),
        message("column-not-numbers", column="x", kind="timestamp"),
        {"states": "x"},
    ),
    "a missing number": (pl.DataFrame({"t": [0, None], "x": [1.0, 2.0]}), "cell-value"),
    "mixed cells": (pd.DataFrame({"t": [0, 1, 2], "x": [1.0, "abc", 2]}), message("cell-not-a-number", cell="abc")),
    "lists": (
        pd.DataFrame({"t": [0], "x": [[1, 2]]}),
        message("column-not-numbers", column="x", kind="list"),
        {"states": "x"},
    ),
    "missing object": (
        pd.DataFrame({"object": ["a", None], "t": 0, "x": 1}),
        message("label-missing", column="object", row="row 2", label="object"),
    ),
    "other key": (
        FRAME,
        message("unknown-name", kind="column", name="ball", key="ball"),
        {**ROLES, "properties": pd.DataFrame({"bal": ["golf"]})},
    ),
    "properties of no trial": (FRAME, "properties-of-no-trial", {**ROLES, "properties": {"squash": {"mass": 1}}}),
    "no file of properties": (FRAME, message("file-missing", file="balls.csv"), {**ROLES, "properties": "balls.csv"}),
}


@pytest.mark.parametrize("case", BAD_FRAMES)
def test_a_frame_that_cannot_be_used_is_refused_with_place_and_remedy(case):
    frame, expected, *roles = BAD_FRAMES[case]
    with refused(expected):
        Trials.from_frame(frame, **ChainMap(*roles))
