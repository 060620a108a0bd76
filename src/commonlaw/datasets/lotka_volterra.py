"""Prey and predators: several pairs of species with rates of their own."""

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

_SCHEMA = Schema(("x", "y"))


def _load(
    growth: PerObject = (1.0, 0.8, 1.2, 0.9, 1.1),
    predation: PerObject = (0.1, 0.08, 0.1, 0.12, 0.09),
    decline: PerObject = (1.5, 1.2, 1.0, 1.4, 1.3),
    reproduction: PerObject = (0.075, 0.06, 0.05, 0.07, 0.08),
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
    trials, samples, rate
        Runs of each pair, samples in each run, and samples in a unit of time.
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
    pairs = _pairs(growth=growth, predation=predation, decline=decline, reproduction=reproduction)
    paths = {name: exact_path(_derivatives, _start, rates, times, name) for name, rates in pairs.items()}
    return measure(paths, _SCHEMA, times, trials, noise, seed)


def _truth(growth: PerObject, predation: PerObject, decline: PerObject, reproduction: PerObject) -> "Law":
    """Return the law of these pairs of species."""
    pairs = _pairs(growth=growth, predation=predation, decline=decline, reproduction=reproduction)
    rows = {name: [[a, 0.0, -b], [0.0, -c, d]] for name, (a, b, c, d) in pairs.items()}
    return exact_law(_SCHEMA, ["x", "y", "x*y"], rows)


def _derivatives(rates: tuple[float, ...], y: Floats) -> list[float]:
    a, b, c, d = rates
    return [a * y[0] - b * y[0] * y[1], -c * y[1] + d * y[0] * y[1]]


def _start(rates: tuple[float, ...], source: NormalSource) -> Floats:
    a, b, c, d = rates
    return np.array([c / d, a / b]) * np.exp(source.standard_normal((2,)) / 2)


def _pairs(**rates: PerObject) -> dict[str, tuple[float, ...]]:
    return objects("Pair", positive=True, **rates)


lotka_volterra = Dataset(
    "lotka-volterra",
    "simulated prey and predators, five pairs of species: x' = a x - b x y, y' = -c y + d x y",
    "A. J. Lotka, Elements of Physical Biology (1925); V. Volterra, Fluctuations in the Abundance of a Species "
    "considered Mathematically, Nature 118 (1926) 558",
    _load,
    _truth,
)
