"""Whether what trials cannot tell is said: drops of two balls from one height, and with a second height.

The errors are of the size that those of the measured golf and tennis balls have: white noise of 4.5 cm, and 6 cm that
are correlated over 0.3 s.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

import commonlaw as cl
from benchmarks.machine import machine
from commonlaw.array_types import Floats
from commonlaw.diagnostics import OutcomeKind
from commonlaw.discovery.hints import confounded_variables

HEIGHT, SECOND = 47.0, (42.0, 35.0, 25.0)
"""Where all balls are dropped, and where the second drop of each may begin, m."""

LINEAR, QUADRATIC = (-0.05, -0.1), (0.004, 0.012)
"""Drag of the two balls, about that of the golf and the tennis ball, 1/s and 1/m."""

WHITE, CORRELATED, MEMORY, RATE = 0.045, 0.06, 0.3, 15.0
"""Standard deviations of errors, m, the memory of the latter, s, and samples in a second."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how many draws have the note."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.confounding", description=__doc__)
    parser.add_argument("--draws", type=int, default=40, help="of each experiment (default: %(default)s)")
    parser.add_argument("--library", default="poly:2", help="candidate terms (default: %(default)s)")
    parser.add_argument("--laws", action="store_true", help="find laws too: half a minute each")
    chosen = parser.parse_args(arguments)
    print(f"{machine()}\n\n| second height | data check | law |\n|---|---|---|")
    for second in (HEIGHT, *SECOND):
        experiments = [drops(second, seed) for seed in range(chosen.draws)]
        checked = sum(said_by_check(experiment, chosen.library) for experiment in experiments)
        found = sum(said_by_law(experiment, chosen.library) for experiment in experiments) if chosen.laws else "-"
        of = "none" if second == HEIGHT else f"{second:g} m"
        print(f"| {of} | {checked} of {chosen.draws} | {found} |", flush=True)


def drops(second: float, seed: int) -> cl.Trials:
    """Return two drops of each ball, one of them from a second height, with 45 samples or those above 8 m."""
    random, trials = np.random.default_rng(seed), []
    for name, height in (("1", HEIGHT), ("2", second)):
        samples = int(45 * np.sqrt((height - 8) / (HEIGHT - 8)))
        exact = cl.datasets.linear_drag(
            drag=LINEAR, quadratic=QUADRATIC, height=height, rate=RATE, samples=samples, trials=1, noise=0.0
        )
        trials += [replace(each, name=name, states=each.states + _errors(len(each), random)) for each in exact]
    return exact.with_trials(trials)


def said_by_check(trials: cl.Trials, library: str) -> bool:
    """Return whether the data check reports confounded variables."""
    return bool(confounded_variables(trials, 2, library))


def said_by_law(trials: cl.Trials, library: str) -> bool:
    """Whether the law says so."""
    law = cl.discover(trials, order=2, library=library)
    return any(diagnostic.kind is OutcomeKind.NOT_IDENTIFIABLE for diagnostic in law.diagnostics)


def _errors(count: int, random: np.random.Generator) -> Floats:
    """Return errors of measurements, shape (count, 1)."""
    kept, shocks = np.exp(-1 / (RATE * MEMORY)), random.standard_normal(count)
    slow = shocks[:1].tolist()
    for shock in shocks[1:]:
        slow.append(kept * slow[-1] + np.sqrt(1 - kept**2) * shock)
    found = CORRELATED * np.array(slow) + WHITE * random.standard_normal(count)
    return np.asarray(found[:, np.newaxis])


if __name__ == "__main__":
    main()
