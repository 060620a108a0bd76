"""A damped oscillator with cubic terms, measured once."""

from typing import TYPE_CHECKING

import numpy as np

from commonlaw.datasets.dataset import (
    DE_SILVA_2020,
    Dataset,
    Seed,
    exact_law,
    exact_trajectory,
    fixed,
    measure,
    numbers,
    sample_times,
)
from commonlaw.trials import Schema, Trials

if TYPE_CHECKING:
    from commonlaw.law import Law

_SCHEMA = Schema(("x", "y"))
_NAME = "Oscillator"
_MATRIX = np.array([[-0.1, 2.0], [-2.0, -0.1]])
_START = (2.0, 0.0)


def _load(samples: int = 500, step: float = 0.01, noise: float = 0.0, seed: Seed = 0) -> Trials:
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
    path = fixed(exact_trajectory(lambda _, y: np.asarray(_MATRIX @ y**3), _START, times, _NAME))
    return measure({_NAME: path}, _SCHEMA, times, 1, noise, seed)


def _truth() -> "Law":
    """Return the law of the oscillator."""
    return exact_law(_SCHEMA, ["x**3", "y**3"], {_NAME: _MATRIX.tolist()})


nonlinear_oscillator = Dataset(
    "nonlinear-oscillator",
    "simulated oscillator with cubic terms: x' = -0.1 x^3 + 2 y^3, y' = -2 x^3 - 0.1 y^3",
    DE_SILVA_2020,
    _load,
    _truth,
)
