"""What every integrator takes and gives."""

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.integration.initial_value_problem import InitialValueProblem, OutputOptions
from commonlaw.integration.trajectory import Trajectory
from commonlaw.outcomes import Outcome, note

Function = Callable[[float, Floats], Floats]

MAX_STEPS = 100_000
_STEPS_TO_STOP = 100
FAR = 1e10
"""A state this many times larger than the initial states and their change over the first sample counts as infinite."""


class AbstractIntegrator(ABC):
    """A back end: it integrates one initial value problem after another."""

    @abstractmethod
    def integrate(self, problem: InitialValueProblem) -> Trajectory:
        """Return the trajectory of a problem; a divergence is its outcome, and nothing but an outcome."""


def most_steps(stops: Floats) -> int:
    """Return how many steps a trajectory may take: each stop, where inputs change their course, allows for more."""
    return MAX_STEPS + _STEPS_TO_STOP * (len(stops) - 1)


def state_scale(initial: Floats, rates: Function, times: Floats) -> float:
    """Return the size of the initial states and of their change over the first sample.

    What rests at zero has the size that it would get in the whole span by the rates at one of ten times in it, as
    when an input sets it going.
    """
    span = times[-1] - times[0]
    size = np.max(np.abs(initial)) + np.max(np.abs(rates(times[0], initial))) * (times[1] - times[0])
    if size == 0:
        size = max(np.max(np.abs(rates(t, initial))) for t in np.linspace(times[0], times[-1], 10)) * span
    return float(size) if 0 < size < np.inf else 1.0


def largest_state(problem: InitialValueProblem, options: OutputOptions) -> float:
    """Return what a state may reach before it counts as infinite."""
    if options.limit is not None:
        return options.limit
    return FAR * state_scale(problem.initial, problem.field, problem.times)


def not_integrated(time: float, why: str, where: str) -> Outcome:
    """Return the outcome of a trajectory that did not run away, and that the integrator could not follow on."""
    return note("not-integrated", where, time=time, reason=why)
