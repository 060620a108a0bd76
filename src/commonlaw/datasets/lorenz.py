"""The chaotic system of Lorenz."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.datasets import exact
from commonlaw.datasets.dataset import Dataset
from commonlaw.datasets.measurement import Measurement, NormalSource, Path, Seed, numbers, sample_times, together
from commonlaw.trials import Schema, Trials

if TYPE_CHECKING:
    from commonlaw.law import Law

_SCHEMA = Schema(("x", "y", "z"))
_START = (-8.0, 8.0, 27.0)


def _load(
    sigma: float | Sequence[float] = 10.0,
    rho: float | Sequence[float] = 28.0,
    beta: float | Sequence[float] = 8 / 3,
    trials: int = 2,
    samples: int = 1000,
    rate: float = 100.0,
    noise: float = 0.0,
    seed: Seed = 0,
) -> Trials:
    """Return runs of ``x' = sigma (y - x)``, ``y' = x (rho - z) - y``, ``z' = x y - beta z`` (Lorenz 1963).

    Each run starts at (-8, 8, 27) plus a standard normal on each state.

    Parameters
    ----------
    sigma, rho, beta
        Coefficients of each system; a single number serves all systems, and single numbers make one system.
    trials
        Runs of each system.
    samples
        Number of samples in each run.
    rate
        Samples in a unit of time.
    noise
        Standard deviation of the white noise on every state.
    seed
        A whole number; or a NumPy generator of random numbers, which is drawn from system by system, run by run: first
        the start, then the noise.

    Raises
    ------
    CommonlawError
        If an option cannot be, such as a negative noise.
    """
    times = sample_times(samples, rate)
    paths = {name: _path(name, row, times) for name, row in _systems(sigma, rho, beta).items()}
    return Measurement(times, trials, noise, seed).of(paths, _SCHEMA)


def _truth(
    sigma: float | Sequence[float] = 10.0, rho: float | Sequence[float] = 28.0, beta: float | Sequence[float] = 8 / 3
) -> "Law":
    """Return the law of these systems."""
    rows = {
        name: [[-s, s, 0.0, 0.0, 0.0], [r, -1.0, 0.0, 0.0, -1.0], [0.0, 0.0, -b, 1.0, 0.0]]
        for name, (s, r, b) in _systems(sigma, rho, beta).items()
    }
    return exact.law(_SCHEMA, ["x", "y", "z", "x*y", "x*z"], rows)


def _path(name: str, coefficients: tuple[float, ...], times: Floats) -> Path:
    """Return the function that draws a start and runs from there."""
    sigma, rho, beta = coefficients

    def field(_: float, y: Floats) -> Floats:
        return np.array([sigma * (y[1] - y[0]), y[0] * (rho - y[2]) - y[1], y[0] * y[1] - beta * y[2]])

    def path(source: NormalSource) -> Floats:
        return exact.trajectory(field, (_START + source.standard_normal((3,))).tolist(), times, name)

    return path


def _systems(
    sigma: float | Sequence[float], rho: float | Sequence[float], beta: float | Sequence[float]
) -> dict[str, tuple[float, ...]]:
    """Return the three coefficients of each system by name."""
    rows = together(sigma=numbers("sigma", sigma), rho=numbers("rho", rho), beta=numbers("beta", beta))
    return {f"System {i}": row for i, row in enumerate(rows, 1)}


lorenz = Dataset(
    "lorenz",
    "simulated chaos: x' = 10 (y - x), y' = x (28 - z) - y, z' = x y - 8/3 z",
    "E. N. Lorenz, Deterministic Nonperiodic Flow, Journal of the Atmospheric Sciences 20 (1963) 130",
    _load,
    _truth,
)
