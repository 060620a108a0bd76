"""Commands end as they say, whatever their standard streams are connected to and can show."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import commonlaw as cl

NAME = "日本 µ\U0001f3c0 €"
COMMAND = f"{sys.executable} -c 'from commonlaw.cli import main; main()'"
CANNOT = (
    "commonlaw: cannot write to standard output: {}; keep it open, and direct it to a place with free space "
    "[commonlaw help standard-output]\n"
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a table and a law whose object has letters that not every encoding has."""
    folder = tmp_path_factory.mktemp("streams")
    frame = cl.datasets.linear_drag(drag=(-0.1,), noise=0.01).to_frame()
    trials = cl.Trials.from_frame(frame.assign(object=NAME), states=["x"])
    trials.to_csv(folder / "drops.csv")
    law = cl.discover(trials, order=2, library="poly:1", method=cl.DerivativeRegression(solver="group-stlsq:1"))
    law.save(folder / "law.json")
    return folder


def run(folder: Path, arguments: str, encoding: str = "utf-8") -> "subprocess.CompletedProcess[bytes]":
    """Run a command in a shell, which knows how to close and redirect streams."""
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    return subprocess.run(["sh", "-c", f"{COMMAND} {arguments}"], cwd=folder, capture_output=True, env=environment)


CLOSED, FULL = (">&-", "Bad file descriptor"), (">/dev/full", "No space left on device")


@pytest.mark.parametrize(
    ("arguments", "redirected", "reason"),
    [
        ("show law.json", *CLOSED),
        pytest.param("data check drops.csv", *FULL, marks=pytest.mark.slow),
        ("--help", *FULL),
    ],
)
def test_results_that_standard_output_does_not_take_are_missed(
    folder: Path, arguments: str, redirected: str, reason: str
) -> None:
    ended = run(folder, f"{arguments} {redirected}")
    *progress, last = ended.stderr.decode().splitlines(keepends=True)
    assert (ended.returncode, last) == (1, CANNOT.format(reason))
    assert all(" ... " in line for line in progress)


@pytest.mark.parametrize(
    ("redirected", "arguments", "code"),
    [("<&- 2>&-", "show absent.json", 1), ("2>/dev/full", "--absent", 2)],
)
def test_the_exit_code_remains_where_standard_error_takes_nothing(
    folder: Path, arguments: str, code: int, redirected: str
) -> None:
    assert run(folder, f"{arguments} {redirected}").returncode == code


def test_files_are_written_where_nothing_can_be_said(folder: Path, tmp_path: Path) -> None:
    ended = run(folder, f"predict drops.csv law.json --save {tmp_path / 'forecast.csv'} >&- 2>&-")
    assert (ended.returncode, ended.stdout, ended.stderr) == (1, b"", b"")
    assert (tmp_path / "forecast.csv").read_text().count("\n") > 10


def test_a_reader_that_has_enough_ends_the_command_without_a_word(folder: Path) -> None:
    ended = run(folder, "data list | head -c 10")
    assert (len(ended.stdout), ended.stderr) == (10, b"")


def test_letters_that_an_encoding_lacks_are_shown_as_json_writes_them(folder: Path) -> None:
    ended = run(folder, "data check drops.csv", "cp1252")
    assert ended.returncode == 0
    assert "\\u65e5\\u672c \xb5\\ud83c\\udfc0 \u20ac" in ended.stdout.decode("cp1252")


def test_json_keeps_letters_that_an_encoding_lacks(folder: Path) -> None:
    check = json.loads(run(folder, "data check drops.csv --json", "ascii").stdout.decode("ascii"))
    assert check["trials"][0]["object"] == NAME
