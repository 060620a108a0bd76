"""What may happen on the way of a trajectory."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, unknown
from commonlaw.integration.vector_field import VectorField
from commonlaw.library import Terms, parse_term

_SIGNS = {"rising": 1, "falling": -1, "any": 0}
_ROUNDING = 4 * np.finfo(float).eps


@dataclass(frozen=True)
class Event:
    """An expression in the law's variables crosses a level: a ball reaches the ground when its height falls to 0.

    A start on the level is not a crossing.

    Raises `CommonlawError` if there is no such direction, or the level is not finite.

    Parameters
    ----------
    expression
        As terms are written: ``"x"``, ``"x**2 + v**2"``.
    level
        The value that is crossed, in the unit of the expression.
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
        if self.direction not in _SIGNS:
            raise unknown("direction of an event", self.direction, _SIGNS)
        if not np.isfinite(self.level):
            raise CommonlawError("event-level", expression=self.expression, level=self.level)

    @property
    def sign(self) -> int:
        """The direction as a number: 1 rising, -1 falling, 0 any."""
        return _SIGNS[self.direction]


@dataclass(frozen=True, eq=False)
class Occurrences:
    """When and where an event happened on one trajectory.

    Parameters
    ----------
    event
        What happened.
    times
        Increasing, shape (m,).
    states
        The states (and rates) then, shape (m, d).
    """

    event: Event
    times: Floats
    states: Floats


def occurrences(
    events: Sequence[Event], found: Sequence[tuple[int, float, Floats]], width: int
) -> tuple[Occurrences, ...]:
    """Return what was found, (index of the event, time, states), by event and in order of time."""
    ordered = sorted(found, key=lambda each: each[1])
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
    """The expressions of events minus their levels, as functions of time and state; an event is where one is zero."""

    events: tuple[Event, ...]
    field: VectorField

    @cached_property
    def terms(self) -> Terms:
        """The expressions."""
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
        """Return their values at the start, and for one that is zero to rounding the sign that it takes just after.

        Two steps of a millionth of the span are tried, so that a ball at rest on the ground counts as falling.
        """
        with np.errstate(all="ignore"):
            values = self(t, y)
            zero = np.abs(values) <= _ROUNDING * (np.abs(values + self.levels) + np.abs(self.levels))
            if zero.any():
                step = 1e-6 * span
                later = y + step * self.field(t, y + step * self.field(t, y))
                values[zero] = np.sign(self(t + step, later)[zero]) * np.finfo(float).tiny
        return values
