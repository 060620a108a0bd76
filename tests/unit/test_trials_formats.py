"""Tables as loggers, instruments and spreadsheets write them."""

import bz2
import gzip
import lzma
import tracemalloc
from functools import partial

import numpy as np
import pandas as pd
import pytest

from commonlaw.errors import CommonlawError
from commonlaw.runtime import files
from commonlaw.trials import Trials
from commonlaw.trials.files import table_in
from commonlaw.trials.tables import rows_of
from tests.refusals import refused
from tests.unit.tables import text, workbook

MINUTES = [0.0, 2.0, 4.0, 6.0]
HEIGHTS = [1800.25, 1731.5, 1673.0, 998.75]
PLAIN = "".join(f"{time:g},{height}\n" for time, height in zip(MINUTES, HEIGHTS, strict=True))


def comma(number):
    return str(number).replace(".", ",")


def rows(separator, times=MINUTES, heights=HEIGHTS, end="\n"):
    return "".join(f"{time}{separator}{height}{end}" for time, height in zip(times, heights, strict=True))


def read(folder, content, name="cup.csv", **roles):
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return Trials.read(path, **roles)


SEMICOLONS, TABS, HEADED = PLAIN.replace(",", ";"), PLAIN.replace(",", "\t"), b"time,height\n" + PLAIN.encode()
UNITS = {"time": "min", "height": "mm"}
CELSIUS = UNITS | {"height": "\u00b0C"}
SEPARATED = {
    "units row": ("time,height\n[min],[mm]\n" + PLAIN, "line 2 holds units", UNITS),
    "bare units": ("time;height\nmin;mm\n" + SEMICOLONS, "line 2 holds units", UNITS),
    "some units": ("time\theight\n(min)\t-\n" + TABS, "line 2 holds units", {"time": "min"}),
    "bars": ("time|height\n" + PLAIN.replace(",", "|"), "", {}),
    "bars and quotes": ('"time [min]"|height\n' + rows("|", map('"{}"'.format, MINUTES)), "", {"time": "min"}),
    "comments": ("# cup 3\n# by A, B\ntime [min],height\n# begin\n" + PLAIN, "'cup 3', 'by A B'", {"time": "min"}),
    "header in a comment": ("# cup 3\n# time [min]  height [mm]\n" + rows("  "), "the comment in line 2", UNITS),
    "header after a mark": ("#time,height\n" + PLAIN, "the header is the comment in line 1", {}),
    "pairs above": ("Logger;T 1\nSerial;00042\n\ntime;height\n" + SEMICOLONS, "'Logger T 1', 'Serial 00042'", {}),
    "pairs directly above": ("Logger;T 1\nSerial;00042\ntime;height\n" + SEMICOLONS, "'Serial 00042'", {}),
    "a filled sheet": ("Logger,,\ntime,height,gain\n" + rows(",", end=",1\n"), "above the header: 1 ('Logger')", {}),
    "a title": ("Cup of tea\ntime,height\n" + PLAIN, "'Cup of tea'", {}),
    "a footer": ("time,height\n" + PLAIN + "End of data,\n\n", "left out below the table: 1 ('End of data')", {}),
    "a short footer": ("time,height\n" + PLAIN + "all rows written\n", "'all rows written'", {}),
    "means below": ("time,height\n" + PLAIN + "Mean,1500\nMax,1800.25\n", "'Mean 1500', 'Max 1800.25'", {}),
    "blanks": ("  time   height\n" + rows("    ", (f"{time:6.1f}" for time in MINUTES)), "", {}),
    "blanks and units": ("time [min]  height [mm]\n" + rows(" "), "", UNITS),
    "trailing separators": ("time,height\n" + rows(",", end=",\n"), "", {}),
    "trailing separators everywhere": ("time,height,\n" + rows(",", end=",\n"), "", {}),
    "an index": (",time,height\n" + rows(",", (f"{i},{time}" for i, time in enumerate(MINUTES))), "Unnamed: 0", {}),
    "row names of R": (
        '"time" "height"\n' + rows(" ", (f'"row {i}" {time}' for i, time in enumerate(MINUTES))),
        "Unnamed: 0",
        {},
    ),
    "no header": (PLAIN, "there is no header, and the columns are called t, x", {}),
    "decimal commas and tabs": (
        "time\theight\n" + rows("\t", heights=map(comma, HEIGHTS)),
        "a comma is read as the decimal point (height)",
        {},
    ),
    "decimal commas in quotes": (
        "time,height\n" + rows(",", heights=(f'"{comma(height)}"' for height in HEIGHTS)),
        "a comma is read as the decimal point",
        {},
    ),
    **{
        f"thousands of {language}": ("time;height\n" + rows(";", heights=cells), fact, {})
        for language, cells, fact in (
            ("England", [f'"{height:,}"' for height in HEIGHTS], "',' groups thousands (height)"),
            ("Germany", ["1.800,25", "1.731,5", "1.673,0", "998,75"], "'.' groups thousands"),
            ("France", ["1\u202f800,25", "1\u202f731,5", "1\u202f673", "998,75"], "blanks group thousands"),
            ("Switzerland", ["1'800.25", "1'731.5", "1'673", "998.75"], "groups thousands"),
        )
    },
    "units in cells": (
        "time,height\n" + rows(",", [f"{t} min" for t in MINUTES], [f"{h} \u00b0C" for h in HEIGHTS]),
        "the cells hold units (time [min], height [\u00b0C])",
        CELSIUS,
    ),
    "UTF-16": (("time [min]\theight\n" + TABS).encode("utf-16"), "text in UTF-16", {"time": "min"}),
    "no mark": (("time [min]\theight\n" + TABS).encode("utf-16-le"), "text in UTF-16-LE", {"time": "min"}),
    "Latin-1": (("time [min];height [\u00b0C]\n" + SEMICOLONS).encode("latin1"), "text in Windows-1252", CELSIUS),
    "gzip": (gzip.compress(HEADED), "", {}),
    "bzip2": (bz2.compress(HEADED), "", {}),
    "xz": (lzma.compress(HEADED), "", {}),
}


@pytest.mark.parametrize("kind", SEPARATED)
def test_a_table_is_read_and_what_was_guessed_is_said(tmp_path, kind):
    content, fact, units = SEPARATED[kind]
    trials = read(tmp_path, content)
    assert trials[0].times.tolist() == MINUTES
    assert trials[0].states[:, 0].tolist() == HEIGHTS
    assert trials.schema.states == ("x" if kind == "no header" else "height",)
    assert trials.schema.units == units
    assert fact in "; ".join(trials.notes)
    assert bool(fact) == any(note.startswith("cup.csv: ") or "Unnamed" in note for note in trials.notes)


def test_signs_and_names_are_read_as_they_stand(tmp_path):
    assert read(tmp_path, "t,x\n0,\u22121.5\n1,2\n2,\u22123e\u22122\n")[0].states[:, 0].tolist() == [-1.5, 2, -0.03]
    trials = read(tmp_path, "object,t,x\n" + "".join(f"#{i},{t},{t}\n" for i in range(3) for t in range(3)))
    assert trials.objects == ("#0", "#1", "#2")
    trials = read(tmp_path, "object,t,x\n" + "".join(f"{name},{t},{t}\n" for name in "123A" for t in range(3)))
    assert trials.objects == ("1", "2", "3", "A")
    with refused("cell-not-a-number", cell="abc"):
        read(tmp_path, "t,x\n0,1\n1,2\n2,3\nabc,4\n")
    assert read(tmp_path, "object,t,x\n-,0,1\n-,1,2\nb,0,1\nb,1,2\n").objects == ("-", "b")


def test_headers_of_plates_are_numbers_too_and_rows_of_properties_below_them_are_kept(tmp_path):
    plate = "time,A1,B1\nstrain,WT,mut\nglucose,0,1\n0,0.1,0.2\n1,0.2,0.3\n2,0.3,0.5\n"
    assert read(tmp_path, "time,1,2\n0,5,6\n1,6,7\n2,7,8\n", wide="OD").objects == ("1", "2")
    assert read(tmp_path, plate, wide="OD").properties["B1"] == {"strain": "mut", "glucose": 1}
    samples = rows_of(table_in("plate.csv", plate.encode()), {"wide": "OD"}).row_indices
    assert [rows.tolist() for rows in samples] == [[2, 3, 4], [2, 3, 4]]


def test_a_compressed_file_is_unpacked_up_to_a_limit_and_refused_if_damaged(tmp_path, monkeypatch):
    packed = gzip.compress(b"t,x\n" + b"0,1\n" * 1000)
    with refused("not-unpacked", source="cup.csv"):
        read(tmp_path, packed[:-20])
    monkeypatch.setattr(files, "LARGEST_INFLATED", 1000)
    with refused("unpacked-too-large", limit=1000):
        read(tmp_path, packed)


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress, partial(lzma.compress, preset=0)])
def test_a_file_that_unpacks_to_more_than_is_read_is_refused_without_holding_it(tmp_path, monkeypatch, pack):
    size = 2**25
    monkeypatch.setattr(files, "LARGEST_INFLATED", size // 2)
    (tmp_path / "cup.csv").write_bytes(pack((b"0" * 999_999 + b"\n") * (size // 1_000_000)))
    tracemalloc.start()
    try:
        with refused("unpacked-too-large", limit=size // 2):
            Trials.read(tmp_path / "cup.csv")
        assert tracemalloc.get_traced_memory()[1] < size / 4
    finally:
        tracemalloc.stop()


def test_xz_whose_dictionary_takes_too_much_memory_is_refused(tmp_path):
    packed = bytes.fromhex(  # Of twelve bytes, and 1.5 GiB that no other program can be asked for
        "fd377a585a000004e6d6b44602002101250000003b787b4101000b742c780a302c310a312c320a00d072908d22bc29310001240ca618d8d8"
        "1fb6f37d010000000004595a"
    )
    with refused("dictionary-too-large"):
        read(tmp_path, packed)
    small = lzma.compress(b"t,x\n0,1\n") + bytes(8) + lzma.compress(b"1,2\n2,3\n")
    (trial,) = read(tmp_path, small, "cup.csv.xz")
    assert (trial.object, len(trial)) == ("cup", 3)


AMBIGUOUS = "time;x\n0;998\n1;999\n2;1,000\n"


def test_numbers_that_may_be_thousands_are_asked_about(tmp_path):
    with refused("decimal-mark-ambiguous", cell="1,000", ways="1000 or 1"):
        read(tmp_path, AMBIGUOUS)
    assert read(tmp_path, AMBIGUOUS, decimal=".")[0].states[:, 0].tolist() == [998, 999, 1000]
    assert read(tmp_path, AMBIGUOUS, decimal=",")[0].states[:, 0].tolist() == [998, 999, 1]
    with refused("decimal-mark-ambiguous", cell="1,000"):
        read(tmp_path, "time;x\n0;998\n0,5;999\n1,5;1,000\n")
    with refused("decimal-mark-ambiguous", cell="1,000"):
        read(tmp_path, 'time,x\n0,998.5\n1,999\n2,"1,000"\n')


@pytest.mark.parametrize(
    ("cells", "values"),
    [
        (["1,234", "0,234", "2,345"], [1.234, 0.234, 2.345]),
        (["1,234", "1234", "2,345"], [1.234, 1234, 2.345]),
        (["1,234", "1,234,567", "2"], [1234, 1234567, 2]),
        (["1,234.5", "1,234", "2"], [1234.5, 1234, 2]),
        (["1.234", "2.345", "3.456"], [1.234, 2.345, 3.456]),
        (["1e3", "-2,5e-3", "+4"], [1000, -0.0025, 4]),
    ],
)
def test_another_cell_settles_what_a_comma_is(tmp_path, cells, values):
    table = "time;x\n" + "".join(f"{i};{cell}\n" for i, cell in enumerate(cells))
    assert read(tmp_path, table)[0].states[:, 0].tolist() == values


def test_other_columns_settle_what_a_comma_is_and_not_what_a_point_is(tmp_path):
    with refused("decimal-mark-ambiguous", cell="1.000", ways="1 or 1000"):
        read(tmp_path, "t;x\n0;1,5\n1;1.000\n2;2,5\n")
    table = "time;x;y\n0;1,234;0,5\n1;2,345;1,5\n2;3,456;2,5\n"
    assert read(tmp_path, table)[0].states[:, 0].tolist() == [1.234, 2.345, 3.456]
    with refused("decimal-mark-ambiguous", cell="1.234", ways="1.234 or 1234"):
        read(tmp_path, "time;x;y\n0;1.234;0,5\n1;2.345;1,5\n2;3.456;2,5\n")


@pytest.mark.parametrize("mark", ["-", "NA", "n.d.", "#N/A", "NaN", "n/a", "#DIV/0!", "\u2013"])
def test_marks_of_missing_values_are_counted(tmp_path, mark):
    later = "".join(f"{i},{i},{i}\n" for i in range(4, 8))
    trials = read(tmp_path, f"time,x,y\n0,1,1\n1,{mark},2\n2,{mark},2\n3,2,3\n" + later)
    assert np.isnan(trials[0].states[:, 0]).tolist() == [False, True, True, *[False] * 5]
    assert f"read as missing in x: {mark!r} in 2 cells" in trials.notes[0]


@pytest.mark.parametrize("mark", ["BLQ", "<LOD", ">100", "bql"])
def test_censored_values_are_refused_with_the_option_that_reads_them(tmp_path, mark):
    table = f"time,x\n0,1\n1,{mark}\n2,{mark}\n3,2\n4,3\n5,4\n"
    with pytest.raises(CommonlawError) as refused:
        read(tmp_path, table)
    assert f"row 2 (line 3), cup, trial 1: {mark!r} is beyond a limit of quantification" in str(refused.value)
    assert f"missing={mark!r}" in str(refused.value)
    trials = read(tmp_path, table, missing=mark)
    assert trials[0].states[:, 0].tolist() == [1, 2, 3, 4]
    assert f"read as missing in x: {mark!r} in 2 cells" in trials.notes[0]


def test_a_number_may_mark_missing_values(tmp_path):
    table = "time,x,y\n0,1,-999\n1,-999.0,2\n2,3,4\n3,4,5\n4,4,5\n5,5,5\n"
    for trials in (
        read(tmp_path, table, missing=-999),
        Trials.from_frame(pd.read_csv(tmp_path / "cup.csv"), missing=["-999"]),
    ):
        assert np.argwhere(np.isnan(trials[0].states)).tolist() == [[0, 1], [1, 0]]
        assert any("read as missing" in note for note in trials.notes)


def test_different_units_in_cells_are_refused(tmp_path):
    with refused("cell-in-other-unit", cell="1 s"):
        read(tmp_path, "time,x\n1 s,1\n1500 ms,2\n2 s,3\n")
    with refused("units-differ", header="s", cells="min"):
        read(tmp_path, "time [s],x\n1 min,1\n2 min,2\n")


@pytest.mark.parametrize(
    ("stamps", "unit", "times"),
    [
        (["31.03.2024 01:30:00", "31.03.2024 01:32:00", "01.04.2024 00:00:00"], "s", [0, 120, 81_000]),
        (["3/31/2024 11:30 AM", "3/31/2024 12:30 PM", "4/1/2024 12:30 AM"], "s", [0, 3600, 46_800]),
        (["03/31/24", "04/01/24", "04/02/24"], "day", [0, 1, 2]),
        (["31/12/1999", "01/01/2000", "02/01/2000"], "day", [0, 1, 2]),
        (["2024/03/31", "2024/04/01", "2024/04/02"], "day", [0, 1, 2]),
        (["31-Mar-2024", "1-Apr-2024", "2-Apr-2024"], "day", [0, 1, 2]),
        (["Mar 31, 2024 00:00:00.5", "Mar 31, 2024 00:00:01", "April 1, 2024 00:00:00"], "s", [0, 0.5, 86399.5]),
        (["01.04.2024", "02.04.2024", "03.04.2024"], "day", [0, 1, 2]),
        (["1:30:00", "1:30:30", "26:00:00"], "s", [5400, 5430, 93_600]),
        (["0:00.5", "0:59.5", "1:00.25"], "s", [0.5, 59.5, 60.25]),
        (["11:59:59 PM", "12:00:01 AM", "12:00:02 AM"], "s", [86_399, 86_401, 86_402]),
        (["23:59:59", "0:00:01", "0:00:02"], "s", [86_399, 86_401, 86_402]),
        (["0 days 00:00:01.5", "1 days 00:00:00", "1 days 00:00:01"], "s", [1.5, 86_400, 86_401]),
        ([1711848600000, 1711848600500, 1711848601000], "s", [0, 0.5, 1]),
        ([1711848600, 1711848601, 1711848602], "s", [0, 1, 2]),
        ([1711843200, 1711929600, 1712016000], "day", [0, 1, 2]),
    ],
)
def test_dates_and_times_are_read_as_all_rows_allow(tmp_path, stamps, unit, times):
    trials = read(tmp_path, "timestamp;x\n" + "".join(f"{stamp};{i}\n" for i, stamp in enumerate(stamps)))
    assert trials[0].times.tolist() == times
    assert trials.schema.units == {"timestamp": unit}
    assert any(note.startswith("timestamp: ") for note in trials.notes)


def test_an_ambiguous_order_of_day_and_month_is_asked_about(tmp_path):
    table = "date,x\n" + "".join(f"0{i}/0{i + 1}/2024,{i}\n" for i in (1, 2, 3))
    with refused("dates-ambiguous", first="01/02/2024", ways="2024-02-01 or 2024-01-02"):
        read(tmp_path, table)
    assert read(tmp_path, table, dates="dmy")[0].times.tolist() == [0, 30, 62]
    assert read(tmp_path, table, dates="mdy")[0].times.tolist() == [0, 32, 62]
    with refused("date-unreadable", column="date", row="row 3 (line 4)", cell="13/13/2024", kind="a date"):
        read(tmp_path, table.replace("03/04", "13/13"))
    with refused("dates-without-order"):
        read(tmp_path, table.replace("01/02", "01/20").replace("03/04", "20/01"))


def test_hours_and_minutes_are_asked_about(tmp_path):
    table = "time,x\n0:30,1\n0:31,2\n1:00,3\n"
    with refused("times-ambiguous", cell="0:30"):
        read(tmp_path, table)
    assert read(tmp_path, table, dates="h:mm")[0].times.tolist() == [1800, 1860, 3600]
    assert read(tmp_path, table, dates="m:ss")[0].times.tolist() == [30, 31, 60]


@pytest.mark.parametrize("header", ["Date,Time,x", "Time,Clock,x"])
def test_date_and_time_of_day_in_two_columns_are_one_time(tmp_path, header):
    table = f"{header}\n31.03.2024,23:58,1\n31.03.2024,23:59,2\n01.04.2024,0:01,3\n"
    trials = read(tmp_path, table)
    assert trials[0].times.tolist() == [0, 60, 180]
    assert trials.schema.states == ("x",)
    assert "taken together" in "; ".join(trials.notes)


def test_a_date_that_is_the_trial_is_no_part_of_the_time(tmp_path):
    days = "".join(f"2024-03-{day},0:00:0{i},{i}\n" for day in (30, 31) for i in range(3))
    trials = read(tmp_path, "Date,Time,x\n" + days, trial="Date")
    assert [trial.times.tolist() for trial in trials] == [[0, 1, 2], [0, 1, 2]]


def test_dates_and_years_that_are_columns_are_times(tmp_path):
    table = "land,lat,01/30/20,01/31/20,02/01/20,02/02/20,02/03/20,02/04/20\nA,1.5,3,4,,6,7,8\nB,2.5,5,6,7,8,9,9\n"
    trials = read(tmp_path, table)
    assert trials.objects == ("A", "B")
    assert [trial.times.tolist() for trial in trials] == [[0, 1, 3, 4, 5], [0, 1, 2, 3, 4, 5]]
    assert trials[0].states[:, 0].tolist() == [3, 4, 6, 7, 8]
    assert (trials.schema.time, trials.schema.states, trials.schema.units) == ("time", ("value",), {"time": "day"})
    assert trials.properties == {"A": {"lat": 1.5}, "B": {"lat": 2.5}}
    assert read(tmp_path, table, wide="cases").schema.states == ("cases",)
    table = 'Country,Code,1990,1991,1992\n"Korea, Rep.",KOR,1,2,3\nChad,TCD,2,3,4\n'
    trials = read(tmp_path, table)
    assert trials.objects == ("Korea, Rep.", "Chad")
    assert trials[1].times.tolist() == [1990, 1991, 1992]
    assert trials.schema.units == {"time": "year"}


def test_numbers_of_replicates_go_behind_their_groups_in_the_row_above(tmp_path):
    rows = [
        "{:g},{:.3f},{:.3f},{:.3f},{:.3f}".format(t, *(np.exp(k * t) for k in (0.5, 0.51, 0.2, 0.21))) for t in range(8)
    ]
    path = text(tmp_path / "od.csv", "\n".join([",Control,,Treated,", "Time (h),1,2,1,2", *rows]))
    trials = Trials.read(path)
    assert trials.objects == ("Control 1", "Control 2", "Treated 1", "Treated 2")
    sheet = [[None, "Control", None, "Treated", None], ["Time (h)", 1, 2, 1, 2]]
    sheet += [[*map(float, row.split(","))] for row in rows]
    assert Trials.read(workbook(tmp_path / "od.xlsx", {"A": sheet})).objects == trials.objects
    path.write_text(path.read_text().replace("1,2,1,2", "S,P,S,P"))  # Quantities are not to become objects
    trials = Trials.read(path)
    assert (trials.objects, trials.schema.states) == (("Control", "Treated"), ("S", "P"))
    path.write_text(path.read_text().partition("\n")[2])
    with refused("header-twice"):
        Trials.read(path)


@pytest.mark.parametrize(("names", "unit"), [("Day {}", "d"), ("{} h", "h"), ("Week {}", "week")])
def test_columns_of_elapsed_times_are_times(tmp_path, names, unit):
    days = [0, 3, 7, 10]
    header = ["Mouse", "Group", *(names.format(day) for day in days)]
    rows = [f"M{i},{'drug' if i > 1 else 'vehicle'},{i},{2 * i},{3 * i},{4 * i}" for i in (1, 2, 3)]
    trials = Trials.read(text(tmp_path / "volume.csv", "\n".join([",".join(header), *rows])))
    assert [trial.times.tolist() for trial in trials] == [days] * 3
    assert trials.select(object="M2")[0].states[:, 0].tolist() == [2, 4, 6, 8]
    assert (trials.schema.units, trials.properties["M3"]) == ({"time": unit}, {"Group": "drug"})


def test_a_table_with_times_keeps_columns_of_conditions(tmp_path):
    content = "Time (min),Cell,0 h,24 h,48 h\n" + "\n".join(f"{t},a,{t},{t * t},{t + 1}" for t in range(6))
    assert Trials.read(text(tmp_path / "aged.csv", content)).schema.time == "Time"
