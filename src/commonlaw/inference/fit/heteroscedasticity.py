"""Noise that grows with the states, as differences of neighbouring samples show it before any law is known.

A search under noise of one level takes what large states scatter by for what a law leaves, and what small ones say for
little. Where differences show growth, a search begins with it.
"""

from collections.abc import Iterator

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import differences, noise_correlation, noise_order, without_outliers
from commonlaw.inference.data.noise import noise_floor
from commonlaw.inference.fit.parameter_grid import powers_of_ten
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.settings import MAX_DECADES, MIN_SAMPLES, MIN_SAMPLES_OF_MANY, PER_DECADE
from commonlaw.likelihood import ErrorModel


def growth(squared: Floats, sizes: Floats) -> tuple[float, Floats]:
    """Return what noise that grows with a state gains in twice the log-likelihood, its level being free in both.

    And the standard deviations of the part that is constant, and of that in proportion, as a share.

    Parameters
    ----------
    squared
        Residuals, shape (n,).
    sizes
        Of the state at these.
    """
    typical = max(np.sqrt(np.mean(sizes**2)), np.finfo(float).tiny)
    shares = powers_of_ten(PER_DECADE[1], 2 * MAX_DECADES)
    variances = 1 + (shares[:, np.newaxis] * sizes / typical) ** 2
    levels = np.mean(squared / variances, axis=1)
    if not (levels > 0).all():
        return 0.0, np.zeros(2)
    values = len(squared) * np.log(levels) + np.sum(np.log(variances), axis=1)
    best = int(np.argmin(values))
    gain = float(len(squared) * np.log(squared.mean()) - values[best])
    return gain, np.sqrt(levels[best]) * np.array([1.0, shares[best] / typical])


def with_growing_noise(problem: SearchProblem) -> SearchProblem:
    """Return the problem with noise in proportion to the states whose differences show it, and as it was otherwise.

    It shows where it gains more in likelihood than its number costs, neighbouring differences being alike.
    """
    schema, floor = problem.trials.schema, noise_floor(problem.trials)
    noise, shares = problem.noise.copy(), np.zeros(len(problem.noise))
    if problem.noise_given:
        return problem
    for j, name in enumerate(schema.states):
        columns = list(_columns(problem, j)) if name not in schema.starts else []
        orders = [noise_order(times, values) for times, values, _ in columns]
        if not orders or None in orders:
            continue
        order = max(each for each in orders if each)
        squared, sizes = (
            np.concatenate(own) for own in zip(*(_differences(*each, order) for each in columns), strict=True)
        )
        if np.sqrt(np.mean(squared)) <= 1.001 * floor[j]:  # Below, what is left is not of the measurements
            continue
        gain, (constant, share) = growth(squared, sizes)
        if gain > noise_correlation(order) * np.log(sum(problem.measured)):
            noise[j], shares[j] = max(constant, floor[j]), share
    errors = ErrorModel({"proportional": shares})
    return problem.with_errors(noise, errors, "by differences of neighbouring samples") if shares.any() else problem


def _columns(problem: SearchProblem, j: int) -> Iterator[tuple[Floats, Floats, Floats]]:
    """Yield times, values and smoothed values of a state, of each trial that tells its noise."""
    for name, curves in zip(problem.trials.objects, problem.smoothed, strict=True):
        for trial, smooth in zip(problem.trials.of_object(name), curves, strict=True):
            seen = np.isfinite(trial.states[:, j])
            values = trial.states[seen, j]
            if len(values) >= MIN_SAMPLES and np.ptp(values) > 0:
                yield trial.times[seen], values, smooth[seen, j]


def _differences(times: Floats, values: Floats, smooth: Floats, order: int) -> tuple[Floats, Floats]:
    """Return squared differences, without outliers among those at states as large, and the sizes of the state there."""
    *_, found = differences(times, values[:, np.newaxis], order)
    own, sizes = found[:, 0], np.convolve(np.abs(smooth), np.full(order + 1, 1 / (order + 1)), "valid")
    typical = np.ones(len(own))
    for near in np.array_split(np.argsort(sizes, kind="stable"), max(len(own) // MIN_SAMPLES_OF_MANY, 1)):
        typical[near] = np.median(np.abs(own[near])) or np.mean(np.abs(own[near])) or 1.0
    kept = without_outliers(own / typical, order)
    return own[kept] ** 2, sizes[kept]
