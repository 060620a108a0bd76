"""What a law with nothing given costs on one core: ten objects with ten terms, and the compiled kernel beside NumPy."""

import argparse
import os
import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

import commonlaw as cl
from benchmarks.families import Experiment, experiment
from benchmarks.machine import machine

GOAL = 10.0


def short() -> cl.Law:
    """Find the law of twelve objects with nine samples each, far apart, of a growth that is disturbed as it goes."""
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
    return cl.discover(cl.Trials.from_arrays([times] * 12, states, object=names, names=("x",)), library="poly:3")


def drops(objects: int) -> cl.Law:
    """Find the law of simulated drops of some objects."""
    drag = tuple(np.linspace(-0.7, -0.1, objects).tolist())
    return cl.discover(cl.datasets.load("linear-drag", drag=drag, noise=0.05, seed=1), order=2)


def lorenz() -> cl.Law:
    """Find Lorenz' law among twenty terms an equation."""
    return cl.discover(cl.datasets.load("lorenz", noise=0.1, seed=1), library="poly:3")


KERNEL_CASES: dict[str, Callable[[], cl.Law]] = {
    "5 drops": lambda: drops(5),
    "40 drops": lambda: drops(40),
    "12 objects x 9 samples": short,
    "Lorenz, 20 terms": lorenz,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each level of noise, and one for each case of the kernel."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cost", description=__doc__)
    parser.add_argument("--objects", type=int, default=10)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--noise", nargs="*", type=float, default=(0.001, 0.01, 0.1), metavar="LEVEL")
    parser.add_argument("--kernel", nargs="*", default=list(KERNEL_CASES), choices=list(KERNEL_CASES), metavar="CASE")
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
    drops(5)
    laws, times = {}, {}
    for kernel in ("compiled", "numpy"):
        os.environ["COMMONLAW_KERNEL"] = kernel
        start = time.process_time()
        laws[kernel] = KERNEL_CASES[name]()
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


def _seconds(run: Callable[[], object]) -> float:
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


if __name__ == "__main__":
    main()
