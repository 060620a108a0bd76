"""Derivatives that are given with trials, in place of those that are estimated from samples."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.formulation import TrialDerivatives
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.transformations import without_rates

GivenDerivatives = ArrayLike | Sequence[ArrayLike] | Mapping[str, Any]
"""An array for each trial, shape (n, states); or by state the name of a column, or an array for each trial, (n,)."""


def with_derivatives(trials: Trials | TrialStream, given: GivenDerivatives) -> tuple[Trials, TrialDerivatives]:
    """Return trials without columns of derivatives, and the derivatives of each trial.

    Raises `CommonlawError` if trials come from a stream, a state has no derivatives, or these have another shape or are
    not finite.
    """
    if isinstance(trials, TrialStream):
        raise CommonlawError("derivatives-of-stream")
    by_state: Mapping[str, Any] = given if isinstance(given, Mapping) else {}
    columns = {state: name for state, name in by_state.items() if isinstance(name, str)}
    for name in columns.values():
        check_choice("column", name, trials.schema.states)
    states = [name for name in trials.schema.states if name not in columns.values()]
    for name in by_state:
        check_choice("state", name, states)
    if isinstance(given, Mapping):
        if missing := [name for name in states if name not in by_state]:
            raise CommonlawError("derivatives-missing", states=missing)
        listed = [
            np.column_stack(each) for each in zip(*(_of_each(by_state[name], trials) for name in states), strict=True)
        ]
    else:
        listed = _of_each(given, trials)
    result = TrialDerivatives()
    for trial, own in zip(trials, listed, strict=True):
        values = own.reshape(len(own), -1)
        if values.shape != (len(trial), len(states)):
            raise CommonlawError("derivatives-shape", trial.label, shape=own.shape, expected=(len(trial), len(states)))
        used = np.isfinite(values).all(axis=1)
        if not used.all():
            raise CommonlawError("derivatives-not-finite", trial.label, sample=int(np.argmin(used)) + 1)
        result[trial.object, trial.name] = trial.times, values
    return without_rates(trials, columns), result


def _of_each(given: Any, trials: Trials) -> list[Floats]:
    """Return an array for each trial: of a list of them, of one array if there is one trial, or of a column."""
    if isinstance(given, str):
        return [trial.states[:, trials.schema.states.index(given)] for trial in trials]
    listed = list(given) if isinstance(given, list | tuple) else [given]
    if len(listed) != len(trials):
        raise CommonlawError("derivatives-of-trials", count=len(listed), trials=len(trials))
    return [np.asarray(each, dtype=np.float64) for each in listed]
