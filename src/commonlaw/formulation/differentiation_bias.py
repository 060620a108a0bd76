"""How far targets are off because a differentiator bends what it differentiates."""

from collections.abc import Sequence

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.formulation.strong import StrongForm
from commonlaw.library import Terms
from commonlaw.trials import Trial


def differentiation_bias(
    form: StrongForm, terms: Terms, trials: Sequence[Trial], target: int, coefficients: Floats
) -> float:
    """Return the mean squared error that the differentiator itself makes in the targets of one equation.

    Steps that are too long and windows that are too wide leave an error in the rates that is a function of the state,
    so that further terms fit it, on held-out data too. It is measured by a round trip: the rates that the equation
    gives along a trial are integrated and differentiated again, and come back with about the error that the
    differentiator made the first time.

    Parameters
    ----------
    form
        Says how rates are estimated.
    terms
        The terms of the equation.
    trials
        Trials of one object.
    target
        The equation.
    coefficients
        The object's coefficients, of an equation that follows the rates but not their noise: the one with the least
        error on held-out data. Shape (terms,).

    Raises
    ------
    CommonlawError
        If a trial cannot be differentiated; the message names it.
    """
    errors = [_round_trip(form, terms, trial, target, coefficients) for trial in trials]
    return float(np.mean(np.concatenate(errors) ** 2))


def _round_trip(form: StrongForm, terms: Terms, trial: Trial, target: int, coefficients: Floats) -> Floats:
    """Return what the rates of a trial change by when they are integrated and differentiated, shape (n,)."""
    from scipy.interpolate import CubicSpline

    whole = StrongForm(form.differentiation, form.order, form.library_states)
    values, _ = whole.samples(trial)
    rates = terms.evaluate(values) @ coefficients
    state = CubicSpline(trial.times, rates).antiderivative(form.order)(trial.times)
    # Constants and straight lines are lost on the way; the trial's own ends give them back
    measured = trial.states[:, target]
    missing = np.where(np.isnan(measured), values[:, target], measured) - state
    elapsed = (trial.times - trial.times[0]) / (trial.times[-1] - trial.times[0])
    state += missing[0] + (missing[-1] - missing[0]) * elapsed * (form.order > 1)
    again = form.differentiation.differentiate(trial.times, state[:, np.newaxis], form.order).derivatives[-1][:, 0]
    return np.asarray((again - rates)[form.trim : len(trial) - form.trim])
