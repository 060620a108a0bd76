"""How the states of a law were measured: observation equations, initial values, noise."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.trials import Schema


@dataclass(frozen=True)
class InitialValue:
    """An initial value that the measurements of a trial determined, with its standard error."""

    object: str
    trial: str
    state: str
    value: float
    error: float


@dataclass(frozen=True)
class Observation:
    """How the states of a law were measured.

    Parameters
    ----------
    measured
        Names and units of the trials that the law is of; its states are what was measured.
    equations
        What measured quantities are, by name, as expressions of states, inputs, time and parameters; the others are
        states.
    initial
        Initial values of states and rates as expressions of parameters and properties; the others are estimated in each
        trial.
    initial_time
        Their time, None for that of the first sample of each trial.
    noise
        Standard deviation of the measurement noise by measured quantity, relative where it is log-scaled; no entry
        where each measurement has its own.
    estimated
        Initial values that were estimated.
    log_likelihood
        Of the measurements, at the maximum.
    """

    measured: Schema
    equations: Mapping[str, str]
    initial: Mapping[str, str]
    initial_time: float | None
    noise: Mapping[str, float]
    estimated: tuple[InitialValue, ...]
    log_likelihood: float

    @property
    def lines(self) -> list[str]:
        """The observation equations and initial values, as they are printed."""
        return [
            *(f"{name} = {right}" for name, right in self.equations.items()),
            *(f"{name}(0) = {right}" for name, right in self.initial.items() if right.strip("`") != f"{name}(0)"),
        ]

    @property
    def noise_levels(self) -> Floats | None:
        """The noise of each measured quantity, shape (m,); None if a quantity has none of its own."""
        found = np.array([self.noise.get(name, np.nan) for name in self.measured.states])
        return found if np.isfinite(found).all() else None
