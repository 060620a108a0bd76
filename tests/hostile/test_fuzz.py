"""Hostile cases end as what they ask for or in a refusal, whatever they are; `make fuzz` runs many more."""

import os
import subprocess
import sys
from pathlib import Path

from tests.hostile.cases import KINDS

CASES = len(KINDS)
"""One of each kind."""


def test_hostile_cases_are_done_or_refused_in_words():
    settings = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "tests.hostile.fuzz", "--cases", str(CASES)]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], env=settings, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
