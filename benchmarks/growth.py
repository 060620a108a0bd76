"""How time and memory grow with samples, objects, terms and states; an exponent above its limit ends with an error.

Each size runs in a process of its own with one thread. Exponents are slopes of the logarithm of CPU seconds, or of
memory above the start, over that of the size, by least squares through the three largest sizes.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from typing import NamedTuple

import numpy as np

import commonlaw as cl
from benchmarks.machine import machine

ROOT = Path(__file__).resolve().parents[1]
ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL")} | {"COMMONLAW_CACHE": "off"}
METHODS: Mapping[str, Callable[[], cl.discovery.AbstractMethod]] = {
    "default": lambda: cl.TrajectoryLikelihood(n_jobs=1),
    "regression": cl.DerivativeRegression,
    "weak": cl.WeakRegression,
}
SLACK = 0.2
"""By how much an exponent may exceed its limit, as machines are shared."""


def ring(states: int, samples: int, objects: int = 1) -> cl.Trials:
    """Return noisy oscillators that are coupled in a ring, of an even number of states, two of each object.

    The law is ``x' = v`` and ``v' = -k x - 0.02 v - 0.3 x``, the last x being that of the neighbour.
    """
    generator, times, arrays, names = np.random.default_rng(0), np.arange(samples) * 0.05, [], []
    for k in range(objects):
        rates = np.zeros((states, states))
        for i in range(0, states, 2):
            rates[i, i + 1], rates[i + 1, i], rates[i + 1, i + 1] = 1.0, -1.0 - 0.5 * k / objects, -0.02
            rates[i + 1, (i - 2) % states] -= 0.3
        values, vectors = np.linalg.eig(rates)
        for _ in range(2):
            shares = np.linalg.solve(vectors, generator.standard_normal(states))
            path = (np.exp(np.outer(times, values)) * shares @ vectors.T).real
            arrays.append(path + 0.01 * generator.standard_normal(path.shape))
            names.append(f"object {k + 1}")
    labels = tuple(f"x{i + 1}" for i in range(states))
    return cl.Trials.from_arrays([times] * len(arrays), arrays, object=names, names=labels)


class Axis(NamedTuple):
    """What grows: the sizes of each method with the limit of its exponent, and trials and library of a size."""

    sizes: Mapping[str, tuple[float, Sequence[int]]]
    trials: Callable[[int], cl.Trials]
    library: Callable[[int], str] = lambda _: "poly:2"
    unit: Callable[[int], int] = lambda size: size


AXES: Mapping[str, Axis] = {
    "samples": Axis(
        {
            "default": (1.0, (1_000, 3_000, 10_000, 30_000)),
            "regression": (1.0, (3_000, 10_000, 100_000, 1_000_000)),
            "weak": (1.0, (1_000, 3_000, 30_000, 100_000)),
        },
        lambda size: ring(2, size // 2),
    ),
    "objects": Axis(
        {
            "default": (1.0, (2, 8, 32, 128)),
            "regression": (1.0, (2, 32, 256, 2_000)),
            "weak": (1.0, (2, 8, 32, 128)),
        },
        lambda size: ring(2, 60, size),
    ),
    "terms": Axis(
        {
            "default": (1.5, (2, 4, 7, 10)),
            "regression": (1.5, (3, 6, 12, 22)),
            "weak": (1.5, (3, 6, 12)),
        },
        lambda _: ring(2, 500),
        lambda size: f"poly:{size}",
        lambda size: (size + 1) * (size + 2) // 2,
    ),
    # The terms of each of the equations grow with the square of the states
    "states": Axis(
        {"default": (2.5, (2, 4, 8)), "regression": (3.8, (2, 4, 8)), "weak": (3.8, (2, 4, 8))},
        lambda size: ring(size, 500),
    ),
}


class Cost(NamedTuple):
    """CPU seconds, and bytes above the start."""

    seconds: float
    memory: float


def run(axis: str, method: str, size: int) -> Cost:
    """Find a law once in this process."""
    trials, library = AXES[axis].trials(size), AXES[axis].library(size)
    cl.discover(ring(2, 60), order=1, library="poly:1", method=METHODS[method]())  # Imports what it needs
    before, began = getrusage(RUSAGE_SELF).ru_maxrss, time.process_time()
    cl.discover(trials, order=1, library=library, method=METHODS[method]())
    return Cost(time.process_time() - began, 1024.0 * max(getrusage(RUSAGE_SELF).ru_maxrss - before, 1))


def measured(axis: str, method: str, size: int) -> Cost:
    """Find a law in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.growth", "--run", axis, method, str(size)]
    environment = {**os.environ, **ONE_THREAD}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    return Cost(*json.loads(done.stdout.splitlines()[-1]))


def exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """Return the slope of logarithms through the three largest sizes.

    >>> round(exponent([1, 2, 4, 8], [5.0, 1.0, 4.0, 16.0]), 3)
    2.0
    """
    return float(np.polyfit(np.log(sizes[-3:]), np.log(costs[-3:]), 1)[0])


def main(arguments: Sequence[str] | None = None) -> None:
    """Print a line for each axis and method, and end with an error if an exponent is above its limit."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.growth", description=__doc__)
    parser.add_argument("--axis", nargs="*", default=list(AXES), choices=list(AXES), metavar="AXIS")
    parser.add_argument("--method", nargs="*", default=list(METHODS), choices=list(METHODS), metavar="METHOD")
    parser.add_argument("--run", nargs=3, help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    if chosen.run:
        axis, method, size = chosen.run
        print(json.dumps(run(axis, method, int(size))))
        return
    print(f"{machine()}\n\n| growing | method | sizes | CPU s | MB | exponent of s | limit | of MB |")
    print("|---|---|---|---|---|---|---|---|")
    above = list[str]()
    for axis in chosen.axis:
        for method in chosen.method:
            limit, sizes = AXES[axis].sizes[method]
            units, costs = [AXES[axis].unit(size) for size in sizes], [measured(axis, method, size) for size in sizes]
            of_time = exponent(units, [cost.seconds for cost in costs])
            of_memory = exponent(units, [cost.memory for cost in costs])
            seconds = ", ".join(f"{cost.seconds:.2g}" for cost in costs)
            memory = ", ".join(f"{cost.memory / 1e6:.0f}" for cost in costs)
            shown = ", ".join(f"{unit:,}".replace(",", " ") for unit in units)
            line = f"| {axis} | {method} | {shown} | {seconds} | {memory}"
            print(f"{line} | {of_time:.2f} | {limit:g} | {of_memory:.2f} |", flush=True)
            if of_time > limit + SLACK:
                above.append(f"{method} over {axis}")
    if above:
        sys.exit(f"exponents above their limits: {', '.join(above)}")


if __name__ == "__main__":
    main()
