"""Objects at rest, such as the blanks of a plate: they carry no information about coefficients of their own."""

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.outcomes import Outcome, note
from commonlaw.text import shown
from commonlaw.trials.trial import Trial
from commonlaw.trials.trials import Trials

_DIFFERENCES = 10
"""Differences of neighbouring samples by which a state at rest is known."""

_SHARE = 0.01
"""Share of the mean variance of all objects below which that of one does not count in a law common to all."""


def objects_at_rest(trials: Trials) -> tuple[str, ...]:
    """Return the objects whose states stay constant within their noise while those of others change, with no input.

    Differences d of neighbouring samples and deviations e from the mean of a trial are those of white noise alone (von
    Neumann 1941): sum d^2 / sum e^2 = 2 with a standard deviation of 2 / sqrt(n), of n differences. The variance is
    less than a hundredth of the mean of all objects. Objects with few samples, or with inputs that change, count as
    moving.
    """
    names = trials.objects
    found = [_squares(trials.of_object(name)) for name in names]
    count, differences, deviations = (np.array([each[k] for each in found]) for k in range(3))
    with np.errstate(divide="ignore", invalid="ignore"):
        is_noise = differences >= (2 - 4 / np.sqrt(count)) * deviations
        variance = deviations / count
    counted = np.where(count >= _DIFFERENCES, variance, np.nan)
    if np.isnan(counted).all(axis=0).any():
        return ()
    is_small = variance < _SHARE * np.nanmean(counted, axis=0)
    at_rest = ((count >= _DIFFERENCES) & is_noise & is_small).all(axis=1)
    return tuple(
        name for name, rests in zip(names, at_rest, strict=True) if rests and not _is_driven(trials.of_object(name))
    )


def without_objects(trials: Trials, names: tuple[str, ...]) -> Trials:
    """Return the trials of other objects than those of these names."""
    return trials.with_trials([each for each in trials if each.object not in names]) if names else trials


def outcome_of_rest(names: tuple[str, ...]) -> tuple[Outcome, ...]:
    """Return that objects at rest were left out, by name; nothing if there are none."""
    if not names:
        return ()
    return (note("objects-at-rest", objects=shown(names, "object")),)


def _squares(trials: tuple[Trial, ...]) -> Floats:
    """Return the number of differences, their sum of squares, and that of deviations from means: shape (3, states)."""
    total = np.zeros((3, trials[0].states.shape[1]))
    for trial in trials:
        for j, column in enumerate(trial.states.T):
            seen = column[np.isfinite(column)]
            if len(seen) > 1:
                total[:, j] += len(seen) - 1, np.sum(np.diff(seen) ** 2), np.sum((seen - seen.mean()) ** 2)
    return total


def _is_driven(trials: tuple[Trial, ...]) -> bool:
    inputs = np.concatenate([each.inputs for each in trials])
    return bool(inputs.size) and bool((inputs != inputs[0]).any())
