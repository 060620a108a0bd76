"""Whether bounds of coefficients of absent terms hold the true ones: drops with a little quadratic drag."""

import argparse
from collections.abc import Sequence

import numpy as np

import commonlaw as cl
from benchmarks.machine import machine
from benchmarks.variational import solve
from commonlaw.inference import bounds

EQUATIONS = (("1", "v", "v^2"),)
LARGEST = 0.015
"""Of the coefficient, 1/m, several of its standard errors: all values of both signs up to it are as probable."""

NOISE, HEIGHT, END, SAMPLES = 0.01, 47.0, 3.2, 49
"""Of heights and where drops begin, m; of a drop, s."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how many bounds hold."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.unseen", description=__doc__)
    parser.add_argument("--draws", type=int, default=300, help="of the experiment (default: %(default)s)")
    parser.add_argument("--objects", type=int, default=1, help="balls, with a drop each (default: %(default)s)")
    chosen = parser.parse_args(arguments)
    found = [each for seed in range(chosen.draws) for each in drawn(seed, chosen.objects)]
    print(
        f"{machine()}\n\n| bounds | intervals hold | bounds hold | of unseen terms | bounds of these hold |\n|"
        + "---|" * 5
    )
    intervals, holds, unseen = (np.array(column) for column in zip(*found, strict=True))
    shares = [f"{100 * np.mean(each):.1f} %" for each in (intervals, holds, holds[unseen])]
    print(f"| {len(found)} | {shares[0]} | {shares[1]} | {unseen.sum()} | {shares[2]} |")


def drawn(seed: int, objects: int) -> list[tuple[bool, bool, bool]]:
    """Return for each ball whether its interval and its bound hold the truth, and whether the term is unseen."""
    random, times = np.random.default_rng(seed), np.linspace(0, END, SAMPLES)
    drags, squares = random.uniform(-0.5, -0.1, objects), random.uniform(-LARGEST, LARGEST, objects)
    heights = [
        solve(("x", "v"), EQUATIONS, np.array([-9.8, drag, square]), np.array([HEIGHT, 0.0]), times).states[:, :1]
        for drag, square in zip(drags, squares, strict=True)
    ]
    measured = [height + NOISE * random.standard_normal(height.shape) for height in heights]
    names = [f"ball {i + 1}" for i in range(objects)]
    trials = cl.Trials.from_arrays([times] * objects, measured, object=names, names=["x"])
    limits = bounds(cl.fit("x'' = -g - c v", trials, errors="white"), trials, ["v^2"]).bounds
    pairs = zip(limits, squares.tolist(), strict=True)
    return [(each.low <= true <= each.high, abs(true) <= each.at_most, not each.seen) for each, true in pairs]


if __name__ == "__main__":
    main()
