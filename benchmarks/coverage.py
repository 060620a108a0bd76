"""How often the stated 95 % intervals hold the true coefficients."""

import argparse
import sys
import time
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import beta

from benchmarks.draws import Stated, add_options, draw
from benchmarks.families import FAMILIES, experiment
from benchmarks.machine import machine

Floats = NDArray[np.float64]

CHOSEN = ("pendulum", "Lotka-Volterra", "heights of balls")
GOAL = (0.90, 0.98)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each family."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.coverage", description=__doc__)
    add_options(parser, tuple(FAMILIES), 200)
    parser.set_defaults(families=CHOSEN)
    parser.add_argument("--noise", nargs="+", type=float, default=(0.01,), metavar="LEVEL", help="1 %% is 0.01")
    chosen = parser.parse_args(arguments)
    low, high = GOAL
    print(f"{machine()}\n\nShare of the 95 % intervals that hold the truth; goal: {low:.2f} to {high:.2f}.\n")
    print(
        "| family | noise % | support right | intervals | share | its 95 % interval | least, most of one | unpooled |"
    )
    print("|---|---|---|---|---|---|---|---|")
    begun = time.perf_counter()
    for name in chosen.families:
        for level in chosen.noise:
            start = time.perf_counter()
            print(_line(name, level, chosen.draws, chosen.jobs), flush=True)
            print(f"{name}, {100 * level:g} %: {time.perf_counter() - start:.1f} s", file=sys.stderr)
    print(f"\n{time.perf_counter() - begun:.0f} s in all, in {chosen.jobs} process(es) at a time.")


def held(laws: Iterable[Stated | None], truth: Floats) -> NDArray[np.bool_]:
    """Return which 95 % intervals hold the truth, in draws of the right support: (draws, objects, parameters)."""
    right = [abs(law.coefficients - truth) <= law.reach * law.errors for law in laws if law is not None]
    return np.stack(right) if right else np.empty((0, *truth.shape), dtype=bool)


def interval(share: float, count: float) -> tuple[float, float]:
    """Return the 95 % interval of Jeffreys for a share of that many observations (Brown, Cai and DasGupta 2001)."""
    low, high = np.atleast_1d(beta.ppf([0.025, 0.975], share * count + 0.5, (1 - share) * count + 0.5))
    return float(low), float(high)


def _line(name: str, level: float, count: int, n_jobs: int) -> str:
    outcomes, truth = draw(name, level, count, n_jobs), experiment(name).coefficients
    inside, own = (
        held(laws, truth) for laws in zip(*((outcome.found, outcome.own) for outcome in outcomes), strict=True)
    )
    start = f"| {name} | {100 * level:g} | {len(inside)} of {count} | {inside.size}"
    if not inside.size:
        return f"{start} | | | | |"
    # An object's coefficients err together: each of its fits counts as one observation
    low, high = interval(inside.mean(), inside.shape[0] * inside.shape[1])
    each, end = inside.mean(axis=0), f"{own.mean():.3f} |"
    return f"{start} | {inside.mean():.3f} | {low:.3f} to {high:.3f} | {each.min():.2f}, {each.max():.2f} | {end}"


if __name__ == "__main__":
    main()
