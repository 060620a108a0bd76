"""States that are above zero, by their logarithms."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.trials.headers import find_name
from commonlaw.trials.trial import Schema, Trial
from commonlaw.trials.trials import Trials


def with_logarithms(trials: Trials, states: Sequence[str]) -> Trials:
    """Return trials whose measurements of some states are replaced by their logarithms, unless they are already.

    Standard deviations of these become shares of what was measured.

    Raises
    ------
    CommonlawError
        If there is no such state, or a measurement is not above zero; the message names trial and sample.
    """
    schema = trials.schema
    names = dict.fromkeys((*schema.logarithmic, *(find_name(name, schema.states, "state") for name in states)))
    new = [schema.states.index(name) for name in names if name not in schema.logarithmic]
    if not new:
        return trials
    changed = tuple(_with_logarithms(trial, new, schema.states) for trial in trials)
    return replace(trials, trials=changed, schema=replace(schema, logarithmic=tuple(names)))


def as_measured(followed: Trials, measured: Trials) -> Trials:
    """Return measured trials at the samples of trials that were made of them by logarithms, and with their notes."""
    own = {(each.object, each.name): each for each in measured}
    rows = [_at_times(own[each.object, each.name], each) for each in followed]
    return replace(measured.with_trials(rows), notes=followed.notes)


def _at_times(measured: Trial, wanted: Trial) -> Trial:
    """Return the measured samples at the times of others, and NaN where there is none."""
    states, noise = (np.full(wanted.states.shape, np.nan) for _ in range(2))
    there = np.isin(wanted.times, measured.times)
    rows = np.searchsorted(measured.times, wanted.times[there])
    states[there], noise[there] = measured.states[rows], measured.noise[rows]
    repeats = measured.repeats and measured.repeats.taken(rows).placed(np.flatnonzero(there), len(wanted))
    return replace(wanted, states=states, noise=noise, repeats=repeats)


def natural(states: Floats, schema: Schema) -> Floats:
    """Return states, shape (n, states), that stand by their logarithms in a schema as they are themselves."""
    if not schema.logarithmic:
        return states
    found, columns = states.copy(), [schema.states.index(name) for name in schema.logarithmic]
    with np.errstate(over="ignore"):
        found[:, columns] = np.exp(found[:, columns])
    return found


def _with_logarithms(trial: Trial, columns: Sequence[int], names: Sequence[str]) -> Trial:
    states, noise, factors = trial.states.copy(), trial.noise.copy(), np.ones(trial.states.shape)
    for j in columns:
        low = np.flatnonzero(states[:, j] <= 0)
        if len(low):
            i = int(low[0])
            raise CommonlawError(
                "log-state-not-positive",
                where=trial.label,
                state=names[j],
                value=states[i, j],
                sample=i + 1,
                time=trial.times[i],
                count=len(low),
            )
        noise[:, j] /= states[:, j]
        factors[:, j] = 1 / states[:, j]
        states[:, j] = np.log(states[:, j])
    return replace(trial, states=states, noise=noise, repeats=trial.repeats and trial.repeats.scaled(factors))
