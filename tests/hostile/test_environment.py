"""Commands in odd surroundings do what they say, or refuse with what to do."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import commonlaw as cl

COMMAND = (sys.executable, "-c", "from commonlaw.cli import main; main()")
LONG = "a" * 300


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a table and its law."""
    cl.datasets.linear_drag(noise=0.01).to_csv(tmp_path / "drops.csv")
    cl.datasets.truth_of("linear-drag").save(tmp_path / "law.json")
    return tmp_path


def run(folder: Path, *arguments: str | bytes, **environment: str) -> tuple[int, str]:
    """Run a command; return its exit code, and what it says."""
    surroundings = os.environ | {"PYTHONIOENCODING": "utf-8"} | environment
    ended = subprocess.run([*COMMAND, *arguments], cwd=folder, env=surroundings, capture_output=True)
    return ended.returncode, (ended.stdout + ended.stderr).decode().strip()


def test_a_back_end_that_matplotlib_does_not_know_is_refused_before_any_work(folder: Path) -> None:
    arguments = ("discover", "drops.csv", "--order", "2", "--save", "new.json", "--save", "new.png")
    code, said = run(folder, *arguments, MPLBACKEND="nonsense")
    assert code == 1
    assert said.startswith("commonlaw: matplotlib cannot start: Key backend: 'nonsense'")
    assert "; unset the environment variable MPLBACKEND [" in said
    assert not (folder / "new.json").exists()


NOT_WRITTEN = "cannot write new.csv: No such file or directory; choose a folder"
GONE = {
    ("data", "check", "drops.csv"): "there is no file 'drops.csv' in '.': check the name",
    ("predict", "drops.csv", "law.json", "--save", "new.csv"): NOT_WRITTEN,
    ("data", "export", "dataset:linear-drag", "--save", "new.csv"): NOT_WRITTEN,
}


@pytest.mark.parametrize("arguments", GONE)
def test_a_working_folder_that_is_gone_is_said(tmp_path: Path, arguments: tuple[str, ...]) -> None:
    (tmp_path / "gone").mkdir()
    script = "import os, sys; os.rmdir(os.getcwd()); from commonlaw.cli import main; main()"
    ended = subprocess.run([sys.executable, "-c", script, *arguments], cwd=tmp_path / "gone", capture_output=True)
    assert (ended.returncode, ended.stdout) == (1, b"")
    assert ended.stderr.decode().startswith(f"commonlaw: {GONE[arguments]}")


@pytest.mark.slow
def test_files_whose_names_are_not_utf_8_are_read_written_and_named(folder: Path) -> None:
    (folder / "drops.csv").rename(folder / "\udcfe.csv")
    code, said = run(folder, "predict", "law.json", b"\xfe.csv", "--save", b"\xfd.csv", "--save", b"\xfd.png")
    assert code == 0
    assert r"Wrote \udcfd.csv" + "\n" + r"Wrote \udcfd.png" in said
    assert {each.name for each in folder.iterdir()} >= {"\udcfd.csv", "\udcfd.png"}
    code, said = run(folder, "data", "check", b"\xff.csv")
    assert code == 1
    assert said.startswith(r"commonlaw: there is no file '\udcff.csv' in ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("show", LONG), "cannot read"),
        (("data", "check", LONG), "cannot read"),
        (("predict", f"{LONG}/drops.csv", "law.json"), "cannot read"),
        (("data", "export", "drops.csv", "--save", f"{LONG}.csv"), "cannot write"),
        (("refine", "drops.csv", "law.json", "--save", f"{LONG}/law.json"), "cannot write"),
    ],
)
def test_names_that_are_too_long_are_refused(folder: Path, arguments: tuple[str, ...], message: str) -> None:
    code, said = run(folder, *arguments)
    assert code == 1
    assert said.startswith(f"commonlaw: {message} aaa")
    assert "File name too long; " in said
