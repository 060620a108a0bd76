"""Data checks that ask what laws trials could tell apart, in words."""

from collections.abc import Iterator

from commonlaw.discovery.measured_rates import without_measured_rates
from commonlaw.errors import CommonlawError
from commonlaw.inference.identifiability import StandIns, stand_ins
from commonlaw.library import AbstractLibrary
from commonlaw.trials import Schema, Trials
from commonlaw.trials.check import Finding

_ALIKE = 0.1
"""Share of what is visited within which all trials start alike."""

_LISTED = 4
"""Sets of variables that are listed."""


def variables_not_told_apart(
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
        raise CommonlawError(
            f"order {order!r} is not supported: give 1 (x' = ...), 2 (x'' = ...), or 0 for no such check"
        )
    if order == 0:
        return ()
    asked, _ = without_measured_rates(trials, order)
    few = max(len(asked.of_object(name)) for name in asked.objects) == 1
    return tuple(
        Finding("".join(_sentence(each, order, few, trials.schema)), column=each.state)
        for each in stand_ins(asked, order, library)
    )


def _sentence(found: StandIns, order: int, few: bool, schema: Schema) -> Iterator[str]:
    """Yield the parts of a sentence on variables that stand in for each other."""
    unit = f" {schema.units.get(found.state, '')}".rstrip()
    concerned = " and ".join(found.starts)
    yield f"laws for {found.state}{order * chr(39)} in {_alternatives(found)} fit alike"
    yield ", with coefficients that differ from trial to trial: they leave " if found.by_trial else ": they leave "
    yield f"{', '.join(f'{each:.3g}' for each in found.left[:_LISTED])}{unit}, "
    yield f"and laws in all variables {found.left_by_all:.3g}{unit}; "
    if all(high - low <= _ALIKE * _width(found.visited[name]) for name, (low, high) in found.starts.items()):
        yield f"all trials start alike{_ranges(found, schema)}, so that {concerned} are one curve"
    else:
        yield f"{'the trial of each object is' if few else 'trials visit'} little more than one curve of {concerned}"
    yield f"; trials from other starts, such as at other values of {next(iter(found.starts))}, would tell"


def _alternatives(found: StandIns) -> str:
    """Return sets of variables in words: ``x alone or in v alone``."""
    *first, last = (f"{each[0]} alone" if len(each) == 1 else " and ".join(each) for each in found.sets[:_LISTED])
    more = f", or in others ({len(found.sets) - _LISTED} more)" if len(found.sets) > _LISTED else ""
    return f"{', in '.join(first)}{',' if more else ' or'} in {last}{more}"


def _ranges(found: StandIns, schema: Schema) -> str:
    """Return where trials start, of what was measured: rates are too uncertain there."""
    units = {name: f" {schema.units.get(name, '')}".rstrip() for name in schema.states}
    parts = [
        f"{each} = {low:.3g} to {high:.3g}{units[each]}" for each, (low, high) in found.starts.items() if each in units
    ]
    return f", at {' and '.join(parts)}" if parts else ""


def _width(ends: tuple[float, float]) -> float:
    return ends[1] - ends[0]
