"""What is found where the error is of another kind: proportional, correlated, of rounding, or in the law itself."""

import argparse
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from joblib import Parallel, delayed
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import lfilter

from benchmarks.coverage import GOAL, held, interval
from benchmarks.draws import Stated, stated
from benchmarks.families import Experiment, experiment
from benchmarks.machine import machine
from benchmarks.variational import solve
from commonlaw.errors import CommonlawError

Floats = NDArray[np.float64]

SYSTEMS = {"pendulum": "pendulum", "lotka-volterra": "Lotka-Volterra", "drops": "heights of balls"}

LEVELS: Mapping[str, float] = {"white": 0.02, "proportional": 0.05, "correlated": 0.02, "rounded": 0.03, "smooth": 0.05}
"""White and correlated noise and the step of rounded values are relative to the standard deviations of the states,
proportional noise to the states themselves, and the force that the law does not know to the rates'."""

HEIGHTS = 0.01
"""Of proportional noise where states are heights above the ground, most of which are several times their changes."""

MEMORY = 15.0
"""Samples after which the correlation of correlated noise is 1/e."""

BESIDE = 0.005
"""White noise beside a force, relative to the standard deviations of the states."""

LENGTH = 0.2
"""Of a force in time, relative to a trial's."""


@dataclass(frozen=True)
class Row:
    """What came out of many draws of one error of one system.

    Parameters
    ----------
    level
        Size of the error, see `LEVELS`.
    right, failed
        Draws in which the support is the true one; in which no law is found.
    intervals, share, low, high
        Of the draws that are right: how many 95 % intervals of coefficients there are, the share that holds the truth,
        and its 95 % interval.
    seconds
        Of a draw, mean.
    """

    system: str
    error: str
    level: float
    draws: int
    right: int
    failed: int
    intervals: int
    share: float | None
    low: float | None
    high: float | None
    seconds: float


@dataclass(frozen=True, eq=False)
class _Draw:
    found: Stated | None
    failed: bool
    seconds: float


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line for each system and error."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.error_models", description=__doc__)
    parser.add_argument("--error", nargs="+", choices=ERRORS, default=tuple(ERRORS), metavar="ERROR")
    parser.add_argument("--system", nargs="+", choices=SYSTEMS, default=tuple(SYSTEMS), metavar="SYSTEM")
    parser.add_argument("--level", type=float, help="size of the error (default: 1 to 5 %%)")
    parser.add_argument("--draws", type=int, default=20, help="of the error (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")
    parser.add_argument("--out", type=Path, help="write the rows here, as JSON")
    chosen = parser.parse_args(arguments)
    low, high = GOAL
    print(
        f"{machine()}\n\nGoal: 0.9 of supports right; {low:.2f} to {high:.2f} of the 95 % intervals hold the truth.\n"
    )
    print("| system | error | level % | support right | no law | intervals | share | its 95 % interval | s a draw |")
    print("|---|---|---|---|---|---|---|---|---|")
    rows = []
    for system in chosen.system:
        for error in chosen.error:
            rows.append(row(system, error, chosen.level or default_level(system, error), chosen.draws, chosen.jobs))
            print(_line(rows[-1]), flush=True)
            if chosen.out:
                chosen.out.write_text(json.dumps([asdict(each) for each in rows], indent=1))


def default_level(system: str, error: str) -> float:
    """Return a size of an error that is large, but leaves a system's law to be found."""
    return HEIGHTS if (system, error) == ("drops", "proportional") else LEVELS[error]


def row(system: str, error: str, level: float, count: int, n_jobs: int = 1) -> Row:
    """Return what comes out of that many draws."""
    drawn: list[_Draw] = Parallel(n_jobs=n_jobs)(delayed(_draw)(system, error, level, seed) for seed in range(count))
    inside = held([each.found for each in drawn], experiment(SYSTEMS[system]).coefficients)
    share = low = high = None
    if inside.size:
        # An object's coefficients err together: each of its fits counts as one observation
        share = float(inside.mean())
        low, high = interval(share, inside.shape[0] * inside.shape[1])
    failed, seconds = sum(each.failed for each in drawn), float(np.mean([each.seconds for each in drawn]))
    return Row(system, error, level, count, len(inside), failed, inside.size, share, low, high, seconds)


def measured(known: Experiment, error: str, level: float, seed: int) -> list[Floats]:
    """Return the measured states of every trial of one draw of an error, each of shape (n, d)."""
    return ERRORS[error](known, level, np.random.default_rng([seed, *error.encode()]))


def _white(known: Experiment, level: float, generator: np.random.Generator) -> list[Floats]:
    return _with_noise(known.clean(), known.noise(level), generator)


def _proportional(known: Experiment, level: float, generator: np.random.Generator) -> list[Floats]:
    return [each * (1 + level * generator.standard_normal(each.shape)) for each in known.clean()]


def _correlated(known: Experiment, level: float, generator: np.random.Generator) -> list[Floats]:
    """Add an Ornstein-Uhlenbeck process, which begins in its stationary distribution."""
    stays = np.exp(-1 / MEMORY)
    noise = known.noise(level)
    states = []
    for clean in known.clean():
        pushes = generator.standard_normal(clean.shape)
        pushes[1:] *= np.sqrt(1 - stays**2)
        states.append(clean + noise * lfilter([1.0], [1.0, -stays], pushes, axis=0))
    return states


def _rounded(known: Experiment, level: float, generator: np.random.Generator) -> list[Floats]:
    """Round on a scale whose zero lies elsewhere in each trial."""
    step = known.noise(level)
    zeros = step * generator.uniform(size=(len(known.clean()), len(step)))
    return [zero + step * np.round((each - zero) / step) for each, zero in zip(known.clean(), zeros, strict=True)]


def _smooth(known: Experiment, level: float, generator: np.random.Generator) -> list[Floats]:
    """Let a force, a Gaussian process with the kernel Matern 3/2, drive each trial; add white noise."""
    family = known.family
    times, equations = family.times, len(family.equations)
    apart = np.sqrt(3) * np.abs(times[:, np.newaxis] - times) / (LENGTH * family.end)
    root = np.linalg.cholesky((1 + apart) * np.exp(-apart) + 1e-10 * np.eye(len(times)))
    size = level * np.mean([_highest_rates(known, each).std(axis=0) for each in known.clean()], axis=0)
    states = []
    for runs, coefficients in zip(known.runs, known.coefficients, strict=True):
        for run in runs:
            force = CubicSpline(times, size * (root @ generator.standard_normal((len(times), equations))))
            forced = solve(family.variables, family.equations, coefficients, run.states[0], times, force)
            states.append(forced.states[:, :equations])
    return _with_noise(states, known.noise(BESIDE), generator)


def _with_noise(states: Sequence[Floats], noise: Floats, generator: np.random.Generator) -> list[Floats]:
    return [state + noise * generator.standard_normal(state.shape) for state in states]


def _highest_rates(known: Experiment, clean: Floats) -> Floats:
    return np.asarray(CubicSpline(known.family.times, clean)(known.family.times, known.family.order))


ERRORS: Mapping[str, Callable[[Experiment, float, np.random.Generator], list[Floats]]] = {
    "white": _white,
    "proportional": _proportional,
    "correlated": _correlated,
    "rounded": _rounded,
    "smooth": _smooth,
}


def _draw(system: str, error: str, level: float, seed: int) -> _Draw:
    known = experiment(SYSTEMS[system])
    trials = known.trials(measured(known, error, level, seed))
    start = time.perf_counter()
    try:
        law = known.discover(trials)
    except CommonlawError as reason:
        print(f"{system}, {error}, draw {seed}: {reason}", file=sys.stderr)
        return _Draw(None, True, time.perf_counter() - start)
    return _Draw(stated(known, law), False, time.perf_counter() - start)


def _line(row: Row) -> str:
    counts = f"{row.right} of {row.draws} | {row.failed} | {row.intervals}"
    shares = "| |" if row.share is None else f"{row.share:.3f} | {row.low:.3f} to {row.high:.3f} |"
    return f"| {row.system} | {row.error} | {100 * row.level:g} | {counts} | {shares} {row.seconds:.1f} |"


if __name__ == "__main__":
    main()
