"""What errors of estimated levels mean for estimates: against dense covariances, and coverage of intervals."""

import numpy as np
import pytest
from scipy import optimize, stats

import commonlaw as cl
from commonlaw.law.parameters import named_parameters
from commonlaw.likelihood import ERRORS
from commonlaw.likelihood.errors import Scales
from commonlaw.likelihood.levels import Deviations, LinearizedFit, errors_of_levels
from tests.unit.estimates import relaxation

K = 0.5
"""The known rate of a relaxation ``x' = a - k x``, whose solutions are linear in their start and in a."""
SCALES = Scales(np.array([10.0]), np.array([0.0]), 0.1, 6.0, 1e-4, 0.0)


def correlated(times, level, memory):
    return level**2 * np.exp(-np.abs(times[:, np.newaxis] - times) / memory)


def line(random, times, errors):
    """A fit of a line to a trial with errors of this covariance, and its residuals and design."""
    design = np.column_stack([np.ones_like(times), times])
    measured = design @ [1.0, 2.0] + random.multivariate_normal(np.zeros(len(times)), errors)
    trial = cl.Trials.from_arrays([times], [measured], names=["x"])[0]
    values = design @ np.linalg.solve(design.T @ design, design.T @ measured)
    shape = (len(times), 1)
    parts = values.reshape(shape), design.reshape(*shape, 2), values.reshape(shape), np.zeros(shape, dtype=np.bool_)
    return LinearizedFit([Deviations(trial, *parts)], (np.zeros(0), np.zeros((0, 2)))), measured - values, design


def test_under_white_noise_there_are_n_minus_p_degrees_of_freedom_and_nothing_is_added():
    times = np.linspace(0, 3, 12)
    fit, residuals, _ = line(np.random.default_rng(0), times, 0.1**2 * np.eye(12))
    noise = np.sqrt(residuals @ residuals / 10)
    of_levels = errors_of_levels(ERRORS["white"], [fit], np.array([noise]), np.array([False]), np.array([1e-6]), SCALES)
    assert of_levels.degrees_of_freedom == pytest.approx(10, rel=0.01)
    assert np.abs(of_levels.added[0]).max() < 1e-20


def test_added_covariance_and_degrees_of_freedom_are_those_of_dense_covariances():
    times, step = np.linspace(0, 6, 60), 0.05
    fit, residuals, design = line(np.random.default_rng(1), times, 0.1**2 * np.eye(60) + correlated(times, 0.3, 0.8))

    def at(logs):
        """Minus twice the restricted log-likelihood, moves of estimates, and logarithms of their variances."""
        noise, level, memory = np.exp(logs)
        covariance = noise**2 * np.eye(60) + correlated(times, level, memory)
        weighted = np.linalg.solve(covariance, design)
        information, target = design.T @ weighted, weighted.T @ residuals
        moved = np.linalg.solve(information, target)
        squares = residuals @ np.linalg.solve(covariance, residuals) - target @ moved
        determinants = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1]
        return squares + determinants, moved, np.log(np.diagonal(np.linalg.inv(information)))

    logs, moves = optimize.minimize(lambda logs: at(logs)[0], np.log([0.1, 0.3, 0.8])).x, step * np.eye(3)
    pairs = [[at(logs + a + b)[0] + at(logs - a - b)[0] for a in moves] for b in moves]
    apart = [[at(logs + a - b)[0] + at(logs - a + b)[0] for a in moves] for b in moves]
    hessian = (np.array(pairs) - np.array(apart)) / (4 * step**2)
    # Noise between its floor and the state, the level between a share of the state and it, the time of a trial
    widths = np.log([10.0 / 1e-3, 1 / SCALES.least, 3 * 6.0 / 0.1])
    scatter = np.linalg.inv(hessian / 2 + np.diag(12 / widths**2))
    assert np.linalg.eigvalsh(hessian)[0] > 0
    changes = [np.subtract(at(logs + move)[1:], at(logs - move)[1:]) / (2 * step) for move in moves]
    slopes, of_variances = np.moveaxis(np.array(changes), 1, 0)
    found = errors_of_levels(ERRORS["autocorrelated"], [fit], np.exp(logs), np.array([False]), np.array([1e-3]), SCALES)
    assert found.added[0] == pytest.approx(slopes.T @ scatter @ slopes, rel=1e-4)
    mean = np.mean(np.einsum("ik,ij,jk->k", of_variances, scatter, of_variances))
    assert found.degrees_of_freedom == pytest.approx(2 / mean, rel=1e-4)


@pytest.mark.parametrize("scheme", ["collocation", "shooting"])
def test_intervals_are_those_of_student_with_few_degrees_of_freedom(scheme):
    random, times = np.random.default_rng(4), np.linspace(0, 6, 40)
    starts = np.array([[8.0], [5.0]])
    errors = random.multivariate_normal(np.zeros(40), correlated(times, 0.3, 0.7), 2)
    measured = 2 + (starts - 2) * np.exp(-K * times) + errors
    law = cl.fit(
        f"x' = a - {K} x",
        cl.Trials.from_arrays([times] * 2, [*measured], names=["x"]),
        errors="autocorrelated",
        scheme=scheme,
    )
    (degrees,) = law.uncertainty.degrees_of_freedom
    assert 3 < degrees < 30
    model, row = law.uncertainty.error_model, law.params.iloc[0]
    dense = correlated(times, model.correlated[0], model.memory) + law.uncertainty.noise[0] ** 2 * np.eye(40)
    _, estimate, error = relaxation(measured, times, K, dense)
    assert error < row["standard error"] < 1.2 * error
    reach = stats.t.ppf(0.975, degrees) * row["standard error"]
    assert [row.low, row.high] == pytest.approx([estimate - reach, estimate + reach], rel=1e-3)


@pytest.mark.slow
def test_intervals_of_a_spring_under_autocorrelated_errors_hold_the_truth():
    times, hits = np.linspace(0, 9, 60), list[bool]()
    clean = np.exp(-0.05 * times) * np.cos(np.sqrt(2 - 0.05**2) * times)
    for seed in range(40):
        random = np.random.default_rng(seed)
        made = clean + random.multivariate_normal(np.zeros(60), correlated(times, 0.03, 0.7), 2)
        trials = cl.Trials.from_arrays([times] * 2, [*made], names=["x"])
        named = named_parameters(cl.fit("x'' = -k x - c v", trials, errors="autocorrelated"))
        low, high = named.intervals()
        hits += [bool(a < true < b) for a, true, b in zip(low[0], (2.0, 0.1), high[0], strict=True)]
    assert 0.9 <= np.mean(hits) <= 0.99
