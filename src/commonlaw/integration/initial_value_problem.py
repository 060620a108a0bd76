"""What is integrated, from where, and what is asked of it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.integration.event import Event
from commonlaw.integration.vector_field import VectorField


@dataclass(frozen=True, eq=False)
class InitialValueProblem:
    """One object, from where it starts, at the times where its states are wanted.

    Parameters
    ----------
    field
        Its right-hand side.
    initial
        States at the first time, shape (d,).
    times
        Increasing, shape (n,).
    where
        What is integrated, for outcomes and errors: ``"Golf Ball, trial 1"``.

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

    @cached_property
    def stops(self) -> Floats:
        """Where an input changes its course, in the span of the times, and the last time."""
        knots = self.times[:0] if self.field.inputs is None else self.field.inputs.knots
        return np.append(knots[(knots > self.times[0]) & (knots < self.times[-1])], self.times[-1])


@dataclass(frozen=True)
class OutputOptions:
    """What is asked of an integration; see `simulate`.

    Raises
    ------
    CommonlawError
        If the tolerance is not between 0 and 1.
    """

    tolerance: float = 1e-8
    events: tuple[Event, ...] = ()
    dense: bool = False
    sensitivities: bool = False
    limit: float | None = None

    def __post_init__(self) -> None:
        if not 0 < self.tolerance < 1:
            raise CommonlawError("tolerance-range", tolerance=self.tolerance)


def check_start(initial: Floats, times: Floats, where: str) -> None:
    """Refuse initial states and times that cannot be integrated."""
    index = f"{where}: " if where else ""
    if not np.all(np.isfinite(initial)):
        raise CommonlawError("initial-state-not-finite", index=index, initial=initial)
    if times.ndim != 1 or not len(times) or not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0):
        raise CommonlawError("forecast-times-not-increasing", index=index)
