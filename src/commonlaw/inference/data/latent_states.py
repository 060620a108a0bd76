"""States that were not measured in some trials: where the search for a law begins with them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference.settings import LATENT_MODEL_ERRORS, ROUNDING, VAGUE
from commonlaw.likelihood import Estimate, TrajectoryModel, fit
from commonlaw.trials import Trials


def spread_within(trials: Trials) -> Floats:
    """Return the standard deviation of each state within the trials in which it was measured, shape (states,)."""
    found = np.zeros(len(trials.schema.states))
    for j in range(len(found)):
        own = [trial.states[np.isfinite(trial.states[:, j]), j] for trial in trials]
        found[j] = np.sqrt(np.mean([np.var(each) for each in own if len(each)]))
    return found


def scales_of_starts(trials: Trials) -> Floats:
    """Return the scale of each state, shape (states,), by the standard deviations of starts that nobody measured."""
    of_starts = np.max([trial.noise[0] for trial in trials], axis=0)
    return np.asarray(of_starts / np.where(trials.schema.with_free_start, VAGUE, ROUNDING))


def visited_besides(trials: Trials, estimates: Sequence[Estimate]) -> dict[str, tuple[float, float]]:
    """Return the least and the largest value of states that start where nobody knows, by name."""
    states = np.concatenate([own for each in estimates for own in each.states])
    free = np.flatnonzero(trials.schema.with_free_start)
    return {trials.schema.states[j]: (float(states[:, j].min()), float(states[:, j].max())) for j in free}


def filled_curves(curves: Sequence[tuple[Floats, Floats]], typical: Floats) -> list[Floats]:
    """Return smoothed states (and rates), shape (n, D), the typical ones, shape (D,), where a state has no curve."""
    return [np.where(np.isnan(states), typical, states) for states, _ in curves]


def typical_states(curves: Sequence[Sequence[tuple[Floats, Floats]]]) -> Floats:
    """Return the mean of each state (and rate) over all objects' curves, shape (D,)."""
    return np.asarray(np.nanmean(np.concatenate([states for group in curves for states, _ in group]), axis=0))


def begun(model: TrajectoryModel, start: Estimate, others: Sequence[Floats]) -> Estimate:
    """Return a start whose unmeasured states follow the law that other objects have, on the whole.

    Those have coefficients of shape (equations, terms); without any the start stays as it is.
    """
    if not others:
        return start
    coefficients = np.mean(others, axis=0)
    fixed = np.zeros(coefficients.shape, dtype=np.bool_)
    found = fit(model, replace(start, coefficients=coefficients), fixed, LATENT_MODEL_ERRORS)
    return Estimate(found.states, coefficients) if np.isfinite(found.objective) else start


def unmeasured_in_words(trials: Trials) -> str:
    """Return which states were not measured in how many trials; nothing if all were."""
    lacking = {
        name: sum(bool(np.isnan(trial.states[:, j]).all()) for trial in trials)
        for j, name in enumerate(trials.schema.states)
    }
    return ", ".join(f"{name} in {count} of {len(trials)} trials" for name, count in lacking.items() if count)
