"""Many files in one call: a law for each, one table of all."""

import os
import re
import time
from contextlib import closing
from html import unescape

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.cli.batch import COLUMNS, in_processes

QUICK = ["--order", "2", "--library", "poly:1", "--state", "x"]


@pytest.fixture
def tables(tmp_path):
    """Two tables of a ball each, and one that cannot be read."""
    for i, drag in enumerate((-0.2, -0.6)):
        cl.datasets.linear_drag(drag=(drag,), noise=0.01, trials=2, seed=i).to_csv(tmp_path / f"{i}.csv")
    (tmp_path / "bad.csv").write_text("t,x\n0,1\n1,two\n")


@pytest.mark.usefixtures("tables", "undrawn")
def test_files_without_each_have_one_law_and_so_has_their_folder(run, done, tmp_path):
    (tmp_path / "bad.csv").unlink()
    (tmp_path / "runs").mkdir()
    for i in range(2):
        frame = cl.Trials.read(tmp_path / f"{i}.csv").to_frame()
        frame[["trial", "t", "x"]].to_csv(tmp_path / "runs" / f"ball{i}.csv", index=False)
    words = ("runs/ball0.csv", "runs/ball1.csv", *QUICK, "--set", "solver=group-stlsq:1")
    code, out, _ = run("discover", *words, "--save", "law.json", "--save", "page.html")
    law = cl.Law.load(tmp_path / "law.json")
    assert (code, law.objects) == (0, ("ball0", "ball1"))
    assert out.startswith("4 trials of 2 objects")
    page = unescape((tmp_path / "page.html").read_text())
    assert "cl.Trials.read(['runs/ball0.csv', 'runs/ball1.csv']" in re.sub("<[^>]*>", "", page)
    assert run("data", "check", "runs", "--state", "x")[1].startswith("runs: 4 trials of 2 objects")
    done("check", "runs", "law.json")


@pytest.mark.usefixtures("tables")
def test_each_file_has_its_law_and_a_bad_one_says_what_is_wrong(run, tmp_path):
    code, out, err = run(
        "discover", "0.csv", "bad.csv", "1.csv", "--each", *QUICK, "--set", "n_jobs=1", "--save", "r.csv"
    )
    assert (
        "Note: in 2 (0.csv, 1.csv): columns recognized as time: t; object: object; trial: trial; state: x; property: "
        in err
    )
    assert (code, out.splitlines()[-2:]) == (0, ["2 laws in 3 files", "Wrote r.csv"])
    found = pd.read_csv(tmp_path / "r.csv")
    assert tuple(found.columns) == COLUMNS
    assert found["file"].tolist() == ["0.csv"] * 2 + ["bad.csv"] + ["1.csv"] * 2
    for name in ("0.csv", "1.csv"):
        trials = cl.Trials.read(tmp_path / name, states=["x"])
        law = cl.discover(trials, order=2, library="poly:1")
        rows, expected = found[found["file"] == name], law.conf_int()
        for column, of_law in (("value", "estimate"), *((each,) * 2 for each in ("standard error", "low", "high"))):
            np.testing.assert_allclose(rows[column], expected[of_law], rtol=1e-9)
        assert rows["term"].tolist() == ["1", "v"]
        assert rows["unit"].tolist() == ["m/s²", "1/s"]
        assert set(rows["verdict"]) == {law.assess(trials).sentences[0]}
        assert rows["error"].isna().all()
    bad = found[found["file"] == "bad.csv"].iloc[0]
    assert "'two' is not a number" in bad["error"]
    assert bad.drop(["file", "error"]).isna().all()


@pytest.mark.usefixtures("tables")
def test_where_no_file_has_a_law_the_command_fails_and_the_table_says_why(run, tmp_path):
    code, _, err = run("discover", "bad.csv", "none.csv", "--each", "--set", "n_jobs=1", "--save", "r.parquet")
    assert (code, err) == (1, "commonlaw: no file has a law\n")
    errors = pd.read_parquet(tmp_path / "r.parquet")["error"].tolist()
    assert "--state ..." in errors[0]  # in the words of the command line
    assert "there is no file 'none.csv'" in errors[1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["a.csv", "--each", "--save", "p.svg", "--json"], "--save p.svg and --json for a single file"),
        (["dataset:lorenz", "--each"], "--each takes files"),
    ],
)
def test_what_does_not_go_together_is_refused(run, words, said):
    code, _, err = run("discover", *words)
    assert (code, said in " ".join(err.split())) == (2, True)


def test_a_table_of_another_format_is_refused_before_anything_is_done(fails):
    assert "commonlaw: r.ods: the ending says what is written" in fails(
        "discover", "a.csv", "--each", "--save", "r.ods"
    )


class _Unreadable:
    """What can be pickled, but not read back."""

    def __reduce__(self):
        return int, ("three",)


def _piece(number):
    if number == 4:
        return _Unreadable()
    if number == 5:
        return lambda: number
    if number == 1:
        os._exit(3)
    if number == 2:
        raise ZeroDivisionError("two")
    return number


def test_a_process_that_ends_by_itself_costs_its_own_piece_alone():
    *found, unreadable, unpicklable = sorted(in_processes(_piece, range(6), at_once=1))
    assert (unreadable[1], unpicklable[1]) == (None, None)
    assert "three" in unreadable[2]
    assert unpicklable[2]
    assert found == [
        (0, 0, ""),
        (1, None, "its process ended by itself, with code 3: is there enough memory?"),
        (2, None, "ZeroDivisionError: two"),
        (3, 3, ""),
    ]


def _quick_or_endless(number):
    while number:
        time.sleep(1)
    return os.getpid()


def test_processes_end_when_nobody_waits_for_them():
    with closing(in_processes(_quick_or_endless, [0, 1], at_once=1)) as answers:
        process = next(answers)[1]
        os.kill(process, 0)
    with pytest.raises(ProcessLookupError):
        os.kill(process, 0)
