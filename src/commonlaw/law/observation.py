"""How the states of a law were measured: observation equations, initial values, noise."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass, field
from typing import TYPE_CHECKING, Literal

from commonlaw.errors import check_choice
from commonlaw.law.restrictions import by_trial
from commonlaw.trials import Schema

if TYPE_CHECKING:
    import pandas as pd


Initial = str | tuple[float, float] | Mapping[str, float]
"""An initial value: an expression of parameters and properties, a mean and a standard deviation, or numbers by object.

Numbers may be those of trials, by their labels; other objects and trials then have theirs estimated.

The expression ``steady`` stands for the steady state, ``steady(u = 0)`` for that under other inputs.
"""
Scheme = Literal["collocation", "shooting"]
"""How solutions are computed: as states on a mesh that fulfil the equations, or from initial values."""
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


class TrialEstimates(tuple[TrialEstimate, ...]):
    """What was estimated of each trial: initial values, and parameters that differ between trials of an object."""

    def to_frame(self) -> "pd.DataFrame":
        """Return a table: object, trial, parameter, estimate, standard error."""
        import pandas as pd

        columns = ["object", "trial", "parameter", "estimate", "standard error"]
        return pd.DataFrame([astuple(estimate) for estimate in self], columns=columns)


@dataclass(frozen=True)
class Observation:
    """What was measured of the states of a law, and how they begin and change.

    Parameters
    ----------
    measured
        Names and units of the trials that the law is of; its states are what was measured.
    equations
        What measured quantities are, by name, as expressions of states, inputs, time and parameters; the others are
        states.
    initial
        Initial values of states and rates; the others are estimated in each trial, or are in the law's schema.
    initial_time
        Their time, None for that of the first sample of each trial.
    events
        By condition the values that states and rates take where it becomes true, by name, as expressions.
    functions
        By state what is added to its equation: expressions by the parameters that they are multiplied with.

    Raises
    ------
    CommonlawError
        If an equation is of something that was not measured.
    """

    measured: Schema
    equations: Mapping[str, str] = field(default_factory=dict)
    initial: Mapping[str, Initial] = field(default_factory=dict)
    initial_time: float | None = None
    events: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    functions: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in self.equations:
            check_choice("measured quantity", name, self.measured.states)

    @classmethod
    def direct(cls, schema: Schema) -> "Observation":
        """Return that of states that were measured themselves."""
        return cls(schema, initial_time=schema.initial_time)

    @property
    def is_of_more(self) -> bool:
        """Whether there is more in it than that states were measured themselves."""
        return bool(self.equations or self.initial or self.events or self.functions)

    @property
    def written(self) -> dict[str, str]:
        """Right-hand sides of observation equations, expressions of initial values, and events, by left-hand side."""
        return written(self.equations, self.initial, self.events)

    def lines(self, objects: Sequence[str], shared: Mapping[str, str]) -> list[str]:
        """Return observation equations, initial values and events as they are printed, and what differs between trials.

        Parameters are shared as in `Restrictions`. In a law of one object trials go by their names. Trials of one
        initial value have one line, which equations may have, too: ``A(0) = 0 @ "1", "2"``.
        """
        numbers = {name: start for name, start in self.initial.items() if isinstance(start, Mapping)}
        prefix = f"{objects[0]}, trial " if len(objects) == 1 else ""
        trials = dict[str, list[str]]()
        for name, start in numbers.items():
            for where, value in start.items():
                trials.setdefault(f"{name}(0) = {value:g}", []).append(f'"{where.removeprefix(prefix)}"')
        by_name = [f"{start} @ {', '.join(names)}" for start, names in trials.items()]
        priors = {f"{name}(0)": f"{s[0]:g} ± {s[1]:g}" for name, s in self.initial.items() if isinstance(s, tuple)}
        apart = [f"{name} by {by}; means are shown" for name, by in shared.items() if by_trial(by, self.measured)]
        return [*(f"{name} = {right}" for name, right in (self.written | priors).items()), *by_name, *apart]

    def place_of(self, parameter: str) -> str:
        """Return the left-hand side of the equation in which a parameter stands first; empty if in none of these."""
        word = re.compile(rf"(?<!\w){re.escape(parameter)}(?!\w)")
        return next((name for name, text in self.written.items() if word.search(f"{name} = {text}")), "")


STATES = Observation(Schema(("states",)))
"""Stands for that of any law of which all states were measured themselves, see `Observation.direct`."""
