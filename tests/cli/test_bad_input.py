"""Every mistake a user can make ends with exit code 1, one message that says where and what to do, and no file."""

import json
import re

import numpy as np
import pytest

import commonlaw as cl

COLUMNS = ["--object", "ball", "--trial", "drop", "--time", "t", "--state", "height"]
QUICK = ("--order", "2", "--library", "poly:1", "--set", "solver=stlsq:0")


def rows(**changes):
    """A table of two balls dropped once, as text, with cells changed by ``row_column``."""
    lines = ["ball,drop,t,height"]
    for ball in ("golf", "tennis"):
        lines += [f"{ball},1,{t},{50 - 4.9 * t**2 + 0.5 * t**3}" for t in np.arange(40) / 15]
    for index, text in changes.items():
        row, column = int(index[1:-1]), "bdth".index(index[-1])
        cells = lines[row].split(",")
        cells[column] = text
        lines[row] = ",".join(cells)
    return "\n".join(lines) + "\n"


CASES = {
    "an empty file": ("", [], "drops.csv.*empty"),
    "no rows": ("ball,drop,t,height\n", [], "drops.csv.*no (data )?rows?|header"),
    "text in a numeric column": (rows(r17h="abc"), [], r"height.*row 17.*line 18.*'abc'"),
    "a missing time": (rows(r9t=""), [], "'t'.*row 9"),
    "an infinite value": (rows(r9h="inf"), [], "height.*row 9"),
    "a row twice": (
        rows(r9t=str(7 / 15), r9h=str(50 - 4.9 * (7 / 15) ** 2 + 0.5 * (7 / 15) ** 3)),
        [],
        "(?i)golf.*(twice|same|duplicate)",
    ),
    "a wrong column": (rows(), ["--state", "hieght"], "'hieght': did you mean 'height'"),
    "a window longer than a trial": (
        rows(),
        ["--order", "2", "--set", "differentiation=savgol:45:3"],
        "golf, trial 1: .*40 samples.*45",
    ),
    "a constant state": (
        re.sub(r"(,1,[^,]*),.*", r"\1,3", rows()),  # Of all objects: one at rest among others is left out
        [],
        "the state 'height' of golf is constant",
    ),
    "an unknown solver": (rows(), ["--set", "solver=stlqs:1"], "unknown solver 'stlqs': did you mean 'stlsq'"),
    "an unknown library": (rows(), ["--library", "ploy:2"], "unknown library 'ploy': did you mean 'poly'"),
    "an unknown differentiation": (
        rows(),
        ["--set", "differentiation=savgo:3"],
        "unknown differentiation 'savgo': did you mean 'savgol'",
    ),
    "a term that is not finite": (rows(), ["--library", "terms:1,1/t"], r"golf, trial 1.*1/t|1/t.*golf, trial 1"),
    "a term that is no expression": (rows(), ["--library", "terms:1,height*"], "height"),
    "code instead of a term": (rows(), ["--library", "terms:__import__('os')"], "__import__"),
    "no such trial": (rows(), ["--where", "drop=3"], "unknown trial '3'"),
    "no such trial to hold out": (rows(), ["--hold-out", "drop=3"], "unknown trial '3'"),
    "nothing left to learn from": (rows(), ["--hold-out", "drop=1"], "all trials meet the conditions"),
    "everything left out": (rows(), ["--exclude", "ball=golf,tennis"], "all trials meet the conditions"),
    "a time before the first sample": (rows(), ["--learn-until", "-1"], "every trial begins after t = -1"),
    "an unknown property to leave out": (rows(), ["--exclude", "self=1"], "unknown property"),
    "no such property": (rows(), ["--where", "mass=3"], "unknown property 'mass'"),
    "a property that is called like a word of Python": (rows(), ["--where", "self=1"], "unknown property 'self'"),
    "a figure of unknown kind": (rows(), ["--save", "law.jpeg"], "law.jpeg: the ending says what is written"),
    "a folder that does not exist": (rows(), ["--save", "nowhere/law.png"], "there is no folder 'nowhere'"),
}


@pytest.mark.parametrize(("text", "options", "message"), CASES.values(), ids=CASES.keys())
def test_discover_refuses(fails, tmp_path, text, options, message):
    (tmp_path / "drops.csv").write_text(text)
    columns = COLUMNS if "--state" not in options else COLUMNS[:-2]
    said = fails("discover", "drops.csv", *columns, *options, "--save", "law.json")
    assert said.startswith("commonlaw: ")
    assert re.search(message, said), said


@pytest.mark.parametrize(("unit", "message"), [("height=metrez", "metrez"), ("speed=m/s", "speed")])
def test_wrong_units_are_refused(fails, tmp_path, unit, message):
    (tmp_path / "drops.csv").write_text(rows())
    assert message in fails("data", "check", "drops.csv", *COLUMNS, "--unit", unit)


def test_a_missing_file_and_one_with_nearly_that_name(fails, tmp_path):
    (tmp_path / "drops.csv").write_text(rows())
    said = fails("discover", "drop.csv", *COLUMNS)
    assert "drop.csv" in said
    assert "drops.csv" in said


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("gravity=abc", "data set 'linear-drag:gravity=abc': gravity is 'abc': give a number"),
        ("noise=abc", "noise is 'abc': give a number"),
        ("drag=(", r"drag is '\(': give a number"),
        ("samples=1e999", "samples is inf: give a whole number"),
        ("seed=-1", "seed is -1: give a whole number"),
        ("nonsense=1", ": write it as"),
    ],
)
def test_options_of_data_sets_that_are_not_numbers_are_refused(fails, options, message):
    said = fails("data", "check", f"dataset:linear-drag:{options}")
    assert re.search(message, said), said


def test_unsorted_times_are_sorted_and_said(run, done, tmp_path):
    lines = rows().splitlines()
    lines[3], lines[9] = lines[9], lines[3]
    (tmp_path / "drops.csv").write_text("\n".join(lines))
    code, out, err = run("discover", "drops.csv", *COLUMNS, *QUICK, "--json")
    assert code == 0
    assert re.search("(?i)sorted", err)
    (tmp_path / "sorted.csv").write_text(rows())
    in_order = done("discover", "sorted.csv", *COLUMNS, *QUICK, "--json")
    assert json.loads(in_order)["law"] == json.loads(out)["law"]


def test_laws_that_cannot_be_read(fails, tmp_path):
    (tmp_path / "drops.csv").write_text(rows())
    (tmp_path / "law.json").write_text('{"format": "commonlaw law", "version": 9}')
    assert "law.json: the law has format version 9" in fails(
        "predict", "drops.csv", "law.json", "--save", "forecast.csv"
    )
    (tmp_path / "law.json").write_text("{")
    assert "law.json: this is not a saved law, or it is damaged" in fails("show", "law.json")
    assert "there is no file 'gone.json'" in fails("show", "gone.json")


def test_a_forecast_that_diverges_is_said_and_written_as_far_as_it_went(run, tmp_path):
    (tmp_path / "drops.csv").write_text(rows())
    runs_away = cl.Law.from_text("height' = k height^2", {"k": {"golf": 1.0, "tennis": 1.0}})
    runs_away.save(tmp_path / "law.json")
    (tmp_path / "roles.toml").write_text('object = "ball"\ntrial = "drop"\n')
    code, _, err = run("predict", "drops.csv", "law.json", "--schema", "roles.toml", "--save", "forecast.csv")
    assert code == 0
    assert "diverged (golf, trial 1): the forecast ran away at t = 0.02" in err
    assert (tmp_path / "forecast.csv").read_text().count("\n") == 81
