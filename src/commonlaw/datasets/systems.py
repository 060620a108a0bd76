"""Simulated systems of textbooks: an oscillator, prey and predators, and chaos."""

from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.datasets.dataset import (
    DE_SILVA_2020,
    Dataset,
    NormalSource,
    PerObject,
    Seed,
    exact_law,
    exact_path,
    exact_trajectory,
    fixed,
    measure,
    numbers,
    objects,
    sample_times,
)
from commonlaw.trials import Schema, Trials

if TYPE_CHECKING:
    from commonlaw.law import Law

_PLANE = Schema(("x", "y"))
_SPACE = Schema(("x", "y", "z"))

_NAME = "Oscillator"
_MATRIX = np.array([[-0.1, 2.0], [-2.0, -0.1]])


def _load_oscillator(samples: int = 500, step: float = 0.01, noise: float = 0.0, seed: Seed = 0) -> Trials:
    """Return a run of ``x' = -0.1 x^3 + 2 y^3``, ``y' = -2 x^3 - 0.1 y^3`` from (2, 0).

    It is the first example in the appendix of de Silva et al. (2020).

    Parameters
    ----------
    samples
        Number of samples.
    step
        Time from one sample to the next.
    noise
        Standard deviation of the white noise on both states.
    seed
        A whole number, or a NumPy generator of random numbers.

    Raises
    ------
    CommonlawError
        If an option cannot be, such as a negative noise.
    """
    times = sample_times(samples, 1 / numbers("step", step, positive=True)[0])
    path = fixed(exact_trajectory(lambda _, y: np.asarray(_MATRIX @ y**3), (2.0, 0.0), times, _NAME))
    return measure({_NAME: path}, _PLANE, times, 1, noise, seed)


def _truth_of_oscillator() -> "Law":
    """Return the law of the oscillator."""
    return exact_law(_PLANE, ["x**3", "y**3"], {_NAME: _MATRIX.tolist()})


nonlinear_oscillator = Dataset(
    "nonlinear-oscillator",
    "simulated oscillator with cubic terms: x' = -0.1 x^3 + 2 y^3, y' = -2 x^3 - 0.1 y^3",
    DE_SILVA_2020,
    _load_oscillator,
    _truth_of_oscillator,
)


def _load_pairs(
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

    def derivatives(rates: tuple[float, ...], y: Floats) -> list[float]:
        a, b, c, d = rates
        return [a * y[0] - b * y[0] * y[1], -c * y[1] + d * y[0] * y[1]]

    def start(rates: tuple[float, ...], source: NormalSource) -> Floats:
        a, b, c, d = rates
        return np.array([c / d, a / b]) * np.exp(source.standard_normal((2,)) / 2)

    times = sample_times(samples, rate)
    rates_of = {"growth": growth, "predation": predation, "decline": decline, "reproduction": reproduction}
    pairs = objects("Pair", positive=True, **rates_of)
    paths = {name: exact_path(derivatives, start, rates, times, name) for name, rates in pairs.items()}
    return measure(paths, _PLANE, times, trials, noise, seed)


def _truth_of_pairs(growth: PerObject, predation: PerObject, decline: PerObject, reproduction: PerObject) -> "Law":
    """Return the law of these pairs of species."""
    rates_of = {"growth": growth, "predation": predation, "decline": decline, "reproduction": reproduction}
    pairs = objects("Pair", positive=True, **rates_of)
    rows = {name: [[a, 0.0, -b], [0.0, -c, d]] for name, (a, b, c, d) in pairs.items()}
    return exact_law(_PLANE, ["x", "y", "x*y"], rows)


lotka_volterra = Dataset(
    "lotka-volterra",
    "simulated prey and predators, five pairs of species: x' = a x - b x y, y' = -c y + d x y",
    "A. J. Lotka, Elements of Physical Biology (1925); V. Volterra, Fluctuations in the Abundance of a Species "
    "considered Mathematically, Nature 118 (1926) 558",
    _load_pairs,
    _truth_of_pairs,
)


def _load_lorenz(
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

    def derivatives(coefficients: tuple[float, ...], y: Floats) -> list[float]:
        sigma, rho, beta = coefficients
        return [sigma * (y[1] - y[0]), y[0] * (rho - y[2]) - y[1], y[0] * y[1] - beta * y[2]]

    def start(_: tuple[float, ...], source: NormalSource) -> Floats:
        return np.array([-8.0, 8.0, 27.0]) + source.standard_normal((3,))

    times = sample_times(samples, rate)
    systems = objects("System", sigma=sigma, rho=rho, beta=beta)
    paths = {name: exact_path(derivatives, start, row, times, name) for name, row in systems.items()}
    return measure(paths, _SPACE, times, trials, noise, seed)


def _truth_of_lorenz(sigma: PerObject, rho: PerObject, beta: PerObject) -> "Law":
    """Return the law of these systems."""
    rows = {
        name: [[-s, s, 0.0, 0.0, 0.0], [r, -1.0, 0.0, 0.0, -1.0], [0.0, 0.0, -b, 1.0, 0.0]]
        for name, (s, r, b) in objects("System", sigma=sigma, rho=rho, beta=beta).items()
    }
    return exact_law(_SPACE, ["x", "y", "z", "x*y", "x*z"], rows)


lorenz = Dataset(
    "lorenz",
    "simulated chaos: x' = 10 (y - x), y' = x (28 - z) - y, z' = x y - 8/3 z",
    "E. N. Lorenz, Deterministic Nonperiodic Flow, Journal of the Atmospheric Sciences 20 (1963) 130",
    _load_lorenz,
    _truth_of_lorenz,
)
