"""Folders, names, processes and files that an environment may have."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import commonlaw as cl
from commonlaw.runtime.files import read_file
from tests.refusals import refused

COMMAND = (sys.executable, "-c", "from commonlaw.cli import main; main()")


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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("data check drops.csv", "there is no file 'drops.csv' in '.': check the name"),
        (
            "data export dataset:linear-drag --save new.csv",
            "cannot write new.csv: No such file or directory; choose a folder",
        ),
    ],
)
def test_a_working_folder_that_is_gone_is_said(tmp_path: Path, arguments: str, message: str) -> None:
    (tmp_path / "gone").mkdir()
    script = "import os, sys; os.rmdir(os.getcwd()); from commonlaw.cli import main; main()"
    command = [sys.executable, "-c", script, *arguments.split()]
    ended = subprocess.run(command, cwd=tmp_path / "gone", capture_output=True)
    assert (ended.returncode, ended.stdout) == (1, b"")
    assert ended.stderr.decode().startswith(f"commonlaw: {message}")


def test_tables_are_in_utf_8_whatever_the_locale(tmp_path: Path) -> None:
    (tmp_path / "drops.csv").write_text("t,höhe\n0,5\n1,4\n2,1\n", "utf-8")
    locale = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    code, said = run(tmp_path, "data", "check", "drops.csv", "--json", "--save", "schema.toml", **locale)
    assert code == 0
    assert '"höhe"' in said
    assert '"höhe"' in (tmp_path / "schema.toml").read_text("utf-8")


@pytest.mark.slow
def test_files_whose_names_are_not_utf_8_are_read_written_and_named(folder: Path) -> None:
    (folder / "drops.csv").rename(folder / "\udcfe.csv")
    code, said = run(folder, "predict", b"\xfe.csv", "law.json", "--save", b"\xfd.csv", "--save", b"\xfd.png")
    assert code == 0
    assert r"Wrote \udcfd.csv" + "\n" + r"Wrote \udcfd.png" in said
    assert {each.name for each in folder.iterdir()} >= {"\udcfd.csv", "\udcfd.png"}
    code, said = run(folder, "data", "check", b"\xff.csv")
    assert code == 1
    assert said.startswith(r"commonlaw: there is no file '\udcff.csv' in ")


BYTES = "b\udcff"
"""As Python has the name of a file that is not text in UTF-8."""

QUICK = ["--order", "2", "--library", "poly:1", "--set", "solver=group-stlsq:1.5"]


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize(
    ("words", "written"),
    [
        (["data", "export", "--save", f"{BYTES}.parquet"], f"{BYTES}.parquet"),
        (["discover", *QUICK, *(f"--save={BYTES}.{kind}" for kind in ("json", "svg", "html"))], f"{BYTES}.html"),
        pytest.param(
            ["discover", *QUICK, "--each", "--save", f"{BYTES}-all.csv"], f"{BYTES}-all.csv", marks=pytest.mark.slow
        ),
    ],
)
def test_a_name_of_a_file_may_be_any_bytes(run, tmp_path, words, written):
    frame = cl.datasets.linear_drag(drag=(-0.1,), trials=1, noise=0.01).to_frame()
    frame[["t", "x"]].to_csv(tmp_path / f"{BYTES}.csv", index=False)
    code, _, err = run(*words, f"{BYTES}.csv")
    assert (code, "UnicodeEncodeError" in err) == (0, False)
    assert (tmp_path / written).stat().st_size


WRITING = """
import os, signal, time
from joblib import Parallel, delayed
from commonlaw.runtime.shutdown import put_away_first

signal.signal(signal.{name}, signal.SIG_DFL)  # A shell may have it ignored
others = Parallel(n_jobs=2, return_as="generator")(delayed(time.sleep)(seconds) for seconds in (0, 1000))
next(others)
with put_away_first():
    signal.raise_signal(signal.{name})
    print("put away", flush=True)
print("went on")
"""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", pytest.param("SIGHUP", marks=pytest.mark.slow)])
def test_what_is_begun_is_put_away_where_processes_of_a_pool_are_ended(name: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", WRITING.format(name=name)], capture_output=True, text=True, timeout=60
    )
    assert (ended.returncode, ended.stdout) == (-getattr(signal, name), "put away\n"), ended.stderr


FRAME = pd.DataFrame({"t": [0.0, 1.0, 2.0], "x": [0.0, 1.0, 4.0]})


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    """A pipe that nothing writes to."""
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def test_pipes_and_devices_are_refused(pipe: Path) -> None:
    for path in (pipe, Path("/dev/zero")):
        with refused("file-is-device"):
            read_file(path)


def test_a_pipe_that_a_parquet_file_names_is_not_opened(pipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(pipe.parent)
    kept = json.dumps({"roles": {"properties": pipe.name}}).encode()
    pq.write_table(pa.Table.from_pandas(FRAME).replace_schema_metadata({b"commonlaw": kept}), "drops.parquet")
    for read in (cl.Trials.read, cl.TrialStream.from_parquet):
        with refused("json-syntax"):
            read(Path("drops.parquet"))
