"""Columns that hold the rate of a state of second order, which have no equation of their own."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.trials.trial import Trial
from commonlaw.trials.trials import Trials


def without_rates(trials: Trials, rates: Mapping[str, str]) -> Trials:
    """Return trials without the columns that are rates of states; their schema and a note say which these are.

    Parameters
    ----------
    trials
        What was measured.
    rates
        The column of its rate by state, see `Schema`. Columns that the trials do not have as states are passed over.

    Raises
    ------
    CommonlawError
        If nothing else was measured in a trial.
    """
    schema, left_out = trials.schema, [*rates.values()]
    kept = [j for j, name in enumerate(schema.states) if name not in left_out]
    if len(kept) == len(schema.states):
        return trials
    gone = {name for name in schema.states if name in left_out}
    states = tuple(schema.states[j] for j in kept)
    return replace(
        trials,
        trials=tuple(_with_columns(trial, kept, states) for trial in trials),
        schema=replace(
            schema,
            states=states,
            units={name: unit for name, unit in schema.units.items() if name not in gone},
            noise_columns={name: column for name, column in schema.noise_columns.items() if name not in gone},
            rates=rates,
        ),
        notes=(*trials.notes, f"left out: {rates_in_words(rates)}"),
    )


def rates_in_words(rates: Mapping[str, str]) -> str:
    """Return which column is the rate of which state.

    >>> rates_in_words({"theta": "omega"})
    'omega is the rate of theta'
    """
    return ", ".join(f"{rate} is the rate of {state}" for state, rate in rates.items())


def _with_columns(trial: Trial, kept: list[int], names: tuple[str, ...]) -> Trial:
    """Return a trial with some of its states, without samples in which only others were measured."""
    states, measured = trial.states[:, kept], np.isfinite(trial.states).any(axis=1)
    rows = np.asarray(np.isfinite(states).any(axis=1) | ~measured)
    if not np.isfinite(states).any():
        raise CommonlawError("state-not-in-trial", where=trial.label, names=names)
    found = trial.rows(rows)
    repeats = found.repeats and found.repeats.taken((slice(None), kept))
    return replace(found, states=found.states[:, kept], noise=found.noise[:, kept], repeats=repeats)
