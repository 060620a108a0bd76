"""What has to be put away is, whatever the processes are that have to be ended with this one."""

import signal
import subprocess
import sys

import pytest

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


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_what_is_begun_is_put_away_where_processes_of_a_pool_are_ended(name: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", WRITING.format(name=name)], capture_output=True, text=True, timeout=60
    )
    assert (ended.returncode, ended.stdout) == (-getattr(signal, name), "put away\n"), ended.stderr
