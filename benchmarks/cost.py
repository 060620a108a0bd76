"""What a law with nothing given costs: ten objects, two trials each of 150 samples, ten terms, on one core."""

import argparse
import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.families import Experiment, experiment
from benchmarks.machine import machine

GOAL = 10.0


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each level of noise."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cost", description=__doc__)
    parser.add_argument("--objects", type=int, default=10)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--noise", nargs="+", type=float, default=(0.001, 0.01, 0.1), metavar="LEVEL")
    chosen = parser.parse_args(arguments)
    known, small = experiment("Lotka-Volterra", chosen.objects), experiment("Lotka-Volterra", 1)
    print(f"{machine()}\n\nGoal: under {GOAL:g} s on one core.\n")
    print("| noise % | median s (runs) | fastest s | reference s | ratio of medians | support right |")
    print("|---|---|---|---|---|---|")
    with threadpool_limits(1):
        small.discover(small.measured(0.01, 0))  # Imports what is imported when it is first used
        for level in chosen.noise:
            print(_line(known, level, chosen.repeats), flush=True)


def reference() -> None:
    """Do a fixed amount of work that tells fast cores from slow ones: orthogonal factors of ten tall matrices."""
    generator = np.random.default_rng(0)
    for _ in range(10):
        np.linalg.qr(generator.standard_normal((3000, 200)), mode="r")


def _line(known: Experiment, level: float, repeats: int) -> str:
    trials, laws = known.measured(level, 0), []
    runs = [(_seconds(lambda: laws.append(known.discover(trials))), _seconds(reference)) for _ in range(repeats)]
    ours, theirs = zip(*runs, strict=True)
    median, work = statistics.median(ours), statistics.median(theirs)
    right = "yes" if known.estimates(laws[0]) is not None else "no"
    times = f"{median:.3g} ({repeats}) | {min(ours):.3g} | {work:.3g} | {median / work:.3g}"
    return f"| {100 * level:g} | {times} | {right} |"


def _seconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
