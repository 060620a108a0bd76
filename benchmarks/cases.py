"""The cases: a problem, who takes part in it, and what must come out the same."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from benchmarks import ours, peers
from benchmarks.problem import Problem, lorenz, lorenz96, lorenz_law, roessler_law

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Contestant:
    """One way of solving a problem.

    Parameters
    ----------
    prepare
        From a problem to what is to be timed.
    repeats
        How many times it is run, each in a process of its own.
    goal
        How many times faster than PySINDy it should be.
    """

    prepare: Callable[[Problem], Callable[[], Floats]]
    repeats: int = 5
    goal: float | None = None


@dataclass(frozen=True)
class Case:
    """A problem and its contestants.

    Parameters
    ----------
    title
        What is measured.
    full, quick
        Make the problem in full size, and in a size for trying.
    contestants
        By name. Those whose name begins with ``commonlaw`` are compared with those whose name begins with ``PySINDy``.
    compared
        From a result to what must be the same for all.
    tolerance
        Largest difference of what is compared, relative to its largest number.
    warm
        Makes what is solved once before the clock starts; without it, the quick problem.
    """

    title: str
    full: Callable[[], Problem]
    quick: Callable[[], Problem]
    contestants: Mapping[str, Contestant]
    compared: Callable[[Floats], Floats] = np.asarray
    tolerance: float = 1e-8
    warm: Callable[[], Problem] | None = None

    def problem(self, quick: bool) -> Problem:
        """Return the problem in one of its sizes."""
        return self.quick() if quick else self.full()


BOUND = "dsyrk"
_SWEEP = tuple(np.geomspace(0.05, 20, 50).tolist())
_bound = Contestant(peers.dsyrk)


CASES: Mapping[str, Case] = {
    "fit": Case(
        "Lorenz, degree 5 (56 terms), 1e6 samples, whole fit",
        partial(lorenz, 1_000_000),
        partial(lorenz, 5000),
        {"PySINDy": Contestant(peers.fit, 3), "commonlaw": Contestant(ours.fit, goal=50), BOUND: _bound},
    ),
    "thresholds": Case(
        "the same, 1e5 samples, 50 thresholds",
        partial(lorenz, 100_000, thresholds=_SWEEP),
        partial(lorenz, 5000, thresholds=_SWEEP[::10]),
        {
            "PySINDy": Contestant(peers.thresholds, 1),
            "commonlaw, solved at each": Contestant(ours.thresholds, goal=1000),
            "commonlaw, exact path": Contestant(ours.path, goal=1000),
            BOUND: _bound,
        },
    ),
    "bootstrap": Case(
        "the same, 1e5 samples, 100 bootstrap models",
        partial(lorenz, 100_000, models=100),
        partial(lorenz, 5000, models=3),
        {
            "PySINDy": Contestant(peers.bootstrap, 1),
            "commonlaw, rows": Contestant(ours.bootstrap_rows, 3, goal=100),
            "commonlaw, blocks": Contestant(ours.bootstrap_blocks, goal=1000),
            BOUND: _bound,
        },
        lambda models: np.median(models, axis=0),
        1e-5,
    ),
    "terms": Case(
        "10 states, degree 3 (286 terms), 1e5 samples",
        partial(lorenz96, 100_000),
        partial(lorenz96, 4000),
        {"PySINDy": Contestant(peers.fit, 2), "commonlaw": Contestant(ours.fit, goal=50), BOUND: _bound},
    ),
    "trials": Case(
        "1000 trials of 500 samples, 3 states, degree 3",
        partial(lorenz, 500, 3, trials=1000),
        partial(lorenz, 500, 3, trials=10),
        {"PySINDy": Contestant(peers.fit, 3), "commonlaw": Contestant(ours.fit, goal=50), BOUND: _bound},
    ),
    "simulate": Case(
        "`simulate` Lorenz 0..100, 10001 points",
        lorenz_law,
        partial(lorenz_law, end=1.0),
        {
            "PySINDy, odeint": Contestant(peers.simulate_odeint, 1),
            "PySINDy, default": Contestant(peers.simulate, 1),
            "commonlaw": Contestant(ours.simulate, goal=1000),
        },
        # Chaos takes trajectories of different integrators apart after the first ten time units.
        lambda states: states[:1001],
        1e-3,
        roessler_law,
    ),
}


def _growing(samples: int, degree: int) -> Case:
    contestants = {"commonlaw": Contestant(ours.stream, 3), BOUND: Contestant(peers.dsyrk, 3)}
    return Case("", partial(lorenz, samples, degree), partial(lorenz, samples // 10, degree), contestants)


ROWS: Mapping[str, Case] = {f"{rows:.0e} rows": _growing(rows, 5) for rows in (10_000, 100_000, 1_000_000, 10_000_000)}
DEGREES: Mapping[str, Case] = {f"degree {degree}": _growing(100_000, degree) for degree in range(1, 9)}
ALL: Mapping[str, Case] = {**CASES, **ROWS, **DEGREES}
