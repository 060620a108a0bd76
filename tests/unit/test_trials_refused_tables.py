"""Tables that cannot be used are refused, and errors name the place and the remedy."""

import pandas as pd
import polars as pl
import pytest

from commonlaw.errors import CommonlawError
from commonlaw.trials import Trials
from tests.unit.tables import FRAME, ROLES, text, workbook

GOOD = "object,trial,t,height,mass\n" + "".join(f"a,1,{i},{50 - i},2\n" for i in range(20))


def changed(row, column, cell):
    lines = GOOD.splitlines()
    cells = lines[row].split(",")
    cells[column] = cell
    return "\n".join([*lines[:row], ",".join(cells), *lines[row + 1 :], ""])


BAD_TEXT = {
    "empty": ("", {}, "^drops.csv is empty: give a file with a header and rows"),
    "blank": (" \n\n", {}, "^drops.csv is empty"),
    "header only": ("t,x\n", {}, "^drops.csv: the table has a header and no row below it"),
    "header without line end": ("t,x", {}, "a header and no row"),
    "no such state": (GOOD, {"states": ["hieght"]}, "^drops.csv: unknown column 'hieght': did you mean 'height'"),
    "no such object": (GOOD, {"object": "ball"}, "^drops.csv: unknown column 'ball'.*Known: object, trial, t, height"),
    "no such time": (GOOD, {"time": "sec"}, "^drops.csv: unknown column 'sec'"),
    "no such property": (GOOD, {"properties": "mas"}, "unknown column 'mas': did you mean 'mass'"),
    "no such unit column": (GOOD, {"units": {"heigt": "m"}}, "unknown column 'heigt': did you mean 'height'"),
    "no such keyword": (GOOD, {"stats": "x"}, "unknown keyword 'stats': did you mean 'states'"),
    "unknown unit": (
        GOOD,
        {"units": {"height": "metrez"}},
        r"column 'height': unknown unit 'metrez' \(did you mean 'metre'\?\); write it as pint reads it",
    ),
    "unknown unit in a product": (
        GOOD,
        {"units": {"height": "m/secnd"}},
        r"unknown unit 'secnd' in 'm/secnd' \(did you mean 'second'",
    ),
    "two roles": (GOOD, {"states": ["height", "t"]}, "column 't' is given two roles"),
    "no time": ("a,b\n1,2\n", {}, "which column holds the time.*time=...; columns: a, b"),
    "no state": (
        "t,b\n1,q\n",
        {},
        r"no column of numbers is left for the states.*states=\[...\]; columns: t, b; 'b' begins with 'q'",
    ),
    "text in numbers": (
        changed(17, 3, "abc"),
        {},
        r"^drops.csv: column 'height', row 17 \(line 18\), a, trial 1: 'abc' is not a number; repair the cell",
    ),
    "text in times": (
        changed(17, 2, "1:30"),
        {},
        r"column 't', row 17 \(line 18\), a, trial 1: '1:30' is not a number",
    ),
    "text in a text column": (GOOD, {"states": "object"}, "two roles"),
    "first of all": (changed(1, 3, "x"), {}, r"column 'height', row 1 \(line 2\)"),
    "last of all": (changed(20, 3, "x"), {}, r"column 'height', row 20 \(line 21\)"),
    "after blank lines": ("\n" + changed(4, 3, "x\n\n"), {}, r"row 4 \(line 6\) has 4 cells and the header 5"),
    "line of a row after a blank line": (
        changed(17, 3, "abc").replace("\na,1,3,", "\n\na,1,3,"),
        {},
        r"row 17 \(line 19\)",
    ),
    "missing input": (
        changed(9, 3, ""),
        {"states": "mass", "inputs": "height"},
        r"column 'height', row 9 \(line 10\), a, trial 1: the value is missing; repair the rows or remove them",
    ),
    "missing inputs": (
        changed(9, 3, "NA").replace("a,1,18,32", "a,1,18,nan"),
        {"states": "mass", "inputs": "height"},
        r"row 9 \(line 10\).*is missing \(2 values of the column are missing or infinite\)",
    ),
    "infinite value": (
        changed(9, 3, "-inf"),
        {},
        r"column 'height', row 9 \(line 10\), a, trial 1: the value is infinite",
    ),
    "missing time": (changed(9, 2, " "), {}, r"column 't', row 9 \(line 10\).*the value is missing"),
    "missing object": (changed(9, 0, ""), {}, r"column 'object', row 9 \(line 10\): the object is missing \(1 rows"),
    "missing trial": (changed(9, 1, '""'), {}, r"column 'trial', row 9 \(line 10\): the trial is missing"),
    "time twice": (
        changed(17, 2, "3.0"),
        {},
        r"^drops.csv: a, trial 1: the time 3 is there twice, in row 4 \(line 5\) and in row 17 \(line 18\); rem",
    ),
    "property of two values": (
        changed(5, 4, "3"),
        {"properties": ["mass"]},
        r"property 'mass' of a is 2.0 in row 1 \(line 2\) and 3.0 in row 5 \(line 6\); an object has one value",
    ),
    "header twice": ("t,x,x\n0,1,2\n", {}, "^drops.csv: the header 'x' is there twice, in columns 2 and 3"),
    "header twice but for blanks": ("t,x, x\n0,1,2\n", {}, "the header 'x' is there twice, in columns 2 and 3"),
    "mark of Excel and no more": (b"\xef\xbb\xbf\n", {}, "^drops.csv is empty"),
    "a quotation mark without end": ('"t,x\n' + "0,1\n" * 40_000, {}, "^drops.csv, line .*check the quotation marks"),
    "no header": (",t,x\n0.5,1,2\n", {}, "^drops.csv: column 1 has no header"),
    "no header in the middle": ("t,,x\n0,1,2\n", {}, "^drops.csv: column 2 has no header"),
    "too many cells": ("t,x\n0,1\n1,2,3\n", {}, r"^drops.csv: row 2 \(line 3\) has 3 cells and the header 2"),
    "Latin text": ("t,x\n0,1\n1,\u00e9\n2,3\n".encode("latin1"), {}, r"row 2 \(line 3\).*'\u00e9' is not a number"),
    "bytes that are no text": (b"t,x\n0,1\n1,\x02\xff\n", {}, "neither text nor a workbook nor Parquet"),
    "a cut UTF-16": ("t,x\n0,1\n".encode("utf-16")[:-1], {}, "neither text nor a workbook nor Parquet"),
    "binary": (b"t,x\n\x00\x01\n", {}, "neither text nor a workbook nor Parquet"),
    "damaged Parquet": (b"PAR1 and no more", {}, "drops.csv is a damaged Parquet file"),
    "damaged workbook": (
        b"PK\x03\x04 and no more",
        {},
        "drops.csv cannot be read as a workbook.*save it as xlsx or CSV",
    ),
    "a sheet of text": (GOOD, {"sheet": "A"}, "drops.csv is not a workbook and has no sheet 'A'"),
}


@pytest.mark.parametrize("case", BAD_TEXT)
def test_a_file_that_cannot_be_used_is_refused_with_place_and_remedy(case, tmp_path):
    content, roles, message = BAD_TEXT[case]
    with pytest.raises(CommonlawError, match=message):
        Trials.read(text(tmp_path / "drops.csv", content), **roles)


def test_a_missing_file_is_named_with_the_nearest_one(tmp_path):
    text(tmp_path / "drops.csv", GOOD)
    with pytest.raises(CommonlawError, match=r"there is no file 'drop.csv' in .*: did you mean 'drops.csv'"):
        Trials.read(tmp_path / "drop.csv")
    with pytest.raises(CommonlawError, match="nor a folder"):
        Trials.read(tmp_path / "nowhere" / "drops.csv")
    with pytest.raises(CommonlawError, match="is a folder: name a file in it"):
        Trials.read(tmp_path)


def test_workbooks_that_cannot_be_used_are_refused(tmp_path):
    path = workbook(tmp_path / "a.xlsx", {"A": [["t", "x"], [0, 1]], "B": [["t", "y"], [0, "abc"], [1, 2], [2, 3]]})
    with pytest.raises(
        CommonlawError, match=r"different headers, choose one with sheet=...: 'A' \(t \| x\); 'B' \(t \| y"
    ):
        Trials.read(path)
    with pytest.raises(CommonlawError, match=r"a.xlsx: unknown sheet 'a': did you mean 'A'"):
        Trials.read(path, sheet="a")
    with pytest.raises(CommonlawError, match=r"a.xlsx: column 'y', row 1, a, trial 1: 'abc' is not a number"):
        Trials.read(path, sheet="B")
    with pytest.raises(CommonlawError, match="there is nothing in the workbook"):
        Trials.read(workbook(tmp_path / "b.xlsx", {"A": []}))
    rows = [["t", "x"], [0, 1], [None, 2]]
    with pytest.raises(CommonlawError, match="column 't', row 2 of sheet 'B', B, trial 1: the value is missing"):
        Trials.read(workbook(tmp_path / "c.xlsx", {"A": [*rows[:2], [1, 2]], "B": rows}))


BAD_FRAMES = {
    "not a frame": ([1, 2], {}, "cannot read a table from list: give a pandas, polars or pyarrow frame"),
    "header twice": (
        pd.DataFrame([[1, 2]], columns=["t", "t"]),
        {},
        "unique column names.*'t' 2 times; give each column",
    ),
    "no rows": (pd.DataFrame({"t": [], "x": []}), {}, "the frame: the table has a header and no row"),
    "dates": (
        pd.DataFrame({"t": 1.0, "x": pd.to_datetime(["2020-01-01"])}),
        {"states": "x"},
        "'x' holds timestamp.*give it as numbers",
    ),
    "a missing number": (
        pl.DataFrame({"t": [0, None], "x": [1.0, 2.0]}),
        {},
        "column 't', row 2, object, trial 1: the value is m",
    ),
    "mixed cells": (
        pd.DataFrame({"t": [0, 1, 2], "x": [1.0, "abc", 2]}),
        {},
        "column 'x', row 2, .*'abc' is not a number",
    ),
    "lists": (pd.DataFrame({"t": [0], "x": [[1, 2]]}), {"states": "x"}, "column 'x' holds list.*give it as numbers"),
    "missing object": (
        pd.DataFrame({"object": ["a", None], "t": 0, "x": 1}),
        {},
        "column 'object', row 2: the object is m",
    ),
    "other key": (
        FRAME,
        {**ROLES, "properties": pd.DataFrame({"bal": ["golf"]})},
        "unknown column 'bal.*stand in 'ball'",
    ),
    "properties of no trial": (FRAME, {**ROLES, "properties": {"squash": {"mass": 1}}}, "without trials: squash"),
    "no file of properties": (FRAME, {**ROLES, "properties": "balls.csv"}, "there is no file 'balls.csv'"),
}


@pytest.mark.parametrize("case", BAD_FRAMES)
def test_a_frame_that_cannot_be_used_is_refused_with_place_and_remedy(case):
    frame, roles, message = BAD_FRAMES[case]
    with pytest.raises(CommonlawError, match=message):
        Trials.from_frame(frame, **roles)
