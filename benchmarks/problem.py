"""What is to be solved: simulated samples, a library, and what to do with them."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Problem:
    """Samples and settings that every contestant gets.

    Parameters
    ----------
    times
        Evenly spaced, the same for all trials, shape (n,).
    states
        Shape (trials, n, states).
    degree
        Of the polynomial library.
    thresholds
        Of sequentially thresholded least squares.
    models
        How many bootstrap models are wanted.
    law
        Coefficients of a law that is to be integrated from the first state, shape (states, terms).
    """

    times: Floats
    states: Floats
    degree: int
    thresholds: tuple[float, ...] = (0.1,)
    models: int = 0
    law: Floats = field(default_factory=lambda: np.empty((0, 0)))

    @property
    def step(self) -> float:
        """The time between samples."""
        return float(self.times[1] - self.times[0])

    @property
    def rows(self) -> int:
        """The number of regression rows."""
        return int(np.prod(self.states.shape[:2]))

    @property
    def terms(self) -> int:
        """The number of candidate terms."""
        return math.comb(self.states.shape[2] + self.degree, self.degree)

    @property
    def columns(self) -> int:
        """The number of candidate terms and targets."""
        return self.terms + int(self.states.shape[2])


def lorenz(
    samples: int, degree: int = 5, *, trials: int = 1, thresholds: tuple[float, ...] = (0.1,), models: int = 0
) -> Problem:
    """Return samples on the attractor of Lorenz's system, 0.001 apart."""

    def field(state: Floats, _: float) -> list[float]:
        x, y, z = state.tolist()
        return [10 * (y - x), x * (28 - z) - y, x * y - 8 / 3 * z]

    states = _sampled(field, [-8.0, 8.0, 27.0], 0.001, samples * trials).reshape(trials, samples, 3)
    return Problem(_times(samples, 0.001), states, degree, thresholds, models)


def lorenz96(samples: int, size: int = 10) -> Problem:
    """Return samples of the chaotic ring of Lorenz (1996) with forcing 8, 0.005 apart, and all cubic terms."""

    def field(state: Floats, _: float) -> list[float]:
        x = state.tolist()
        return [(x[i + 1 - size] - x[i - 2]) * x[i - 1] - x[i] + 8 for i in range(size)]

    start = [8 + 0.01 * i for i in range(size)]
    return Problem(_times(samples, 0.005), _sampled(field, start, 0.005, samples)[np.newaxis], 3)


def lorenz_law(end: float = 100.0, step: float = 0.01) -> Problem:
    """Return Lorenz's law, among the 10 terms of degree 2, and where it is to be integrated from and to."""
    law = np.zeros((3, 10))
    # Places: 1 x, 2 y, 3 z, 5 x y, 6 x z
    law[0, [1, 2]] = -10, 10
    law[1, [1, 2, 6]] = 28, -1, -1
    law[2, [3, 5]] = -8 / 3, 1
    return _to_integrate(law, end, step)


def roessler_law() -> Problem:
    """Return the law of another system: a warm-up compiles nothing that is measured, at points enough to compile."""
    law = np.zeros((3, 10))
    law[0, [2, 3]] = -1, -1
    law[1, [1, 2]] = 1, 0.2
    law[2, [0, 3, 6]] = 0.2, -5.7, 1
    return _to_integrate(law, 0.6, 0.0001)


def _to_integrate(law: Floats, end: float, step: float) -> Problem:
    return Problem(_times(round(end / step) + 1, step), np.array([[[-8.0, 8.0, 27.0]]]), 2, law=law)


def _times(samples: int, step: float) -> Floats:
    return np.asarray(np.arange(samples) * step, dtype=np.float64)


def _sampled(field: Callable[[Floats, float], list[float]], start: list[float], step: float, samples: int) -> Floats:
    from scipy.integrate import odeint

    on_attractor = odeint(field, start, [0.0, 10.0], mxstep=100_000)[-1]
    return np.asarray(odeint(field, on_attractor, _times(samples, step), rtol=1e-10, atol=1e-10, mxstep=100_000))
