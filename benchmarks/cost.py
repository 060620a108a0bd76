"""What a law with nothing given costs: ten objects with ten terms, the kernel beside NumPy, two threads beside one."""

import argparse
import os
import statistics
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

import commonlaw as cl
from benchmarks.families import Experiment, experiment
from benchmarks.machine import machine
from commonlaw.law import to_json

GOAL = 10.0


ONE_THREAD = cl.TrajectoryLikelihood(n_jobs=1)


class Problem(NamedTuple):
    """Trials, and what is said of their law."""

    trials: cl.Trials
    order: int
    library: str = "poly:3"

    def law(self, method: cl.TrajectoryLikelihood = ONE_THREAD) -> cl.Law:
        """Find the law."""
        return cl.discover(self.trials, order=self.order, library=self.library, method=method)


def short() -> Problem:
    """Return twelve objects with nine samples each, far apart, of a growth that is disturbed as it goes."""
    generator, times = np.random.default_rng(0), np.array([0, 0.25, 0.57, 1.12, 2.02, 3.82, 5.1, 7.03, 9.05])
    states = []
    for rate in np.linspace(0.5, 1.2, 12):
        size, found = 1.0, [1.0]
        for step in np.diff(times):
            inner = step / 100
            for _ in range(100):
                size += (
                    inner * rate * size * (1 - size / 8) + 0.05 * size * np.sqrt(inner) * generator.standard_normal()
                )
            found.append(size)
        states.append(np.array(found)[:, np.newaxis] + 0.03 * generator.standard_normal((9, 1)))
    names = [f"object {i + 1}" for i in range(12)]
    trials = cl.Trials.from_arrays([times] * 12, states, object=names, names=("x",))
    return Problem(trials, 1, "poly:3")


def drops(objects: int, samples: int = 49) -> Problem:
    """Return simulated drops of some objects, two of each in 3.3 s."""
    drag = tuple(np.linspace(-0.7, -0.1, objects).tolist())
    trials = cl.datasets.load("linear-drag", drag=drag, samples=samples, rate=samples * 15 / 49, noise=0.05, seed=1)
    return Problem(trials, 2)


def lorenz(samples: int) -> Problem:
    """Return two runs of Lorenz' system, with twenty terms an equation."""
    trials = cl.datasets.load("lorenz", samples=samples // 2, noise=0.1, seed=1)
    return Problem(trials, 1, "poly:3")


CASES: dict[str, Callable[[], Problem]] = {
    "5 drops": partial(drops, objects=5),
    "40 drops": partial(drops, objects=40),
    "160 drops of 150 samples": partial(drops, objects=160, samples=150),
    "12 objects x 9 samples": short,
    "Lorenz, 20 terms, 2000 samples": partial(lorenz, samples=2000),
    "Lorenz, 20 terms, 16 000 samples": partial(lorenz, samples=16_000),
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each level of noise, and for each case one beside NumPy and one with two threads."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cost", description=__doc__)
    parser.add_argument("--objects", type=int, default=10)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--noise", nargs="*", type=float, default=(0.001, 0.01, 0.1), metavar="LEVEL")
    parser.add_argument("--kernel", nargs="*", default=list(CASES), choices=list(CASES), metavar="CASE")
    parser.add_argument("--threads", nargs="*", default=list(CASES), choices=list(CASES), metavar="CASE")
    chosen = parser.parse_args(arguments)
    known, small = experiment("Lotka-Volterra", chosen.objects), experiment("Lotka-Volterra", 1)
    print(f"{machine()}\n\nGoal: under {GOAL:g} s on one core.\n")
    print("| noise % | median s (runs) | fastest s | reference s | ratio of medians | support right |")
    print("|---|---|---|---|---|---|")
    with threadpool_limits(1):
        small.discover(small.measured(0.01, 0))  # Imports what is imported when it is first used
        for level in chosen.noise:
            print(_line(known, level, chosen.repeats), flush=True)
        print("\n| case | compiled, CPU s | NumPy, CPU s | NumPy / compiled | same law |\n|---|---|---|---|---|")
        for name in chosen.kernel:
            print(_beside_numpy(name), flush=True)
        print("\n| case | one thread, s | two, s | one / two | same law | cores used by others |")
        print("|---|---|---|---|---|---|")
        for name in chosen.threads:
            print(_two_threads(name, chosen.repeats), flush=True)


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


def _beside_numpy(name: str) -> str:
    """Return the line of one case, in which the kernel and NumPy take the same data; the first run is not timed."""
    drops(5).law()
    problem, laws, times = CASES[name](), {}, {}
    for kernel in ("compiled", "numpy"):
        os.environ["COMMONLAW_KERNEL"] = kernel
        start = time.process_time()
        laws[kernel] = problem.law()
        times[kernel] = time.process_time() - start
    del os.environ["COMMONLAW_KERNEL"]
    compiled, plain = laws["compiled"], laws["numpy"]
    same = np.array_equal(compiled.support, plain.support)
    apart = (
        np.abs(compiled.coefficients - plain.coefficients).max() / np.abs(plain.coefficients).max() if same else np.inf
    )
    told = f"yes ({apart:.0e})" if same else "no"
    ratio = times["numpy"] / times["compiled"]
    return f"| {name} | {times['compiled']:.3g} | {times['numpy']:.3g} | {ratio:.2g} | {told} |"


def _two_threads(name: str, repeats: int) -> str:
    """Return the line of one case, in which one thread and two take turns; the quickest of each counts."""
    problem, laws, times = CASES[name](), dict[int, str](), dict[int, float]()
    began, before = time.perf_counter(), _busy() - time.process_time()
    for _ in range(repeats):
        for count in (1, 2):
            start = time.perf_counter()
            laws[count] = to_json(problem.law(cl.TrajectoryLikelihood(n_jobs=count)))
            times[count] = min(time.perf_counter() - start, times.get(count, np.inf))
    others = (_busy() - time.process_time() - before) / (time.perf_counter() - began)
    same = "yes" if laws[1] == laws[2] else "no"
    return f"| {name} | {times[1]:.3g} | {times[2]:.3g} | {times[1] / times[2]:.2f} | {same} | {others:.1f} |"


def _busy() -> float:
    """Return the seconds that all processes together have computed; none where the system does not say it."""
    path = Path("/proc/stat")
    if not path.exists():
        return np.nan
    user, nice, system, _, _, *rest = map(int, path.read_text().splitlines()[0].split()[1:9])
    return (user + nice + system + sum(rest)) / os.sysconf("SC_CLK_TCK")


def _seconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
