"""Hostile cases end as what they ask for or in a refusal, whatever they are; `make fuzz` runs many more."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.hostile.cases import KINDS

CASES = 3
"""Of each kind."""


HALVES = {", ".join(half): half for half in ([*KINDS][::2], [*KINDS][1::2])}
"""The kinds for each of two workers: what commands need is loaded once by each."""


@pytest.mark.parametrize("kinds", HALVES.values(), ids=HALVES)
def test_hostile_cases_are_done_or_refused_in_words(kinds):
    settings = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    chosen = [word for kind in kinds for word in ("--kind", kind)]
    command = [sys.executable, "-m", "tests.hostile.fuzz", "--cases", str(CASES * len(kinds)), *chosen]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], env=settings, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
