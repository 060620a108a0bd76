"""Every command that writes is killed at random moments: its files are the old ones or whole, and nothing is left."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import commonlaw as cl
from commonlaw.files import write_whole

KILLS = int(os.environ.get("KILLS", "1"))
"""How often each command is killed in each way."""

COMMAND = (sys.executable, "-c", "from commonlaw.cli import main; main()")
COMMANDS = {
    "export to CSV": ("data", "export", "in/drops.csv", "--save", "drops.csv"),
    "export to Parquet": ("data", "export", "in/drops.csv", "--save", "drops.parquet"),
    "predict": ("predict", "in/law.json", "in/drops.csv", "--save", "forecast.csv", "--plot", "forecast.svg"),
    "refine": ("refine", "in/law.json", "in/drops.csv", "--save", "law.json"),
    "fit": ("fit", "x'' = -g - c v", "in/drops.csv", "--save", "law.json"),
    "discover": ("discover", "in/drops.csv", "--order", "2", "--solver", "group-stlsq:1", "--save", "law.json"),
}
OLD = b"what was there before"


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a table and its law."""
    folder = tmp_path_factory.mktemp("in")
    cl.datasets.linear_drag(drag=(-0.1, -0.3), noise=0.01).to_csv(folder / "drops.csv")
    law = cl.datasets.truth_of("linear-drag").select(["Ball 1", "Ball 2"])
    law.save(folder / "law.json")
    return folder


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_that_is_killed_leaves_old_files_or_whole_ones(tmp_path: Path, inputs: Path, command: str) -> None:
    whole, seconds = run_to_the_end(tmp_path, inputs, COMMANDS[command])
    for seed in range(KILLS):
        # Once at any moment, and once in the midst of writing
        for how, delay in ((signal.SIGTERM, random.Random(seed).uniform(0.2, 1.1) * seconds), (signal.SIGKILL, None)):
            for name in whole:
                (tmp_path / name).write_bytes(OLD)
            kill(start(tmp_path, COMMANDS[command]), how, delay, tmp_path)
            for name, content in whole.items():
                assert (tmp_path / name).read_bytes() in (OLD, content), (name, how, delay)
            write_whole(tmp_path / "next", b"")
            assert {each.name for each in tmp_path.iterdir()} == {"in", "next", *whole}


def run_to_the_end(folder: Path, inputs: Path, arguments: tuple[str, ...]) -> tuple[dict[str, bytes], float]:
    """Return what a command writes by name of file, and how long it takes."""
    (folder / "in").symlink_to(inputs)
    began = time.monotonic()
    assert start(folder, arguments).wait() == 0
    seconds = time.monotonic() - began
    return {each.name: each.read_bytes() for each in folder.iterdir() if each.is_file()}, seconds


def start(folder: Path, arguments: tuple[str, ...]) -> "subprocess.Popen[bytes]":
    return subprocess.Popen([*COMMAND, *arguments], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def kill(process: "subprocess.Popen[bytes]", how: signal.Signals, delay: float | None, folder: Path) -> None:
    """End a process after some seconds, or as soon as it has begun to write."""
    began = time.monotonic()
    while process.poll() is None:
        if time.monotonic() > began + delay if delay else any(folder.glob(".commonlaw-*")):
            process.send_signal(how)
            process.wait()
        time.sleep(0.001)
