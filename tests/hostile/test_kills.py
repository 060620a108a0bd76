"""Every command that writes is ended at random moments: its files are the old ones or whole, and nothing is left."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.runtime.files import write_whole
from tests.served import PATIENCE, gone

KILLS = int(os.environ.get("KILLS", "1"))
"""How often each command is ended in each way."""

TOLD, KILLED = (signal.SIGTERM, signal.SIGINT), signal.SIGKILL
"""What a command is told to end by, and what it cannot hear."""

COMMAND = (sys.executable, "-c", "from commonlaw.cli import main; main()")
COMMANDS = {
    "export to CSV": ("data", "export", "in/drops.csv", "--save", "drops.csv"),
    "export to Parquet": ("data", "export", "in/drops.csv", "--save", "drops.parquet"),
    "predict": ("predict", "in/drops.csv", "in/law.json", "--save", "forecast.csv", "--save", "forecast.svg"),
    "refine": ("refine", "in/drops.csv", "in/law.json", "--save", "law.json"),
    "fit": ("fit", "in/drops.csv", "x'' = -g - c v", "--save", "law.json"),
    "discover": ("discover", "in/drops.csv", "--order", "2", "--set", "solver=group-stlsq:1", "--save", "law.json"),
    "discover in processes": (
        "discover", "in/drops.csv", "--order", "2", "--set", "solver=group-stlsq:1", "--set", "n_jobs=2",
        "--save", "law.json",
    ),
    "discover in each of two tables": (
        "discover", "in/drops.csv", "in/again.csv", "--each", "--set", "n_jobs=2", "--order", "2", "--set",
        "solver=group-stlsq:1", "--save", "laws.csv",
    ),
    "export a workbook": ("data", "export", "in/drops.xlsx", "--save", "drops.csv"),
}  # fmt: skip
QUICK = "export to CSV"

OLD = b"what was there before"


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a table and its law."""
    folder = tmp_path_factory.mktemp("in")
    cl.datasets.linear_drag(drag=(-0.1, -0.3), noise=0.01).to_csv(folder / "drops.csv")
    (folder / "again.csv").write_bytes((folder / "drops.csv").read_bytes())
    pd.read_csv(folder / "drops.csv").to_excel(folder / "drops.xlsx", index=False)
    law = cl.law.select_objects(cl.datasets.truth_of("linear-drag"), ["Ball 1", "Ball 2"])
    law.save(folder / "law.json")
    return folder


@pytest.mark.parametrize(
    "command", [each if each == QUICK else pytest.param(each, marks=pytest.mark.slow) for each in COMMANDS]
)
def test_a_command_that_is_ended_leaves_old_files_or_whole_ones_and_no_process(
    tmp_path: Path, inputs: Path, command: str
) -> None:
    whole, seconds = run_to_the_end(tmp_path, inputs, COMMANDS[command])
    longest = 0.0
    for seed in range(KILLS):
        # Once at any moment, and once in the midst of writing
        r = random.Random(f"{command} {seed}")
        for how, delay in ((r.choice(TOLD), r.uniform(0.05, 1.1) * seconds), (r.choice([*TOLD, KILLED]), None)):
            for name in whole:
                (tmp_path / name).write_bytes(OLD)
            process = start(tmp_path, COMMANDS[command])
            longest = max(longest, end(process, how, delay, tmp_path))
            assert gone(process.pid), (how, delay)
            for name, content in whole.items():
                found = (tmp_path / name).read_bytes()
                if name == "law.json" and found != OLD:  # It is saved when it is found, and again when it is judged
                    assert set(json.loads(found)) == set(json.loads(content))
                else:
                    assert found in (OLD, content), (name, how, delay)
            if how == KILLED:
                write_whole(tmp_path / "next", b"")
            assert {each.name for each in tmp_path.iterdir()} - {"next"} == {"in", *whole}, (how, delay)
    print(f"{command}, {2 * KILLS} times: ended within {longest:.2f} s")


@pytest.mark.slow
def test_an_interrupt_from_a_terminal_ends_all_processes_and_writes_nothing(tmp_path: Path) -> None:
    for i in range(6):
        cl.datasets.linear_drag(noise=0.1, trials=1, seed=i).to_csv(tmp_path / f"{i}.csv")
    files = [f"{i}.csv" for i in range(6)]
    words = ["discover", *files, "--each", "--order", "2", "--save", "r.csv", "--set", "n_jobs=2"]
    streams = {"stderr": subprocess.PIPE, "stdout": subprocess.DEVNULL}
    command = subprocess.Popen([*COMMAND, "-v", *words], cwd=tmp_path, start_new_session=True, **streams)
    assert command.stderr is not None
    for _ in ("the processes are started", "one file is done"):
        command.stderr.readline()
    os.killpg(command.pid, signal.SIGINT)  # As Ctrl-C does: to all of them
    _, said = command.communicate(timeout=120)
    assert command.returncode != 0
    assert b"Traceback" not in said
    assert not (tmp_path / "r.csv").exists()
    assert gone(command.pid)


def run_to_the_end(folder: Path, inputs: Path, arguments: tuple[str, ...]) -> tuple[dict[str, bytes], float]:
    """Return what a command writes by name of file, and how long it takes."""
    (folder / "in").symlink_to(inputs)
    began = time.monotonic()
    assert start(folder, arguments).wait() == 0
    seconds = time.monotonic() - began
    return {each.name: each.read_bytes() for each in folder.iterdir() if each.is_file()}, seconds


def start(folder: Path, arguments: tuple[str, ...]) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(
        [*COMMAND, *arguments], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    )


def end(process: "subprocess.Popen[bytes]", how: signal.Signals, delay: float | None, folder: Path) -> float:
    """End a process after some seconds, or as soon as it has begun to write; return the seconds that it then took."""
    began, told = time.monotonic(), 0.0
    while process.poll() is None:
        if time.monotonic() > began + delay if delay else any(folder.glob(".commonlaw-*")):
            process.send_signal(how)
            told = time.monotonic()
            assert process.wait(PATIENCE) in (-how, 0)  # it may have come to its end
            return time.monotonic() - told
        time.sleep(0.001)
    return 0.0
