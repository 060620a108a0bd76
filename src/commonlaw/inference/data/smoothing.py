"""Smoothing of trials, and gradient matching: regression of smoothed derivatives on terms of smoothed states.

Two-stage estimates of this kind (Varah 1982, SIAM J. Sci. Stat. Comput. 3) are the initial guesses of all fits.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation import RobustSpline
from commonlaw.differentiation.noise import within_trial_std
from commonlaw.errors import CommonlawError
from commonlaw.formulation import column_scales
from commonlaw.inference.data.noise import parabola
from commonlaw.inference.settings import MIN_SINGULAR_VALUE, MIN_SMOOTHED
from commonlaw.library import Order, Terms, Variables, order_of_each
from commonlaw.trials import Trial

Curve = tuple[Floats, Floats]
"""States and rates of a trial at its samples, shape (n, D), and their highest derivatives, shape (n, states)."""


def filled_curves(curves: Sequence[Curve], typical: Floats) -> list[Floats]:
    """Return smoothed states (and rates), shape (n, D), `typical` ones, shape (D,), where there is no curve."""
    return [np.where(np.isnan(states), typical, states) for states, _ in curves]


def typical_states(curves: Sequence[Sequence[Curve]]) -> Floats:
    """Return the mean of each state (and rate) over the curves of all objects, shape (D,)."""
    return np.asarray(np.nanmean(np.concatenate([states for group in curves for states, _ in group]), axis=0))


def smooth_curves(trial: Trial, order: Order, latent: Bools | None = None) -> Curve:
    """Return smoothed states and rates of a trial, shape (n, D), and the highest derivatives, shape (n, d).

    They come from a robust smoothing spline, or from a parabola if there are fewer than five samples. Those of
    unmeasured states are NaN.
    """
    columns, states = [], trial.states if latent is None else np.where(latent, np.nan, trial.states)
    for column, degree in zip(states.T, order_of_each(order, states.shape[1]), strict=True):
        seen = np.isfinite(column)
        if not seen.any():
            columns.append([column] * (degree + 1))
        elif seen.sum() >= MIN_SMOOTHED:
            spline = RobustSpline().differentiate(trial.times, column[:, np.newaxis], degree)
            columns.append([values[:, 0] for values in (spline.states, *spline.derivatives)])
        elif seen.sum() > 1:
            curve = parabola(trial.times[seen], column[seen])
            columns.append([curve.deriv(k)(trial.times) for k in range(degree + 1)])
        else:
            raise CommonlawError("one-value", where=trial.label)
    rates = [column[1] for column in columns if len(column) > 2]
    return np.stack([*(column[0] for column in columns), *rates], axis=1), np.stack(
        [column[-1] for column in columns], axis=1
    )


def terms_and_rates(
    terms: Terms, curves: Sequence[tuple[Trial, Curve]], coefficients: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return terms, shape (n, terms), and the highest derivatives, shape (n, states), on the curves of some trials.

    Nonlinear parameters have the values of their coefficients, shape (equations, terms). Samples without any measured
    state, such as those of doses, are omitted.

    Raises `CommonlawError` if a term is not finite there; the message names the trial.
    """
    blocks, rates = [], []
    for trial, curve in curves:
        values, derivatives = values_and_rates(terms.variables, trial, curve)
        if coefficients is not None:
            values = terms.at(values, coefficients)
        block = terms.evaluate(values)
        terms.check_finite(block, values, trial.label)
        seen = np.isfinite(trial.states).any(axis=1)
        blocks.append(block[seen])
        rates.append(derivatives[seen])
    return np.concatenate(blocks), np.concatenate(rates)


def values_and_rates(variables: Variables, trial: Trial, curve: Curve) -> tuple[Floats, Floats]:
    """Return the variables along the curve of a trial, (n, variables), and the highest derivatives, (n, states)."""
    states, rates = curve[0], curve[1].copy()
    values = variables.natural(np.column_stack([states, trial.inputs, trial.times]))
    logarithmic = list(variables.logarithmic_columns)
    rates[:, logarithmic] *= values[:, logarithmic]
    return values, rates


def gradient_matching(terms: Terms, curves: Sequence[tuple[Trial, Curve]], known: Floats) -> Floats:
    """Return least-squares coefficients of smoothed derivatives on terms of smoothed states, shape (equations, terms).

    Known coefficients, not NaN, are fixed. Of states on a logarithmic scale the rates of the logarithms are matched.
    """
    theta = np.nan_to_num(known)
    library, targets = terms_and_rates(terms, curves, theta)
    for equation, free in enumerate(np.isnan(known)):
        weights = np.ones(len(targets))
        if equation in terms.variables.logarithmic_columns:
            seen = (states[np.isfinite(trial.states).any(axis=1), equation] for trial, (states, _) in curves)
            weights = np.exp(-np.concatenate([*seen]))
        columns = library[:, free] * weights[:, np.newaxis]
        norms = column_scales(columns)
        residuals = weights * (targets[:, equation] - library @ theta[equation])
        theta[equation, free] = np.linalg.lstsq(columns / norms, residuals, rcond=MIN_SINGULAR_VALUE)[0] / norms
    return theta


def start_variances(trials: Iterable[Trial], smoothed: Sequence[Floats]) -> Floats:
    """Return the prior variances of initial states and rates, shape (D,), by the measurements.

    Those of states are their within-trial variances. Those of rates are the mean squares of smoothed rates of all
    trials, shape (n, D) each with the states, or at their starts if that is larger, as of decays.
    """
    variances = within_trial_std(trials) ** 2
    rates = [curve[:, len(variances) :] for curve in smoothed]
    at_starts = np.array([of_trial[0] for of_trial in rates])
    of_rates = np.fmax(np.nanmean(np.concatenate(rates) ** 2, axis=0), np.nanmean(at_starts**2, axis=0))
    return np.concatenate([variances, of_rates])
