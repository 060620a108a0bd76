"""What a second worker of a dask cluster saves, and what memory is needed: `python -m benchmarks.cluster`.

Times are CPU times of the busiest worker, as other work may have the cores of the machine: on free cores, with the time
that the client and the scheduler take beside, the clock shows the same.
"""

import argparse
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

import commonlaw as cl
from benchmarks.machine import machine
from benchmarks.problem import lorenz
from commonlaw.runtime.cluster import connected
from commonlaw.trials import Schema

_ROWS, _TRIAL, _OBJECTS = 500_000, 10_000, 100
"""Rows of a file, samples of a trial in it, and objects of a part."""


def main() -> None:
    """Read the command line, run, and print the tables as Markdown."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cluster", description=__doc__)
    parser.add_argument("--rows", type=float, nargs="*", default=[5e6, 1e7], help="of Lorenz's system, in Parquet")
    parser.add_argument(
        "--objects", type=int, nargs="*", default=[400, 800], help="balls with two trials of 60 samples"
    )
    chosen = parser.parse_args()
    print(f"{machine()}\n")
    _print_head("rows")
    for rows in chosen.rows:
        with tempfile.TemporaryDirectory() as folder:
            _write(Path(folder), int(rows) // _ROWS)
            _compare(f"{rows:.0e}", partial(cl.TrialStream.from_parquet, folder, **_ROLES), **_REGRESSION)
    _print_head("objects")
    for objects in chosen.objects:
        _compare(str(objects), partial(_balls, objects), **_LIKELIHOOD)


_ROLES: dict[str, Any] = {"object": "object", "trial": "trial", "time": "t", "states": ["x", "y", "z"]}
_REGRESSION: dict[str, Any] = {
    "library": "poly:5",
    "method": cl.DerivativeRegression(differentiation="finite:2", solver=cl.solvers.STLSQ(0.1, shared=False)),
}
_LIKELIHOOD: dict[str, Any] = {"order": 2, "library": "poly:2", "method": cl.TrajectoryLikelihood()}


def _write(folder: Path, files: int) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    states, samples = lorenz(_ROWS).states[0], np.arange(_ROWS)
    for i in range(files):
        columns = {"object": ["a"] * _ROWS, "trial": samples // _TRIAL + i * _ROWS, "t": samples % _TRIAL * 0.001}
        table = pa.table(columns | {name: states[:, j] for j, name in enumerate("xyz")})
        pq.write_table(table, folder / f"{i:06}.parquet")


@dataclass(frozen=True)
class _Balls:
    """Falling balls with a drag that goes with the inverse of their masses, simulated where they are used."""

    first: int
    count: int

    def __call__(self) -> cl.Trials:
        generator, times = np.random.default_rng(self.first), np.linspace(0, 2, 60)
        trials, properties = list[cl.Trial](), dict[str, dict[str, float]]()
        for i in range(self.first, self.first + self.count):
            mass = float(np.exp(generator.normal(0, 0.5)))
            drag, name = 0.3 / mass, f"ball {i}"
            properties[name] = {"mass": mass}
            for trial, speed in enumerate(generator.normal(size=2)):
                terminal = -9.81 / drag
                height = terminal * times + (speed - terminal) * (1 - np.exp(-drag * times)) / drag
                measured = height + 0.01 * generator.normal(size=60)
                trials.append(cl.Trial(name, str(trial), times, measured[:, np.newaxis]))
        return cl.Trials(tuple(trials), Schema(("x",)), properties)


def _balls(objects: int) -> cl.TrialStream:
    firsts = range(0, objects, _OBJECTS)
    parts = [cl.TrialStream(Schema(("x",)), _Balls(i, min(_OBJECTS, objects - i))) for i in firsts]
    return cl.TrialStream(Schema(("x",)), _Balls(0, objects), parts)


def _print_head(what: str) -> None:
    columns = [what, "workers", "CPU s, busiest", "s by the clock", "MB, largest worker", "MB, client", "CPU, 1 / this"]
    print(f"\n| {' | '.join(columns)} |\n|{'---|' * len(columns)}")


def _compare(size: str, stream: Callable[[], cl.TrialStream], **question: Any) -> None:
    alone, laws = 0.0, list[cl.Law]()
    for workers in (1, 2):
        with connected(f"local:{workers}") as client:
            cl.discover(_first(stream()), client=client, **question)  # Imports what is imported when it is first used
            before, begun = client.run(_used), time.perf_counter()
            laws.append(cl.discover(stream(), client=client, **question))
            seconds, after = time.perf_counter() - begun, client.run(_used)
        busiest = max(after[each][0] - before[each][0] for each in after)
        alone = alone or busiest
        largest, own = max(each[1] for each in after.values()), _used()[1]
        cells: Sequence[object] = (
            size, workers, f"{busiest:.3g}", f"{seconds:.3g}", f"{largest:.0f}", f"{own:.0f}", f"{alone / busiest:.3g}"
        )  # fmt: skip
        print(f"| {' | '.join(map(str, cells))} |", flush=True)
    assert np.array_equal(laws[0].coefficients, laws[1].coefficients), "the law depends on the number of workers"


def _first(stream: cl.TrialStream) -> cl.TrialStream:
    return cl.TrialStream(stream.schema, stream.parts[0].source, stream.parts[:2])


def _used() -> tuple[float, float]:
    """Return the CPU time of this process, and its largest size in MB."""
    # Not by `resource`, where the size of the process that started this one counts too
    size = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM"))
    return time.process_time(), float(size.split()[1]) / 1e3


if __name__ == "__main__":
    main()
