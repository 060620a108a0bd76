"""How near coefficients come to the Cramer-Rao bound, below which no unbiased estimate of the same data can err."""

import argparse
import sys
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.draws import SMOOTHINGS, add_options, draw
from benchmarks.families import FAMILIES, experiment
from benchmarks.machine import machine

Floats = NDArray[np.float64]

LEVELS = (0.001, 0.01, 0.05)
GOAL = 1.2


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each family and level of noise."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cramer_rao", description=__doc__)
    add_options(parser, tuple(FAMILIES), 50)
    parser.add_argument("--noise", nargs="+", type=float, default=LEVELS, metavar="LEVEL", help="1 %% is 0.01")
    chosen = parser.parse_args(arguments)
    print(f"{machine()}\n\nRoot-mean-square errors over the Cramer-Rao bound; goal for commonlaw: at most {GOAL}.\n")
    print("| family | noise % | support right | own / bound | worst | pooled / bound | plain / bound | worst | rates |")
    print("|---|---|---|---|---|---|---|---|---|")
    begun = time.perf_counter()
    for name in chosen.families:
        for level in chosen.noise:
            start = time.perf_counter()
            print(_line(name, level, chosen.draws, chosen.jobs), flush=True)
            print(f"{name}, {100 * level:g} %: {time.perf_counter() - start:.1f} s", file=sys.stderr)
    print(f"\n{time.perf_counter() - begun:.0f} s in all, in {chosen.jobs} process(es) at a time.")


def relative_errors(estimates: Sequence[Floats], truth: Floats, bounds: Floats) -> tuple[float, float]:
    """Return root-mean-square errors over their bounds: the root mean square over all coefficients, and the largest.

    Parameters
    ----------
    estimates
        Of each draw, shape (objects, parameters), as the truth and the bounds.
    truth, bounds
        The true coefficients, and the bounds of their standard deviations.
    """
    if not estimates:
        return np.nan, np.nan
    squares = np.mean((np.stack(estimates) - truth) ** 2, axis=0) / bounds**2
    return float(np.sqrt(squares.mean())), float(np.sqrt(squares.max()))


def _line(name: str, level: float, count: int, n_jobs: int) -> str:
    known, outcomes = experiment(name), draw(name, level, count, n_jobs)
    bounds = known.bounds(level)
    own = [outcome.own.coefficients for outcome in outcomes if outcome.own is not None]
    ours = relative_errors(own, known.coefficients, bounds)
    found = [outcome.found.coefficients for outcome in outcomes if outcome.found is not None]
    pooled, _ = relative_errors(found, known.coefficients, bounds)
    smoothed = zip(*(outcome.plain for outcome in outcomes), strict=True)
    *plain, rates = min(
        (*relative_errors(each, known.coefficients, bounds), words)
        for each, words in zip(smoothed, SMOOTHINGS, strict=True)
    )
    numbers = " | ".join(f"{each:.3g}" for each in (*ours, pooled, *plain))
    return f"| {name} | {100 * level:g} | {len(own)} of {count} | {numbers} | {rates} |"


if __name__ == "__main__":
    main()
