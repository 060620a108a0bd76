"""How the states of a law were measured: observation equations, initial values, noise."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.law.restrictions import by_trial
from commonlaw.trials import Schema

if TYPE_CHECKING:
    import pandas as pd


Initial = str | tuple[float, float] | Mapping[str, float]
"""An initial value: an expression of parameters and properties, a mean and a standard deviation, or numbers by object.

Numbers may be those of trials, by their labels; other objects and trials then have theirs estimated.

The expression ``steady`` stands for the steady state, ``steady(u = 0)`` for that under other inputs.
"""
STEADY = re.compile(r"steady(?:\s*\((?P<inputs>[^()]*)\))?")


@dataclass(frozen=True)
class TrialEstimate:
    """A parameter or an initial value, such as ``x(0)``, that belongs to a trial, with its standard error."""

    object: str
    trial: str
    name: str
    value: float
    error: float


def written(
    equations: Mapping[str, str], initial: Mapping[str, Initial], events: Mapping[str, Mapping[str, str]]
) -> dict[str, str]:
    """Return the right-hand sides of observation equations, initial values and events, see `Observation.written`."""
    starts = {f"{name}(0)": start for name, start in initial.items() if isinstance(start, str)}
    changes = {
        f"{condition}: {name}": new for condition, assignments in events.items() for name, new in assignments.items()
    }
    return {**equations, **starts, **changes}


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
        Initial values of states and rates; the others are estimated in each trial.
    initial_time
        Their time, None for that of the first sample of each trial.
    noise
        Standard deviation of the measurement noise by measured quantity, relative where it is log-scaled, for
        measurements without one of their own.
    sizes
        The largest absolute value of each state and rate in the fitted solutions.
    estimated
        Initial values, and parameters that differ between trials of an object, by trial.
    log_likelihood
        Of the measurements, at the maximum.
    noise_of
        Standard deviations by measured quantity and object, of quantities that objects have been measured differently.
    events
        By condition the values that states and rates take where it becomes true, by name, as expressions.
    functions
        By state what is added to its equation: expressions by the parameters that they are multiplied with.
    degrees_of_freedom
        Of the noise by measured quantity, where it was estimated.

    Raises
    ------
    CommonlawError
        If a noise or a size is not a positive number, or of something that was not measured.
    """

    measured: Schema
    equations: Mapping[str, str]
    initial: Mapping[str, Initial]
    initial_time: float | None
    noise: Mapping[str, float]
    sizes: Mapping[str, float]
    estimated: tuple[TrialEstimate, ...]
    log_likelihood: float
    noise_of: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    events: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    functions: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    degrees_of_freedom: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in (*self.equations, *self.noise, *self.noise_of, *self.degrees_of_freedom):
            check_choice("measured quantity", name, self.measured.states)
        by_object = (pair for levels in self.noise_of.values() for pair in levels.items())
        levels = self.noise.items(), self.sizes.items(), self.degrees_of_freedom.items(), by_object
        for name, value in chain.from_iterable(levels):
            if not 0 < value < np.inf:
                raise CommonlawError("observation-not-positive", name=name, value=value)

    @property
    def written(self) -> dict[str, str]:
        """Right-hand sides of observation equations, expressions of initial values, and events, by left-hand side."""
        return written(self.equations, self.initial, self.events)

    def lines(self, objects: Sequence[str], shared: Mapping[str, str]) -> list[str]:
        """Return observation equations, initial values and events as they are printed, and what differs between trials.

        Parameters are shared as in `Restrictions`. In a law of one object trials go by their names.
        """
        numbers = {name: start for name, start in self.initial.items() if isinstance(start, Mapping)}
        prefix = f"{objects[0]}, trial " if len(objects) == 1 else ""
        by_name = [
            f'{name}(0) = {value:g} @ "{where.removeprefix(prefix)}"'
            for name, start in numbers.items()
            for where, value in start.items()
        ]
        priors = {f"{name}(0)": f"{s[0]:g} ± {s[1]:g}" for name, s in self.initial.items() if isinstance(s, tuple)}
        apart = [f"{name} by {by}; means are shown" for name, by in shared.items() if by_trial(by, self.measured)]
        return [*(f"{name} = {right}" for name, right in (self.written | priors).items()), *by_name, *apart]

    @property
    def noise_levels(self) -> Floats | None:
        """The noise of each measured quantity, shape (m,); None if that of a quantity is not known."""
        levels = np.array([self.noise.get(name, np.nan) for name in self.measured.states])
        return levels if np.isfinite(levels).all() else None

    def degrees_of(self, names: Sequence[str]) -> Floats | None:
        """Return the degrees of freedom for states or measured quantities, shape (names,); None if noise is known.

        Those without an estimate of noise of their own, such as latent states, have those of all.
        """
        known = self.degrees_of_freedom
        if not known:
            return None
        return np.array([known.get(name, sum(known.values())) for name in names])

    def place_of(self, parameter: str) -> str:
        """Return the left-hand side of the equation in which a parameter stands first; empty if in none of these."""
        word = re.compile(rf"(?<!\w){re.escape(parameter)}(?!\w)")
        return next((name for name, text in self.written.items() if word.search(f"{name} = {text}")), "")

    def to_frame(self) -> "pd.DataFrame":
        """Return what was estimated by trial: object, trial, parameter, estimate, standard error."""
        import pandas as pd

        columns = ["object", "trial", "parameter", "estimate", "standard error"]
        return pd.DataFrame([astuple(estimate) for estimate in self.estimated], columns=columns)
