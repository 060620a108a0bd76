"""The chaotic system of Lorenz."""

from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.datasets.dataset import (
    Dataset,
    NormalSource,
    PerObject,
    Seed,
    exact_law,
    exact_path,
    measure,
    objects,
    sample_times,
)
from commonlaw.trials import Schema, Trials

if TYPE_CHECKING:
    from commonlaw.law import Law

_SCHEMA = Schema(("x", "y", "z"))
_START = np.array([-8.0, 8.0, 27.0])


def _load(
    sigma: PerObject = 10.0,
    rho: PerObject = 28.0,
    beta: PerObject = 8 / 3,
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
    trials, samples, rate
        Runs of each system, samples in each run, and samples in a unit of time.
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
    systems = objects("System", sigma=sigma, rho=rho, beta=beta)
    paths = {name: exact_path(_derivatives, _start, row, times, name) for name, row in systems.items()}
    return measure(paths, _SCHEMA, times, trials, noise, seed)


def _truth(sigma: PerObject, rho: PerObject, beta: PerObject) -> "Law":
    """Return the law of these systems."""
    rows = {
        name: [[-s, s, 0.0, 0.0, 0.0], [r, -1.0, 0.0, 0.0, -1.0], [0.0, 0.0, -b, 1.0, 0.0]]
        for name, (s, r, b) in objects("System", sigma=sigma, rho=rho, beta=beta).items()
    }
    return exact_law(_SCHEMA, ["x", "y", "z", "x*y", "x*z"], rows)


def _derivatives(coefficients: tuple[float, ...], y: Floats) -> list[float]:
    sigma, rho, beta = coefficients
    return [sigma * (y[1] - y[0]), y[0] * (rho - y[2]) - y[1], y[0] * y[1] - beta * y[2]]


def _start(_: tuple[float, ...], source: NormalSource) -> Floats:
    return _START + source.standard_normal((3,))


lorenz = Dataset(
    "lorenz",
    "simulated chaos: x' = 10 (y - x), y' = x (28 - z) - y, z' = x y - 8/3 z",
    "E. N. Lorenz, Deterministic Nonperiodic Flow, Journal of the Atmospheric Sciences 20 (1963) 130",
    _load,
    _truth,
)
