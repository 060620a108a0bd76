"""Prey and predators: several pairs of species with rates of their own."""

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

_SCHEMA = Schema(("x", "y"))
_GROWTH = (1.0, 0.8, 1.2, 0.9, 1.1)
_PREDATION = (0.1, 0.08, 0.1, 0.12, 0.09)
_DECLINE = (1.5, 1.2, 1.0, 1.4, 1.3)
_REPRODUCTION = (0.075, 0.06, 0.05, 0.07, 0.08)


def _load(
    growth: float | Sequence[float] = _GROWTH,
    predation: float | Sequence[float] = _PREDATION,
    decline: float | Sequence[float] = _DECLINE,
    reproduction: float | Sequence[float] = _REPRODUCTION,
    trials: int = 2,
    samples: int = 200,
    rate: float = 10.0,
    noise: float = 0.0,
    seed: Seed = 0,
) -> Trials:
    """Return runs of ``x' = growth x - predation x y``, ``y' = -decline y + reproduction x y``.

    Each run starts at the pair's equilibrium times ``exp(normal / 2)``, drawn for each species.

    Parameters
    ----------
    growth, predation, decline, reproduction
        Positive rates of each pair of prey x and predators y; a single number serves all pairs.
    trials
        Runs of each pair.
    samples
        Number of samples in each run.
    rate
        Samples in a unit of time.
    noise
        Standard deviation of the white noise on both numbers of animals.
    seed
        A whole number; or a NumPy generator of random numbers, which is drawn from pair by pair, run by run: first
        the start, then the noise.

    Raises
    ------
    CommonlawError
        If an option cannot be, such as a negative rate.
    """
    times = sample_times(samples, rate)
    pairs = _pairs(growth, predation, decline, reproduction)
    paths = {name: _path(name, np.array(rates), times) for name, rates in pairs.items()}
    return Measurement(times, trials, noise, seed).of(paths, _SCHEMA)


def _truth(
    growth: float | Sequence[float] = _GROWTH,
    predation: float | Sequence[float] = _PREDATION,
    decline: float | Sequence[float] = _DECLINE,
    reproduction: float | Sequence[float] = _REPRODUCTION,
) -> "Law":
    """Return the law of these pairs of species."""
    pairs = _pairs(growth, predation, decline, reproduction)
    rows = {name: [[a, 0.0, -b], [0.0, -c, d]] for name, (a, b, c, d) in pairs.items()}
    return exact.law(_SCHEMA, ["x", "y", "x*y"], rows)


def _path(name: str, rates: Floats, times: Floats) -> Path:
    """Return the function that draws a start and runs from there."""
    a, b, c, d = rates

    def field(_: float, y: Floats) -> Floats:
        return np.array([a * y[0] - b * y[0] * y[1], -c * y[1] + d * y[0] * y[1]])

    def path(source: NormalSource) -> Floats:
        start = np.array([c / d, a / b]) * np.exp(source.standard_normal((2,)) / 2)
        return exact.trajectory(field, start.tolist(), times, name)

    return path


def _pairs(
    growth: float | Sequence[float],
    predation: float | Sequence[float],
    decline: float | Sequence[float],
    reproduction: float | Sequence[float],
) -> dict[str, tuple[float, ...]]:
    """Return the four rates of each pair by name."""
    rows = together(
        growth=numbers("growth", growth, positive=True),
        predation=numbers("predation", predation, positive=True),
        decline=numbers("decline", decline, positive=True),
        reproduction=numbers("reproduction", reproduction, positive=True),
    )
    return {f"Pair {i}": row for i, row in enumerate(rows, 1)}


lotka_volterra = Dataset(
    "lotka-volterra",
    "simulated prey and predators, five pairs of species: x' = a x - b x y, y' = -c y + d x y",
    "A. J. Lotka, Elements of Physical Biology (1925); V. Volterra, Fluctuations in the Abundance of a Species "
    "considered Mathematically, Nature 118 (1926) 558",
    _load,
    _truth,
)
