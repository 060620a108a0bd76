"""Data checks that ask what laws trials could tell apart, in words."""

from collections.abc import Sequence

from commonlaw.discovery.measured_rates import without_measured_rates
from commonlaw.errors import CommonlawError
from commonlaw.inference.diagnose.confounding import StandIns, stand_ins
from commonlaw.law.text import left_hand_sides
from commonlaw.library import AbstractLibrary, Order
from commonlaw.outcomes import Outcome, note
from commonlaw.trials import Schema, Trials
from commonlaw.trials.check import Finding

_ALIKE = 0.1
"""Share of what is visited within which all trials start alike."""

_LISTED = 4
"""Sets of variables that are listed."""


def confounded_variables(
    trials: Trials, order: int | None = None, library: AbstractLibrary | str | None = None
) -> tuple[Finding, ...]:
    """Return what trials cannot tell of the variables of a law, see `Trials.check`.

    Raises
    ------
    CommonlawError
        If there is no such order, or the library does not fit the variables.
    """
    order = (2 if len(trials.schema.states) == 1 else 1) if order is None else order
    if order not in (0, 1, 2):
        raise CommonlawError("order-unsupported", order=order)
    if order == 0:
        return ()
    asked, _ = without_measured_rates(trials, trials.schema.states if order == 2 else ())
    noted = [(each, _note(each, asked, order)) for each in stand_ins(asked, order, library)]
    return tuple(Finding(f"{note.where}: {note.text}; {note.remedy}", column=each.state) for each, note in noted)


def outcomes_of_stand_ins(trials: Trials, order: Order, library: AbstractLibrary) -> tuple[Outcome, ...]:
    """Return what to know of a law whose variables the training trials confound."""
    return tuple(_note(each, trials, order) for each in (stand_ins(trials, order, library) if order else ()))


def _note(found: StandIns, trials: Trials, order: Order) -> Outcome:
    """Return what variables stand in for each other, and why."""
    states = trials.schema.states
    varying = ", with coefficients by trial," if found.by_trial else ""
    left = " or ".join(f"{each:.3g}" for each in found.left[:_LISTED])
    cause = ""
    if all(high - low <= _ALIKE * _width(found.visited[name]) for name, (low, high) in found.starts.items()):
        cause = f", because all trials have similar initial conditions{_ranges(found, trials.schema)}"
    return note(
        "confounded",
        left_hand_sides(states, order)[states.index(found.state)],
        variables=_and(list(found.starts)),
        cause=cause,
        alternatives=_alternatives(found) + varying,
        residuals=left,
        residual=found.left_by_all,
        unit=f" {trials.schema.units.get(found.state, '')}".rstrip(),
        first=next(iter(found.starts)),
    )


def _alternatives(found: StandIns) -> str:
    """Return sets of variables in words: ``x alone or v alone``."""
    *first, last = (f"{each[0]} alone" if len(each) == 1 else _and(each) for each in found.sets[:_LISTED])
    more = f", or {len(found.sets) - _LISTED} other sets" if len(found.sets) > _LISTED else ""
    return f"{', '.join(first)}{',' if more else ' or'} {last}{more}"


def _ranges(found: StandIns, schema: Schema) -> str:
    """Return where trials start, of what was measured: rates are too uncertain there."""
    units = {name: f" {schema.units.get(name, '')}".rstrip() for name in schema.states}
    parts = [
        f"{each} = {low:.3g} to {high:.3g}{units[each]}" for each, (low, high) in found.starts.items() if each in units
    ]
    return f", at {_and(parts)}" if parts else ""


def _and(parts: Sequence[str]) -> str:
    """Return words with commas between them, and ``and`` before the last."""
    *first, last = parts
    return f"{', '.join(first)} and {last}" if first else last


def _width(ends: tuple[float, float]) -> float:
    return ends[1] - ends[0]
