"""What rows of the strong form are worth: how many are independent, and how exact their targets are."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation.sampled import StrongForm
from commonlaw.library import Terms, highest_order, order_of_each, split_derivatives
from commonlaw.trials import Trial

_SHARE_OF_SPREAD = 1e-3
"""Height of the impulse in standard deviations of the state: small enough for methods that are linear only locally."""

SAMPLES = 4096
"""Samples of a trial that are looked at, at most."""


def effective_share(form: StrongForm, trial: Trial) -> float:
    """Return the share of a trial's rows that count as independent, above 0 and at most 1.

    White noise on the states makes noise on the targets with the autocorrelation of the derivative's impulse response
    d: ``rho_k = sum_i d_i d_(i+k) / sum_i d_i^2``. The residual variance of n rows is as certain as that of ``n / sum_k
    rho_k^2`` independent ones (Bayley and Hammersley 1946, "The effective number of independent observations in an
    autocorrelated time series"). The response is measured on the trial, around its states, by an impulse in the middle;
    a method that does not respond to it, such as a median, counts one row a window.

    Raises `CommonlawError` if the trial cannot be differentiated.
    """
    middle = slice(max(0, (len(trial) - SAMPLES) // 2), (len(trial) + SAMPLES) // 2)
    times, states = trial.times[middle], trial.states[middle]
    pushed, highest = states.copy(), highest_order(form.order)
    pushed[len(states) // 2] += _SHARE_OF_SPREAD * states.std(axis=0)
    try:
        before, after = (
            split_derivatives(form.differentiation.differentiate(times, each, highest).derivatives, form.order)[1]
            for each in (states, pushed)
        )
    except CommonlawError as error:
        raise error.at(trial.label) from None
    response = after - before
    response = response[:, np.any(response != 0, axis=0)]
    if not response.size:
        reach = form.differentiation.reach(highest)
        return 1 / len(states) if reach is None else 1 / (2 * reach + 1)
    # The transform of a response's autocorrelation is its power; twice the length keeps the ends apart
    power = np.abs(np.fft.fft(response, 2 * len(response), axis=0)) ** 2
    return float(np.mean(power.mean(axis=0) ** 2 / np.mean(power**2, axis=0)))


def differentiation_bias(
    form: StrongForm, terms: Terms, trials: Sequence[Trial], target: int, coefficients: Floats
) -> float:
    """Return the mean squared error of the differentiator itself in the targets of one equation.

    Long steps and wide windows leave an error that is a function of the state, which further terms fit, on held-out
    data too. A round trip measures it: rates by the equation along trials of an object are integrated and
    differentiated again. The coefficients, shape (terms,), should follow the rates but not their noise: those of least
    error on held-out data.

    Raises `CommonlawError` if a trial cannot be differentiated.
    """
    errors = [_round_trip(form, terms, trial, target, coefficients) for trial in trials]
    return float(np.mean(np.concatenate(errors) ** 2))


def _round_trip(form: StrongForm, terms: Terms, trial: Trial, target: int, coefficients: Floats) -> Floats:
    """Return what the rates of a trial change by when they are integrated and differentiated, shape (n,)."""
    from scipy.interpolate import CubicSpline

    whole, order = replace(form, trim=0), order_of_each(form.order, trial.states.shape[1])[target]
    values, _ = whole.samples(trial)
    rates = terms.evaluate(values) @ coefficients
    state = CubicSpline(trial.times, rates).antiderivative(order)(trial.times)
    # Constants and straight lines are lost on the way; the trial's own ends give them back
    measured = trial.states[:, target]
    missing = np.where(np.isnan(measured), values[:, target], measured) - state
    elapsed = (trial.times - trial.times[0]) / (trial.times[-1] - trial.times[0])
    state += missing[0] + (missing[-1] - missing[0]) * elapsed * (order > 1)
    again = form.differentiation.differentiate(trial.times, state[:, np.newaxis], order).derivatives[-1][:, 0]
    return np.asarray((again - rates)[form.trim : len(trial) - form.trim])
