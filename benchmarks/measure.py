"""One run in a process of its own: what it found, how long it took, how much memory it needed above its start.

``python -m benchmarks.measure CASE CONTESTANT RESULT [--quick]`` is such a process.
"""

import gc
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases import ALL

_ROOT = Path(__file__).resolve().parents[1]
_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "VECLIB_MAXIMUM", "NUMEXPR")}


@dataclass(frozen=True, eq=False)
class Measurement:
    """What one run came to; memory is in bytes."""

    result: NDArray[np.float64]
    seconds: float
    memory: int


def measure(case: str, contestant: str, quick: bool) -> Measurement:
    """Run a contestant once, with one thread for each BLAS.

    Raises
    ------
    RuntimeError
        If it fails; the message holds what it said.
    """
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.npy"
        command = [
            sys.executable,
            "-m",
            "benchmarks.measure",
            case,
            contestant,
            str(result),
            *["--quick"][: int(quick)],
        ]
        environment = {**os.environ, **_ONE_THREAD, "HEYOKA_CACHE_DIR": folder}  # Nothing compiled in an earlier run
        done = subprocess.run(command, cwd=_ROOT, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            raise RuntimeError(f"{case}, {contestant}: {done.stderr}")
        return Measurement(np.load(result), **json.loads(done.stdout.splitlines()[-1]))


def _run(case: str, contestant: str, result: str, quick: bool) -> None:
    chosen = ALL[case]
    prepare = chosen.contestants[contestant].prepare
    prepare((chosen.warm or chosen.quick)())()  # Imports what is imported when it is first used
    run = prepare(chosen.problem(quick))
    gc.collect()
    _forget_peak()
    before, start = _peak(), time.perf_counter()
    found = run()
    seconds, memory = time.perf_counter() - start, _peak() - before
    np.save(result, found)
    print(json.dumps({"seconds": seconds, "memory": memory}))


def _forget_peak() -> None:
    """Let the largest size of this process count from now; only Linux can."""
    peak = Path("/proc/self/clear_refs")
    if peak.exists():
        peak.write_text("5")


def _peak() -> int:
    """Return the largest size of this process in bytes."""
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return largest if sys.platform == "darwin" else 1024 * largest


if __name__ == "__main__":
    _run(sys.argv[1], sys.argv[2], sys.argv[3], "--quick" in sys.argv)
