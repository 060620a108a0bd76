"""Dates in the column of times."""

import datetime as dt

import numpy as np
import pandas as pd
import polars as pl
import pytest

from commonlaw.trials import Trials, TrialStream
from tests.refusals import message, refused

DAYS = pd.to_datetime(["2020-02-27", "2020-02-28", "2020-02-29", "2020-03-02"])
MINUTES = pd.date_range("2020-03-28 23:59", periods=4, freq="90s")
X = np.array([4.0, 3.0, 2.5, 2.2])


def frame(times, name="date"):
    return pd.DataFrame({name: times, "x": X})


@pytest.mark.parametrize(
    "table",
    [
        frame(DAYS),
        frame(DAYS.date),
        frame(DAYS.strftime("%Y-%m-%d")),
        frame(DAYS.strftime(" %Y-%m-%dT00:00 ")),
        frame(DAYS, "Datetime"),
        frame(DAYS.as_unit("s"), "time"),
        pl.DataFrame({"timestamp": DAYS.to_numpy(), "x": X}),
        frame(DAYS[[3, 2, 1, 0]]),
    ],
)
def test_dates_are_days_since_the_earliest(table):
    trials = Trials.from_frame(table)
    assert trials[0].times.tolist() == [0, 1, 2, 4]
    name = trials.schema.time
    assert trials.schema.units == {name: "day"}
    assert trials.notes[0] == f"{name}: dates taken as time in days since 2020-02-27"
    assert trials.schema.states == ("x",)


@pytest.mark.parametrize("suffix", ["csv", "xlsx", "parquet"])
def test_dates_in_files_are_times(tmp_path, suffix):
    path = tmp_path / f"cup.{suffix}"
    writer = {"csv": pd.DataFrame.to_csv, "xlsx": pd.DataFrame.to_excel, "parquet": pd.DataFrame.to_parquet}[suffix]
    writer(frame(DAYS), path, index=False)
    assert Trials.read(path)[0].times.tolist() == [0, 1, 2, 4]
    writer(frame(MINUTES, "when"), path, index=False)
    trials = Trials.read(path, time="when")
    assert trials[0].times.tolist() == [0, 90, 180, 270]
    assert trials.schema.units == {"when": "s"}
    assert trials.notes == ("when: dates taken as time in seconds since 2020-03-28 23:59:00",)


def test_dates_count_from_one_origin_with_their_months_hours_and_zones():
    berlin = MINUTES.tz_localize("Europe/Berlin")
    assert Trials.from_frame(frame(berlin))[0].times.tolist() == [0, 90, 180, 270]
    written = ["2020-03-29T00:30:00+01:00", "2020-03-29T01:30:00Z", "2020-03-29T02:30:00.5Z", "2020-03-29 03:30:01+00"]
    assert Trials.from_frame(frame(written))[0].times.tolist() == [0, 7200, 10800.5, 14401]
    table = pd.concat([frame(DAYS).assign(object="a"), frame(DAYS + pd.Timedelta(10, "D")).assign(object="b")])
    first, second = Trials.from_frame(table)
    assert (second.times - first.times).tolist() == [10] * 4
    assert Trials.from_frame(frame(["2020-01", "2020-02", "2020-03", "2020-04"]))[0].times.tolist() == [0, 31, 60, 91]


@pytest.mark.parametrize(
    ("times", "expected"),
    [
        (
            ["2020-01-01", "2020-13-01", "2020-03-01", "x"],
            message("date-unreadable", column="date", row="row 2", cell="2020-13-01"),
        ),
        (["2020-01-01", "x", "2020-03-01", "x"], message("date-unreadable", column="date", row="row 2", cell="x")),
        (["2020-01-01", "", "2020-03-01", None], message("cell-value", value="is missing")),
        (["01/03/2020"] * 4, message("dates-ambiguous", first="01/03/2020", ways="2020-03-01 or 2020-01-03")),
        (["3/1/20 12:30"] * 4, message("dates-ambiguous", first="3/1/20 12:30", ways="2020-01-03 or 2020-03-01")),
        (["x", "2020-01-01", "1", "2"], message("date-unreadable", column="date", row="row 3", cell="1")),
    ],
)
def test_what_is_no_date_is_refused_with_its_place(times, expected):
    with refused(expected):
        Trials.from_frame(frame(times))


def test_times_of_the_day_and_durations_are_seconds():
    for cells in ([dt.time(0, i) for i in range(4)], [dt.timedelta(minutes=i) for i in range(4)]):
        assert Trials.from_frame(frame(pd.Series(cells, dtype=object)))[0].times.tolist() == [0, 60, 120, 180]
    with refused("date-unreadable", row="row 4", cell="0:61:99"):
        Trials.from_frame(frame(["0:00:00", "0:00:01", "0:00:02", "0:61:99"]))


def test_a_stream_takes_no_dates(tmp_path):
    path = tmp_path / "long.parquet"
    frame(DAYS).assign(object="a", trial="1").to_parquet(path, index=False)
    with refused("dates-in-stream", column="date"):
        TrialStream.from_parquet(path, object="object", trial="trial", time="date", states=["x"])


@pytest.mark.parametrize(
    "times", [[20200330, 20200331, 20200401, 20200402], ["20200330", "20200331", "20200401", "20200402"]]
)
def test_numbers_that_are_dates_are_days(times):
    trials = Trials.from_frame(frame(times))
    assert trials[0].times.tolist() == [0, 1, 2, 3]
    assert trials.schema.units == {"date": "day"}


@pytest.mark.parametrize("times", [[20200129, 20200130, 20200131, 20200132], [20200101.5, 20200102.5, 1e7, 3e7]])
def test_a_number_among_dates_is_refused_and_other_numbers_are_numbers(times):
    if all(float(time).is_integer() for time in times):
        with refused("date-unreadable", column="date", row="row 4", cell="20200132"):
            Trials.from_frame(frame(times))
    else:
        assert Trials.from_frame(frame(times))[0].times.tolist() == sorted(times)


@pytest.mark.parametrize(
    "times",
    [
        ["2020-03-29T00:30+01:00", "2020-03-29T01:30", "2020-03-29T02:30", "2020-03-29T03:30"],
        ["2020-03-29", "2020-03-30 00:00Z", "2020-03-31 00:00Z", "2020-04-01 00:00Z"],
        [*MINUTES[:3], MINUTES.tz_localize("UTC")[3]],
    ],
)
def test_dates_of_which_only_some_have_an_offset_are_refused(times):
    with refused("dates-with-and-without-offset"):
        Trials.from_frame(pd.DataFrame({"date": pd.Series(times, dtype=object), "x": X}))
