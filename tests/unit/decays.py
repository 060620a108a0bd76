"""Samples of decays, and least squares of their solutions in closed form."""

from functools import partial

import numpy as np
import pytest
from scipy.optimize import least_squares

import commonlaw as cl

least = partial(least_squares, xtol=1e-15, ftol=1e-15, gtol=1e-15)


def errors_of(fit):
    """Return the standard errors of least squares of residuals over their noise."""
    return np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))


def fitted(model, start, data):
    """Return estimates and standard errors of least squares, from the true values."""
    found = least_squares(lambda p: model(p) - data, start, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    variance = 2 * found.cost / (len(data) - len(start))
    return found.x, np.sqrt(variance * np.diagonal(np.linalg.inv(found.jac.T @ found.jac)))


def trials_of(samples, names=("y",), **schema):
    """Return trials of objects by name, each of times and values."""
    made = [cl.Trial(name, "1", t, np.asarray(y)) for name, (t, y) in samples.items()]
    return cl.Trials(tuple(made), cl.Schema(tuple(names), **schema))


def estimates(law, name=None):
    frame = law.params
    frame = frame if name is None else frame[frame["object"] == name]
    return {row["parameter"]: (row["estimate"], row["standard error"]) for _, row in frame.iterrows()}


def assert_least_squares(law, expected, residuals, **tolerances):
    """Compare a law with least squares of residuals of parameters in the order of a dictionary of guesses."""
    found = least(residuals, list(expected.values()), method="lm")
    errors = errors_of(found) * np.sqrt(2 * found.cost / (len(found.fun) - len(found.x)))
    known = estimates(law)
    for name, value, error in zip(expected, found.x, errors, strict=True):
        if name in known:
            assert known[name][0] == pytest.approx(value, rel=1e-5)
            assert known[name][1] == pytest.approx(error, rel=tolerances.get("errors", 1e-2))


T = np.linspace(0, 6, 31)
SIGNAL, OTHER = (
    2.0 * np.exp(-0.6 * T) * (1 + np.exp(-0.6 * T)) + 0.3 + 0.01 * np.random.default_rng(1).standard_normal((2, len(T)))
)


def own_and_shared():
    source = np.random.default_rng(5)
    return {
        name: (T, 2 * np.exp(-k * T) + 1.0 + 0.05 * source.standard_normal(len(T)))
        for name, k in {"A": 0.4, "B": 0.8, "C": 1.2}.items()
    }


def by_trial(seed, rates=(0.4, 0.8, 1.2), **columns):
    """Return trials of two objects with these rates in each, a common factor of 2, and inputs by trial."""
    source, trials = np.random.default_rng(seed), []
    for owner, offset in {"A": 1.0, "B": 0.5}.items():
        for i, k in enumerate(rates):
            y = 2 * np.exp(-k * T) + offset + 0.05 * source.standard_normal(len(T))
            inputs = (
                np.tile([column[i] for column in columns.values()], (len(T), 1)) if columns else np.empty((len(T), 0))
            )
            trials.append(cl.Trial(owner, str(i), T, y[:, None], inputs))
    return cl.Trials(tuple(trials), cl.Schema(("y",), tuple(columns)))
