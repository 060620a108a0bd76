"""Errors with a memory and smooth forces, beside dense normal distributions with their covariance functions."""

from itertools import pairwise
from typing import get_args

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from commonlaw.likelihood import (
    ERRORS,
    Estimate,
    LatentProcesses,
    ObservationModel,
    Scales,
    TrajectoryModel,
    fit,
    linearize,
    meshes,
)
from commonlaw.runtime.fit_options import ErrorKind, FitOptions, settings_of
from tests.unit.trajectories import information, terms_of, trial

TIMES = np.array([0.0, 0.4, 0.7, 1.5, 1.9, 2.2, 3.0, 3.1])
KINDS = {
    "correlated": LatentProcesses(correlated=np.array([0.3]), memory=0.8),
    "sensor-walk": LatentProcesses(correlated=np.array([0.3])),
    "force": LatentProcesses(force=np.array([0.5]), force_time=1.3),
    "both": LatentProcesses(np.array([0.3]), 0.8, np.array([0.5]), 1.3),
    "drift": LatentProcesses(offset=np.array([0.3]), slope=np.array([0.7])),
    "drift about a mean": LatentProcesses(offset=np.array([0.3]), slope=np.array([0.7]), trend=np.array([0.4])),
}


def problem(order, latent, second=True):
    """An oscillator or a decay, measured in two trials with a gap; a model of it, and an estimate near by."""
    variables = ("x", "v")[:order]
    terms = terms_of(f"terms:{','.join(variables)}", variables)
    generator = np.random.default_rng(3)
    trials = [trial(TIMES, np.cos(TIMES)[:, np.newaxis] + 0.1 * generator.standard_normal((len(TIMES), 1)))]
    if second:
        trials.append(trial(TIMES[:5], np.sin(TIMES[:5, np.newaxis])))
    trials[0].states.flags.writeable = True
    trials[0].states[3] = np.nan
    scale = np.linspace(0.7, 1.3, sum(map(len, trials)))[:, np.newaxis]
    (mesh,) = meshes(trials)
    mesh = type(mesh)(mesh.times, mesh.measured, mesh.inputs, mesh.contiguous, scale)
    unit = np.array([0.1, 0.12])[:order]
    model = TrajectoryModel(terms, (mesh,), ObservationModel(np.array([0.1])), unit, latent)
    states = 0.2 * generator.standard_normal((len(mesh), order + latent.width)) + 0.5
    return model, Estimate((states,), np.array([[-0.9, -0.2][:order]]))


def covariance_functions(latent, times):
    """The covariance of errors, of forces and their rates, or of a drift and its slope, at all points of one trial."""
    lag = times[:, np.newaxis] - times
    blocks = []
    if latent.drift is not None:
        shapes = np.column_stack([np.append(np.ones(len(times)), 0), np.append(times - times[0], 1)])
        blocks.append(shapes * latent.drift**2 @ shapes.T)
    if latent.correlated is not None:
        kernel = np.exp(-np.abs(lag) / latent.memory)
        if np.isinf(latent.memory):
            kernel = np.minimum.outer(times - times[0], times - times[0])
        blocks.append(latent.correlated[0] ** 2 * kernel)
    if latent.force is not None:
        rate = np.sqrt(3) / latent.force_time
        decay = latent.force[0] ** 2 * np.exp(-rate * np.abs(lag))
        rates = decay * rate**2 * (1 - rate * np.abs(lag))
        blocks.append(
            np.block([[decay * (1 + rate * np.abs(lag)), decay * rate**2 * lag], [-decay * rate**2 * lag, rates]])
        )
    size = sum(map(len, blocks))
    found, at = np.zeros((size, size)), 0
    for block in blocks:
        found[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return found


def dense_value(model, estimate, model_error):
    """Minus twice the log-density of all that is measured after each first sample; the share of what hardly is."""
    (mesh,), (states,), order, latent = model.meshes, estimate.states, model.order, model.latent
    cuts = [0, *(np.flatnonzero(~mesh.contiguous) + 1), len(mesh)]
    coefficients, step = estimate.coefficients, np.median(mesh.steps[mesh.contiguous])
    matrix = np.array([[coefficients[0, 0]]]) if order == 1 else np.array([[0.0, 1.0], coefficients[0]])
    noise, value, hardly = 0.1 * mesh.scale[:, 0], 0.0, 0.0
    errors = 0.0 if latent.correlated is None else float(latent.correlated[0])
    hidden_std = errors  # At which latent processes are vague but at first points
    if latent.correlated is not None and np.isinf(latent.memory):
        errors, hidden_std = errors * np.sqrt(step), errors * np.sqrt(len(mesh) * step)
    typical = np.sqrt(np.mean(noise**2) + errors**2)
    # Of a state and a rate: the prior at first points, and what is vague under autocorrelated errors
    first_variances = np.array([(100 * typical) ** 2, (3 * typical / step) ** 2])
    state_variance, rate_variance = first_variances + (1000 * hidden_std / np.array([1.0, step])) ** 2
    for first, last in pairwise(cuts):
        times, count = mesh.times[first:last], last - first
        hidden = covariance_functions(latent, times)
        forces = np.zeros((count, len(hidden)))
        if latent.force is not None:
            at = count * (latent.correlated is not None)
            forces[:, at : at + count] = np.eye(count)
        # Every state is a linear function of the first one, the walk's steps and the hidden values: in that order
        size = order + (count - 1) * order + len(hidden)
        rows = np.zeros((count, order, size))
        rows[0, :, :order] = np.eye(order)
        shares = np.eye(order)[:, -1:]
        for i, h in enumerate(np.diff(times)):
            identity = np.eye(order)
            # Hermite-Simpson of z' = M z + B u, solved for the state at the end of the step
            before, after = (
                identity + s / 6 * (matrix + 4 * matrix @ (identity / 2 + s / 8 * matrix)) for s in (h, -h)
            )
            begins, ends = (h / 6 * (3 * shares + s / 2 * matrix @ shares) for s in (h, -h))
            by_force = np.zeros((order, size))
            by_force[:, size - len(hidden) :] = begins @ forces[i : i + 1] + ends @ forces[i + 1 : i + 2]
            by_force[:, order * (i + 1) : order * (i + 2)] += identity
            rows[i + 1] = np.linalg.solve(after, before @ rows[i] + by_force)
        walk = np.repeat(np.diff(times) / step, order) * np.tile((model_error * model.unit) ** 2, count - 1)
        prior = np.zeros((size, size))
        inner = range(order, order + len(walk))
        prior[inner, inner] = walk
        prior[size - len(hidden) :, size - len(hidden) :] = hidden
        error = np.zeros((count, size))
        of_rates = np.zeros((count, size))  # What is vague is so with the drift, which moves states and rates
        if latent.correlated is not None or latent.drift is not None:
            error[:, size - len(hidden) : size - len(hidden) + count] = np.eye(count)
        moved = np.zeros((count, 2))
        if latent.drift is not None:
            of_rates[:, -1] = 1
            moved = states[first:last, order:]
        # Samples, rates and hidden values: rows, values, variances, whether they are hardly known, and points
        measured = []
        for i in range(count):
            y = mesh.measured[first + i, 0]
            if np.isfinite(y):
                measured.append((rows[i, 0] + error[i], y, noise[first + i] ** 2, False, i))
            else:
                seen_with = rows[i, 0] + error[i] * (latent.drift is not None)
                measured.append((seen_with, states[first + i, 0] + moved[i, 0], state_variance, True, i))
            if order == 2:
                measured.append((rows[i, 1] + of_rates[i], states[first + i, 1] + moved[i, 1], rate_variance, True, i))
        for j in range(len(hidden)):
            if (
                j % count and latent.drift is None
            ):  # That of the first point has its stationary distribution, which no other row has
                std = hidden_std if j < count and latent.correlated is not None else np.sqrt(hidden[j, j])
                measured.append((np.eye(size)[size - len(hidden) + j], 0.0, (1000 * std) ** 2, True, j % count))
        seen_by, informed, spread, unmeasured, at_point = map(np.array, zip(*measured, strict=True))
        # The first state, given its own measurements: y0 less its error and noise, and the rate
        start = at_point == 0
        transform = np.eye(size)
        mean = np.zeros(size)
        mean[:order] = informed[start]
        if latent.trend is not None:
            mean[size - len(hidden) :] = latent.trend[0] * np.append(times - times[0], 1)
        prior[range(order), range(order)] = spread[start]
        if latent.correlated is not None and not unmeasured[0]:
            transform[0] -= error[0]
        if latent.drift is not None:
            transform[range(order)] -= np.array([error[0], of_rates[0]])[:order]
            mean = transform @ mean
        prior = transform @ prior @ transform.T
        later = ~start
        centre = seen_by[later] @ mean
        covariance = seen_by[later] @ prior @ seen_by[later].T + np.diag(spread[later])
        density = multivariate_normal(centre, covariance).logpdf(informed[later])
        value += -2 * density - later.sum() * np.log(2 * np.pi)
        hardly += np.sum(np.log(spread[later & unmeasured]))
        hardly += np.sum(np.log(spread[start] / first_variances[:order]), where=unmeasured[start])
    return value, hardly


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_the_marginal_likelihood_is_that_of_dense_covariance_functions(kind, order):
    model, estimate = problem(order, KINDS[kind])
    linearization = linearize(model, estimate, 0.3)
    found = linearization.problem.rss(estimate.coefficients.ravel(), 0) + linearization.log_determinant
    expected, vague = dense_value(model, estimate, 0.3)
    assert found + vague == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("kind", KINDS)
def test_the_fit_has_the_residuals_of_the_linearized_likelihood(kind, order):
    model, estimate = problem(order, KINDS[kind])
    support = np.ones_like(estimate.coefficients, dtype=bool)
    model, estimate = model.with_latent(KINDS[kind], estimate)
    found = fit(model, estimate, support, (0.3,), 60)
    rows = linearize(model, found, 0.3).problem
    errors = np.sqrt(np.diag(np.linalg.inv(information(model, found, support, 0.3))))
    again = rows.least_squares(support.ravel(), 0)
    np.testing.assert_allclose((again - found.coefficients.ravel()) / errors, 0, atol=0.05)


def test_every_kind_of_errors_has_a_class():
    assert tuple(ERRORS) == get_args(ErrorKind)
    _, about = settings_of(FitOptions)["errors"]
    assert about.choices.keys() == {"auto", *ERRORS}


@pytest.mark.parametrize("kind", ERRORS)
def test_levels_and_times_begin_between_their_bounds_and_make_errors_of_their_kind(kind):
    scales = Scales(np.array([2.0, 3.0]), np.array([1.0, 5.0]), 0.1, 8.0, 1e-4, 0.03, trials=2)
    low, high = ERRORS[kind].bounds(scales)
    assert np.all(low < high)
    starts = ERRORS[kind].starts(np.log([0.1, 0.2]), np.log(low), np.log(high))
    assert all(start.shape == low.shape for start in starts)
    assert ERRORS[kind].model(high).kind == ("white" if kind in ("random-walk", "by-object", "by-trial") else kind)
