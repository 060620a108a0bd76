"""Where a further trial should start, to tell a law from what else it could be."""

from collections.abc import Iterator
from contextlib import suppress
from itertools import product

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.forecast import forecast_from
from commonlaw.forecast.forecast import Forecast
from commonlaw.inference.settings import STRONG
from commonlaw.law import Law, PlausibleLaw
from commonlaw.law.law import with_other_laws
from commonlaw.law.parameters import left_hand_sides, rate_names
from commonlaw.outcomes import Outcome, note
from commonlaw.trials import Trials

_BAND = 1.96
"""Standard deviations that a band of 95 % reaches to each side."""

_NEAR = 0.1
"""Share of a range that counts as near it."""

_RIVALS, _STARTS, _TIMES = 2, 27, 25
"""Rivals that are forecast, starts that are tried at most, and times of each forecast."""

_Found = tuple[Floats, Forecast, Forecast, tuple[int, int]]
"""A start, the forecasts of two laws from there, and the row and the state in which they differ most."""


def outcomes_of_rivals(law: Law, trials: Trials) -> tuple[Outcome, ...]:
    """Return the rivals of a law that trials with other initial values would distinguish from it.

    Rivals, which its evidence is not strong against, forecast the trials alike. From other starts within what was
    visited forecasts of the two may be further apart than their bands together: there a trial tells which one holds.
    """
    own = 1.0 - sum(each.probability for each in law.uncertainty.other_laws)
    rivals = [each for each in law.uncertainty.other_laws if each.probability > own * np.exp(-STRONG / 2)][:_RIVALS]
    if not rivals or law.order == 0 or law.schema.inputs or not law.uncertainty.has_std:
        return ()
    lasting = float(np.median([trial.times[-1] - trial.times[0] for trial in trials]))
    times = trials.trials[0].times[0] + np.linspace(0, lasting, _TIMES)
    starts = ((rival, _start_that_tells(law, rival.law, times)) for rival in rivals)
    return tuple(_outcome(law, rival, found) for rival, found in starts if found is not None)


def _start_that_tells(law: Law, rival: Law, times: Floats) -> _Found | None:
    """Return the start from which two laws differ most, their forecasts, and the sample at which they do."""
    best = 1.0
    found: _Found | None = None
    for start in _starts(law):
        with suppress(CommonlawError):
            one, other = (_alone(each, times, start) for each in (law, rival))
            apart = _bands_apart(one, other) * _within(law, one)
            if apart.max(initial=0.0) > best:
                row, state = np.unravel_index(int(apart.argmax()), apart.shape)
                best, found = float(apart.max()), (start, one, other, (int(row), int(state)))
    return found


def _starts(law: Law) -> Iterator[Floats]:
    """Yield starts at the ends and in the middle of what was visited; rates at rest too, if they nearly were."""
    variables, visited = law.terms.variables.states, law.provenance.domain.visited
    if not all(name in visited for name in variables):
        return
    values = []
    for name in variables:
        low, high = visited[name]
        middle = 0.0 if name in rate_names(law) and _beyond(np.zeros(1), (low, high))[0] <= _NEAR else (low + high) / 2
        values.append((middle, low, high))
    for _, start in zip(range(_STARTS), product(*values), strict=False):
        yield np.array(start)


def _beyond(values: Floats, ends: tuple[float, float]) -> Floats:
    """Return how far values lie beyond a range, in its width, shape (n,)."""
    low, high = ends
    return np.asarray(np.maximum(np.maximum(low - values, values - high), 0.0) / max(high - low, 1e-300))


def _within(law: Law, forecast: Forecast) -> Floats:
    """Return 1 while a forecast stays near what was visited and 0 from then on, shape (n, 1)."""
    visited, (states, _) = law.provenance.domain.visited, _first(forecast)
    pairs = zip(law.schema.states, states.T, strict=True)
    near = np.all([_beyond(np.nan_to_num(own, nan=np.inf), visited[name]) <= _NEAR for name, own in pairs], axis=0)
    return np.logical_and.accumulate(near)[:, np.newaxis].astype(np.float64)


def _alone(law: Law, times: Floats, start: Floats) -> Forecast:
    return forecast_from(with_other_laws(law, ()), law.objects[0], times, start)


def _bands_apart(one: Forecast, other: Forecast) -> Floats:
    """Return how far forecasts of a state are apart in the sum of their bands, shape (n, states)."""
    (a, first), (b, second) = _first(one), _first(other)
    with np.errstate(all="ignore"):
        apart = np.abs(a - b) / (_BAND * (first + second))
    return np.asarray(np.where(np.isfinite(apart), apart, 0.0))


def _first(forecast: Forecast) -> tuple[Floats, Floats]:
    """Return the states that the only trajectory goes through, and how far off measurements of them are.

    Each of shape (n, states), the latter as standard deviations.
    """
    assert forecast.std is not None
    assert forecast.noise is not None
    names, followed = forecast.trials.schema.states, forecast.followed
    path = forecast.trajectories[0].states[:, : len(names)]
    relative = np.isin(names, followed.trials.schema.logarithmic if followed else ())
    return path, np.hypot(forecast.std[0][:, : len(names)], forecast.noise * np.where(relative, path, 1.0))


def _outcome(law: Law, rival: PlausibleLaw[Law], found: _Found) -> Outcome:
    start, one, other, (row, state) = found
    variables, schema = law.terms.variables.states, law.schema
    units = {name: f" {schema.units.get(name, '')}".rstrip() for name in schema.states}
    begin = " and ".join(
        f"{name} = {value:.3g}{units.get(name, '')}" for name, value in zip(variables, start, strict=True)
    )
    one_end, other_end = (
        f"{states[row, state]:.3g} ± {_BAND * std[row, state]:.2g}{units[schema.states[state]]}"
        for states, std in map(_first, (one, other))
    )
    times = one.trials.trials[0].times
    after = f"{times[row] - times[0]:.3g} {schema.units.get(schema.time, '')}".rstrip()
    return note(
        "rival-plausible",
        exchange=_exchange(law, rival.law),
        probability=rival.probability,
        object=law.objects[0],
        begin=begin,
        state=schema.states[state],
        one_end=one_end,
        after=after,
        other_end=other_end,
    )


def _exchange(law: Law, rival: Law) -> str:
    """Return which terms a rival has in place of those of the law, equation by equation."""
    parts = []
    for side, own, others in zip(left_hand_sides(law), _names(law), _names(rival), strict=True):
        more, fewer = (", ".join(x for x in one if x not in other) for one, other in ((others, own), (own, others)))
        if more or fewer:
            change = f"{more} in place of {fewer}" if more and fewer else f"{more} as well" if more else f"no {fewer}"
            parts.append(f"{side} with {change}")
    return ", ".join(parts)


def _names(law: Law) -> list[list[str]]:
    """Return the terms of each equation, without the parameters inside them."""
    return [[law.terms.names[k] for k in np.flatnonzero(own & law.terms.is_factor)] for own in law.support]
