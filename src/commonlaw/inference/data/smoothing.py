"""Smooth curves through the measurements of a trial, and candidate terms and rates of change on them."""

from collections.abc import Sequence

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation import RobustSpline
from commonlaw.errors import CommonlawError
from commonlaw.formulation import column_scales
from commonlaw.inference.data.noise import parabola
from commonlaw.inference.settings import MIN_SINGULAR_VALUE
from commonlaw.library import Order, Terms, Variables, order_of_each
from commonlaw.trials import Trial

Curve = tuple[Floats, Floats]
"""States and rates of a trial at its samples, shape (n, D), and their highest derivatives, shape (n, states)."""


def filled_curves(curves: Sequence[Curve], typical: Floats) -> list[Floats]:
    """Return smoothed states (and rates), shape (n, D), the typical ones, shape (D,), where a state has no curve."""
    return [np.where(np.isnan(states), typical, states) for states, _ in curves]


def typical_states(curves: Sequence[Sequence[Curve]]) -> Floats:
    """Return the mean of each state (and rate) over all objects' curves, shape (D,)."""
    return np.asarray(np.nanmean(np.concatenate([states for group in curves for states, _ in group]), axis=0))


def smooth_curves(trial: Trial, order: Order, unmeasured: Bools | None = None) -> Curve:
    """Return smoothed states and rates of a trial, shape (n, D), and the highest derivatives, shape (n, d).

    Those of a state that was not measured in it are NaN, and so are those of states of which at most a start is known.
    """
    columns, states = [], trial.states if unmeasured is None else np.where(unmeasured, np.nan, trial.states)
    for column, own in zip(states.T, order_of_each(order, states.shape[1]), strict=True):
        seen = np.isfinite(column)
        if not seen.any():
            columns.append([column] * (own + 1))
        elif seen.sum() >= 5:  # As a spline takes
            found = RobustSpline().differentiate(trial.times, column[:, np.newaxis], own)
            columns.append([each[:, 0] for each in (found.states, *found.derivatives)])
        elif seen.sum() > 1:
            curve = parabola(trial.times[seen], column[seen])
            columns.append([curve.deriv(k)(trial.times) for k in range(own + 1)])
        else:
            raise CommonlawError("one-value", where=trial.label)
    rates = [each[1] for each in columns if len(each) > 2]
    return np.stack([*(each[0] for each in columns), *rates], axis=1), np.stack([each[-1] for each in columns], axis=1)


def terms_and_rates(
    terms: Terms, curves: Sequence[tuple[Trial, Curve]], coefficients: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return terms, shape (n, terms), and the highest derivatives, shape (n, states), on the curves of some trials.

    Parameters inside terms have the values of their coefficients, shape (equations, terms). Samples of which no
    state was measured are left out: smoothed rates know nothing of the moments in which doses are given.

    Raises `CommonlawError` if a term is not finite there; the message names the trial.
    """
    blocks, rates = [], []
    for trial, curve in curves:
        values, own = values_and_rates(terms.variables, trial, curve)
        if coefficients is not None:
            values = terms.at(values, coefficients)
        block = terms.evaluate(values)
        terms.check_finite(block, values, trial.label)
        seen = np.isfinite(trial.states).any(axis=1)
        blocks.append(block[seen])
        rates.append(own[seen])
    return np.concatenate(blocks), np.concatenate(rates)


def values_and_rates(variables: Variables, trial: Trial, curve: Curve) -> tuple[Floats, Floats]:
    """Return the variables along a trial's curve, shape (n, variables), and the highest derivatives, (n, states)."""
    states, rates = curve[0], curve[1].copy()
    values = variables.natural(np.column_stack([states, trial.inputs, trial.times]))
    logarithmic = list(variables.logarithmic_columns)
    rates[:, logarithmic] *= values[:, logarithmic]
    return values, rates


def first_coefficients(terms: Terms, curves: Sequence[tuple[Trial, Curve]], known: Floats) -> Floats:
    """Return coefficients by least squares on each trial's smoothed states and rates, shape (equations, terms)."""
    found = np.nan_to_num(known)
    library, targets = terms_and_rates(terms, curves, found)
    for equation, free in enumerate(np.isnan(known)):
        columns = library[:, free]
        norms = column_scales(columns)
        rest = targets[:, equation] - library @ found[equation]
        found[equation, free] = np.linalg.lstsq(columns / norms, rest, rcond=MIN_SINGULAR_VALUE)[0] / norms
    return found
