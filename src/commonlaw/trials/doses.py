"""Doses: amounts that are added to states at once, as inputs that are large for a moment."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.trials.recognition import note_on_pulses
from commonlaw.trials.trial import Trial
from commonlaw.trials.trials import Trials

MOMENT = 1e-4
"""How long a dose takes, relative to the shortest step of a trial: less than it would show."""


def with_doses(trials: Trials, doses: Sequence[str]) -> Trials:
    """Return trials in which some inputs, amounts at samples, are what is added in the moment after these.

    There an input rises and falls on straight lines over two further samples, at which nothing was measured. The
    integral is the amount. A trial whose first dose is before its first measurement begins there, with a state of zero
    as if it had been measured.

    Parameters
    ----------
    trials
        What was measured; inputs that were turned before stay.
    doses
        Names of inputs, which are zero where nothing is added.

    Raises
    ------
    CommonlawError
        If there is no such input, or other inputs beside them; if an object has no dose; or if several states were
        measured, and none of them at a first dose.
    """
    new = [name for name in doses if name not in trials.schema.doses]
    if not new:
        return trials
    for name in new:
        check_choice("input", name, trials.schema.inputs)
    others = [name for name in trials.schema.inputs if name not in doses]
    if others:
        raise CommonlawError("doses-with-inputs", inputs=others)
    begun = [_from_first_dose(trial, trials.schema.measured) for trial in trials]
    for owner in trials.objects:
        if not any(trial.inputs[:-1].any() for trial in begun if trial.object == owner):
            raise CommonlawError("doses-after-end", object=owner, doses=doses)
    schema = replace(trials.schema, doses=tuple(doses), input_between="linear")
    return replace(without_notes_on(doses, trials), trials=tuple(map(_with_moments, begun)), schema=schema)


def without_notes_on(doses: Sequence[str], trials: Trials) -> Trials:
    """Return the trials without the notes that inputs may be doses, of those that are given as such."""
    answered = {*map(note_on_pulses, doses)}
    return replace(trials, notes=tuple(note for note in trials.notes if note not in answered))


def _from_first_dose(trial: Trial, measured: Sequence[str]) -> Trial:
    """Return a trial that begins at its first dose, if that is before its first sample."""
    if not len(trial.earlier):
        return trial
    times, amounts = trial.earlier[:, 0], trial.earlier[:, 1:]
    if len(measured) > 1:
        raise CommonlawError("doses-before-start", where=trial.label, time=times[0], states=measured)
    before = np.full((len(times), trial.states.shape[1]), np.nan)
    before[0, 0] = 0.0
    noise = np.full(before.shape, np.nan)
    noise[0] = trial.noise[0]
    count = len(times) + len(trial)
    return replace(
        trial,
        times=np.concatenate([times, trial.times]),
        states=np.concatenate([before, trial.states]),
        inputs=np.concatenate([amounts, trial.inputs]),
        noise=np.concatenate([noise, trial.noise]),
        repeats=trial.repeats and trial.repeats.placed(np.arange(len(times), count), count),
        earlier=np.empty((0, 0)),
    )


def _with_moments(trial: Trial) -> Trial:
    """Return a trial whose inputs are amounts with samples in which they are added, but for those of its end."""
    given = np.flatnonzero(trial.inputs[:-1].any(axis=1))
    moment = MOMENT * float(np.diff(trial.times).min(initial=np.inf))
    times = np.concatenate([trial.times, trial.times[given] + moment, trial.times[given] + 2 * moment])
    order, none = np.argsort(times, kind="stable"), np.zeros_like(trial.inputs[given])
    inputs = np.concatenate([np.zeros_like(trial.inputs), trial.inputs[given] / moment, none])
    rows = np.flatnonzero(order < len(trial))
    return replace(
        trial,
        repeats=trial.repeats and trial.repeats.placed(rows, len(times)),
        times=times[order],
        states=_longer(trial.states, len(times))[order],
        inputs=inputs[order],
        noise=_longer(trial.noise, len(times))[order],
    )


def _longer(values: Floats, count: int) -> Floats:
    """Return values, shape (n, columns), with rows of NaN behind them, so many in all."""
    return np.pad(values, ((0, count - len(values)), (0, 0)), constant_values=np.nan)
