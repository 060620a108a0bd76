"""What every integrator takes and gives."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.forecast.event import Event
from commonlaw.forecast.trajectory import Trajectory
from commonlaw.forecast.vector_field import VectorField
from commonlaw.outcomes import Outcome

Function = Callable[[float, Floats], Floats]

MOST_STEPS = 100_000
FAR = 1e10
"""A state this many times larger than the initial states and their change over the first sample counts as infinite."""

NOT_INTEGRATED = "not integrated"
"""The kind of outcome of a run that another integrator may finish."""


@dataclass(frozen=True, eq=False)
class Run:
    """One object, from where it starts, at the times where its states are wanted.

    Parameters
    ----------
    field
        How it moves.
    initial
        States at the first time, shape (d,).
    times
        Increasing, shape (n,).
    where
        What moves, for outcomes and errors: ``"Golf Ball, trial 1"``.

    Raises
    ------
    CommonlawError
        If the initial states or the times are not finite, or the times do not increase.
    """

    field: VectorField
    initial: Floats
    times: Floats
    where: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "initial", np.asarray(self.initial, dtype=np.float64))
        object.__setattr__(self, "times", np.ascontiguousarray(self.times, dtype=np.float64))
        check_start(self.initial, self.times, self.where)

    @property
    def start(self) -> float:
        """The first time."""
        return float(self.times[0])


@dataclass(frozen=True)
class Wanted:
    """What is asked of an integration; see `simulate`."""

    tolerance: float = 1e-8
    events: tuple[Event, ...] = ()
    dense: bool = False
    sensitivities: bool = False

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 1:
            raise CommonlawError(f"the tolerance is {self.tolerance}: give a number between 0 and 1, such as 1e-8")


class AbstractIntegrator(ABC):
    """A back end: it integrates vector fields, one run after another."""

    @abstractmethod
    def integrate(self, run: Run) -> Trajectory:
        """Return the trajectory of a run; a divergence is its outcome, and nothing but an outcome."""


def check_start(initial: Floats, times: Floats, where: str) -> None:
    """Refuse initial states and times that cannot be integrated."""
    index = f"{where}: " if where else ""
    if not np.all(np.isfinite(initial)):
        raise CommonlawError(f"{index}the initial state {initial} is not finite; give numbers")
    if times.ndim != 1 or not len(times) or not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0):
        raise CommonlawError(f"{index}the times to forecast must be finite and increase")


def size_of(initial: Floats, rates: Function, times: Floats) -> float:
    """Return the size of the initial states and of their change over the first sample.

    What rests at zero has the size that it would get in the whole span by the rates at one of ten times in it, as
    when an input sets it going.
    """
    span = times[-1] - times[0]
    size = np.max(np.abs(initial)) + np.max(np.abs(rates(times[0], initial))) * (times[1] - times[0])
    if size == 0:
        size = max(np.max(np.abs(rates(t, initial))) for t in np.linspace(times[0], times[-1], 10)) * span
    return float(size) if 0 < size < np.inf else 1.0


def not_integrated(time: float, why: str, where: str) -> Outcome:
    """Return the outcome of a trajectory that did not run away, and that the integrator could not follow on."""
    return Outcome(NOT_INTEGRATED, where, f"at t = {time:.6g}: {why}", "integrate with the method 'auto' or 'scipy'")
