"""Initial value problems, events, output options, trajectories, and the interface of integrators."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from numbers import Real

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.diagnostics import Outcome, note
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.integration.vector_field import VectorField
from commonlaw.library import Terms, parse_term
from commonlaw.runtime.arguments import check_types
from commonlaw.runtime.forking import cached_property

_SIGNS = {"rising": 1, "falling": -1, "any": 0}


@dataclass(frozen=True)
class Event:
    """The crossing of a level by an expression in the variables of a law, as a height falls to 0 at the ground.

    An initial state on the level is not a crossing.

    Raises `CommonlawError` if there is no such direction, or the level is not finite.

    Parameters
    ----------
    expression
        In the syntax of terms: ``"x"``, ``"x**2 + v**2"``.
    level
        The level, in the unit of the expression.
    direction
        ``"rising"``, ``"falling"`` or ``"any"``.
    terminal
        Whether the trajectory ends there.

    Examples
    --------
    >>> Event("x", direction="falling", terminal=True)
    Event(expression='x', level=0.0, direction='falling', terminal=True)
    """

    expression: str
    level: float = 0.0
    direction: str = "any"
    terminal: bool = False

    def __post_init__(self) -> None:
        check_types(Event, vars(self))
        check_choice("direction of an event", self.direction, _SIGNS)
        if not np.isfinite(self.level):
            raise CommonlawError("event-level", expression=self.expression, level=self.level)

    @property
    def sign(self) -> int:
        """The direction as a number: 1 rising, -1 falling, 0 any."""
        return _SIGNS[self.direction]


@dataclass(frozen=True, eq=False)
class Occurrences:
    """The occurrences of an event on one trajectory: increasing times, shape (m,), and states (and rates), (m, d)."""

    event: Event
    times: Floats
    states: Floats


def occurrences(
    events: Sequence[Event], crossings: Sequence[tuple[int, float, Floats]], width: int
) -> tuple[Occurrences, ...]:
    """Return occurrences (index of the event, time, states) by event, in order of time."""
    ordered = sorted(crossings, key=lambda occurrence: occurrence[1])
    return tuple(
        Occurrences(
            event,
            np.array([t for i, t, _ in ordered if i == index]),
            np.array([y for i, _, y in ordered if i == index]).reshape(-1, width),
        )
        for index, event in enumerate(events)
    )


@dataclass(frozen=True, eq=False)
class EventFunctions:
    """The expressions of events less their levels, as functions of time and state, with roots at the events."""

    events: tuple[Event, ...]
    field: VectorField

    @cached_property
    def terms(self) -> Terms:
        variables = replace(self.field.terms.variables, parameters=())
        return Terms(variables, tuple(parse_term(event.expression, variables) for event in self.events))

    @cached_property
    def levels(self) -> Floats:
        """The levels, shape (events,)."""
        return np.array([event.level for event in self.events])

    def __call__(self, t: float, y: Floats) -> Floats:
        """Return their values at one time and state, shape (events,)."""
        values = self.terms.variables.natural(self.field.point(t, y))
        return np.asarray(self.terms.evaluate(values)[0] - self.levels)

    def at_start(self, t: float, y: Floats, span: float) -> Floats:
        """Return their values at the initial state; zeros, up to rounding, have the sign after two short Euler steps.

        Two steps, of 1e-6 of the span, give the sign for an equation of second order at rest, too.
        """
        with np.errstate(all="ignore"):
            values = self(t, y)
            zero = np.abs(values) <= 4 * np.finfo(float).eps * (np.abs(values + self.levels) + np.abs(self.levels))
            if zero.any():
                step = 1e-6 * span
                later = y + step * self.field(t, y + step * self.field(t, y))
                values[zero] = np.sign(self(t + step, later)[zero]) * np.finfo(float).tiny
        return values


@dataclass(frozen=True, eq=False)
class InitialValueProblem:
    """An initial value problem of one object.

    Initial states have shape (d,), and increasing times of the output (n,). The trajectory has a name in outcomes and
    errors: ``"Golf Ball, trial 1"``.

    Raises `CommonlawError` if the initial states or the times are not finite, or the times do not increase.
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
        return float(self.times[0])

    @cached_property
    def stops(self) -> Floats:
        """The knots of the inputs within the span of the times, and the last time."""
        knots = self.times[:0] if self.field.inputs is None else self.field.inputs.knots
        return np.append(knots[(knots > self.times[0]) & (knots < self.times[-1])], self.times[-1])


@dataclass(frozen=True)
class OutputOptions:
    """Options of an integration, see `simulate`.

    Raises `CommonlawError` if the tolerance is not between 0 and 1.
    """

    tolerance: float = 1e-8
    events: tuple[Event, ...] = ()
    dense: bool = False
    sensitivities: bool = False
    limit: float | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.tolerance, Real) or not 0 < self.tolerance < 1:
            raise CommonlawError("tolerance-range", tolerance=self.tolerance)


def check_start(initial: Floats, times: Floats, where: str) -> None:
    """Raise `CommonlawError` if initial states or times are not finite, or times do not increase."""
    index = f"{where}: " if where else ""
    if not np.all(np.isfinite(initial)):
        raise CommonlawError("initial-state-not-finite", index=index, initial=initial)
    if times.ndim != 1 or not len(times) or not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0):
        raise CommonlawError("forecast-times-not-increasing", index=index)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """States of one object over time.

    Parameters
    ----------
    times
        Shape (n,).
    states
        Followed by the rates of those of second order, shape (n, D); NaN after a divergence or a terminal event.
    outcome
        None if the whole span was integrated, or that up to a terminal event.
    ended
        Time of the divergence or of a terminal event; None if there is neither.
    events
        The occurrences of each requested event.
    sensitivities
        Derivatives of the states by the parameters of the vector field, and then by the initial states, shape (n,
        states, parameters + states), if requested.
    dense
        The dense output, from times, shape (m,), to states, shape (m, states), if requested.
    method
        The integrator, with the reason if it was not the first choice: ``"heyoka"``,
        ``"scipy (abs has no Taylor series at 0)"``.
    """

    times: Floats
    states: Floats
    outcome: Outcome | None = None
    ended: float | None = None
    events: tuple[Occurrences, ...] = ()
    sensitivities: Floats | None = None
    dense: Callable[[Floats], Floats] | None = None
    method: str = "scipy"

    def at(self, times: ArrayLike) -> Floats:
        """Return the states at any times of the span, shape (m, states); NaN after a divergence or terminal event.

        Raises `CommonlawError` without dense output, or if a time is outside the span.
        """
        wanted = np.atleast_1d(np.asarray(times, dtype=np.float64))
        if self.dense is None:
            raise CommonlawError("trajectory-not-dense")
        if not np.all((wanted >= self.times[0]) & (wanted <= self.times[-1])):
            raise CommonlawError("trajectory-span", first=self.times[0], last=self.times[-1])
        within = wanted <= (self.times[-1] if self.ended is None else self.ended)
        states = np.full((len(wanted), self.states.shape[1]), np.nan)
        states[within] = self.dense(wanted[within])
        return states


def diverged(time: float, why: str, where: str, how: str = "ran away") -> Outcome:
    """Return the outcome of a trajectory that diverged, or has no finite continuation."""
    return note("diverged", where, end=how, time=time, reason=why)


Function = Callable[[float, Floats], Floats]

MAX_STEPS = 100_000
ABSOLUTE_TOLERANCE = 1e-3
"""Absolute tolerance over the relative one, in scales of the states."""
MAX_RELATIVE_STATE = 1e10
"""Limit of states, relative to the initial states and their change over the first sample, beyond which they diverge."""


class AbstractIntegrator(ABC):
    """An integrator of initial value problems."""

    @abstractmethod
    def integrate(self, problem: InitialValueProblem) -> Trajectory:
        """Return the trajectory of a problem; a divergence is its outcome, not an error."""


def step_limit(stops: Floats) -> int:
    """Return the limit of steps of a trajectory, with 100 more for each knot of the inputs."""
    return MAX_STEPS + 100 * (len(stops) - 1)


def state_scale(initial: Floats, rates: Function, times: Floats) -> float:
    """Return the scale of the states: ``max|x(0)| + h max|x'(0)|`` for the first sampling step h.

    At rest at zero, it is the span times the largest of the rates at ten times in it, as of an input.
    """
    span = times[-1] - times[0]
    size = np.max(np.abs(initial)) + np.max(np.abs(rates(times[0], initial))) * (times[1] - times[0])
    if size == 0:
        size = max(np.max(np.abs(rates(t, initial))) for t in np.linspace(times[0], times[-1], 10)) * span
    return float(size) if 0 < size < np.inf else 1.0


def largest_state(problem: InitialValueProblem, options: OutputOptions) -> float:
    """Return the limit of states beyond which they diverge."""
    if options.limit is not None:
        return options.limit
    return MAX_RELATIVE_STATE * state_scale(problem.initial, problem.field, problem.times)
