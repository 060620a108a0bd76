"""The linearised likelihood beside normal densities and variational equations."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import commonlaw as cl
from benchmarks.variational import cramer_rao, solve
from commonlaw.library import with_rates
from commonlaw.likelihood import Estimate, LatentProcesses, ObservationModel, TrajectoryModel, fit, linearize, meshes
from commonlaw.likelihood.collocation import jacobians
from commonlaw.likelihood.fitting import eliminate_states
from tests.unit.trajectories import DIFFICULT, SUPPORT, difficult, information, of_prey, prey, terms_of, trial


@pytest.mark.parametrize(
    ("variables", "equations", "coefficients", "library", "start", "times", "noise"),
    [
        (
            ("x", "y", "z"),
            (("x", "y"), ("x", "y", "x z"), ("z", "x y")),
            [-10, 10, 28, -1, -1, -8 / 3, 1],
            "poly:2",
            [-8, 8, 27],
            np.linspace(0, 2, 401),
            [0.1, 0.2, 0.3],
        ),
        (("x", "v"), (("x", "v", "x^2 v"),), [-1.0, 1.2, -1.1], "poly:3", [1, 0], np.linspace(0, 9, 181), [0.05]),
        (
            ("x", "y", "v", "w"),
            (("x", "v"), ("y", "x y", "w")),
            [-1, -0.1, -2, 0.3, -0.2],
            "poly:2",
            [1, 0.5, 0, 0.3],
            np.linspace(0, 6, 121),
            [0.05, 0.02],
        ),
    ],
)
def test_the_information_is_that_of_fisher(variables, equations, coefficients, library, start, times, noise):
    order = len(variables) // len(equations)
    run = solve(variables, equations, np.array(coefficients, float), np.array(start, float), times)
    terms = terms_of(library, variables)
    values = np.zeros((len(equations), len(terms)))
    pairs = [(j, terms.index(term)) for j, equation in enumerate(equations) for term in equation]
    values[tuple(np.transpose(pairs))] = coefficients
    unit = np.tile(np.array(noise), order)
    model = TrajectoryModel(
        terms, meshes([trial(times, run.states[:, : len(noise)])]), ObservationModel(np.array(noise)), unit
    )
    found = information(model, Estimate((run.states,), values), values != 0, 1e-4)
    listed = [tuple(pair) for pair in np.argwhere(values)]
    errors = np.sqrt(np.diag(np.linalg.inv(found)))[[listed.index(pair) for pair in pairs]]
    np.testing.assert_allclose(errors, cramer_rao([run], np.array(noise)), rtol=2e-3)


@pytest.mark.parametrize("shift", [1e2, -1e4])
def test_terms_far_from_the_origin_leave_what_they_leave_at_the_origin(shift):
    times, generator = np.linspace(0, 3, 60), np.random.default_rng(0)
    heights = np.cos(2 * times) + 0.01 * generator.standard_normal(60)
    terms, left = terms_of("poly:2", ("x", "v")), []
    for origin in (0.0, shift):
        states = np.column_stack([np.cos(2 * times) + origin, -2 * np.sin(2 * times)])
        (mesh,) = meshes([trial(times, heights[:, np.newaxis] + origin)])
        model = TrajectoryModel(terms, (mesh,), ObservationModel(np.array([0.01])), np.array([0.01, 0.02]))
        factor = linearize(model, Estimate((states,), np.zeros((1, 6))), 0.003).problem.factor
        left.append([abs(np.linalg.qr(factor[:, [*kept, -1]], mode="r")[-1, -1]) for kept in ((0, 1, 2), range(6))])
    np.testing.assert_allclose(left[1], left[0], rtol=2e-3)


@pytest.mark.parametrize("uneven", [0.0, 0.5])
@pytest.mark.parametrize(("order", "library", "names"), DIFFICULT)
def test_squared_residuals_and_the_log_determinant_are_the_density_of_the_linearised_model(
    order, library, names, uneven
):
    field, mesh, states = difficult(order, library, names)
    mesh = replace(mesh, scale=1 + uneven * np.random.default_rng(1).uniform(-1, 1, mesh.measured.shape))
    coefficients, equations, width = field.coefficients, len(field.coefficients), field.width
    mesh.measured[2, 0] = np.nan
    noise = np.linspace(0.5, 0.8, equations)
    second = with_rates(order, equations)
    unit = np.concatenate([noise, 0.9 * noise[second]])
    huber_threshold, model_error, step = 2.0, 0.7, np.median(mesh.steps[mesh.contiguous])
    model = TrajectoryModel(field.terms, (mesh,), ObservationModel(noise, huber_threshold), unit)
    linearization = linearize(model, Estimate((states,), coefficients), model_error)

    # What was measured says where states are; what was not is somewhere within a hundred times that noise
    residuals = mesh.measured - states[:, :equations]
    each = noise * mesh.scale
    scaled = np.abs(residuals) / each
    vague, seen = 100**2 * np.mean(each**2, axis=0), np.isfinite(residuals)
    of_measured = np.where(seen, np.maximum(scaled / huber_threshold, 1) * each**2, vague)
    of_rates = np.tile((0.03 / step) ** 2 * vague[second], (len(mesh), 1))
    variances = np.hstack([of_measured, of_rates])
    deviations = np.hstack([np.nan_to_num(residuals), 0 * of_rates])
    linear = jacobians(replace(field, free=np.ones_like(coefficients, dtype=bool)), mesh, states)
    linked = np.flatnonzero(mesh.contiguous)
    matrix = np.zeros((len(linked), width, len(mesh), width))
    for row, i in enumerate(linked):
        matrix[row, :, i], matrix[row, :, i + 1] = linear.start[i], linear.end[i]
    matrix = matrix.reshape(len(linked) * width, -1)
    allowed = np.repeat((mesh.steps[linked] / step)[:, np.newaxis], width, 1) * (model_error * unit) ** 2
    covariance = matrix @ np.diag(variances.ravel()) @ matrix.T + np.diag(allowed.ravel())
    hidden = np.hstack([~seen, np.ones(of_rates.shape, dtype=bool)])
    unmeasured = np.sum(np.log(variances[linked + 1]), where=hidden[linked + 1])
    turned = sum(np.log(abs(np.linalg.det(linear.end[i]))) for i in linked)
    for seed in range(3):
        change = np.random.default_rng(seed).standard_normal(coefficients.shape)
        mean = (
            linear.defects[linked].ravel()
            + matrix @ deviations.ravel()
            + linear.coefficients[linked].reshape(len(covariance), -1) @ change.ravel()
        )
        density = multivariate_normal(mean, covariance).logpdf(np.zeros(len(mean)))
        # The density of defects becomes that of the states at the ends of their steps; that of unmeasured ones goes
        expected = -2 * (density + turned) - len(mean) * np.log(2 * np.pi) - unmeasured
        found = linearization.problem.rss((coefficients + change).ravel(), 0) + linearization.log_determinant
        assert found == pytest.approx(expected, rel=1e-8)


def test_the_linearization_about_the_best_fit_has_its_minimum_and_curvature_there():
    measured = prey()[1]
    model, start = of_prey(measured)
    found = fit(model, start, SUPPORT, (0.1,), 60)
    rows = linearize(model, found, 0.1).problem
    held = np.zeros(())
    for mesh, states in zip(model.meshes, found.states, strict=True):
        linear = jacobians(model.field(found.coefficients, SUPPORT), mesh, states)
        residuals = model.residuals(mesh, states)
        weights = model.observation.weights(residuals)
        held = (
            held + eliminate_states(linear, model.precision(mesh, 0.1), weights, residuals, model.observed).information
        )
    errors = np.sqrt(np.diag(np.linalg.inv(held)))
    again = rows.least_squares(SUPPORT.ravel(), 0).reshape(SUPPORT.shape)
    np.testing.assert_allclose((again - found.coefficients)[SUPPORT] / errors, 0, atol=0.05)
    np.testing.assert_allclose(information(model, found, SUPPORT, 0.1), held, rtol=1e-6)


def autocorrelated(order, white, correlated, points):
    """Return the linearization of exact samples of x' = a x or x'' = a x under AR(1) errors, by nodes between them."""
    times, rate = np.linspace(0, 4, 40), -0.7 if order == 1 else -4.0
    law = cl.Law.from_text("x' = a x" if order == 1 else "x'' = a x", {"a": rate})

    def states(grid):
        if order == 1:
            return 4 * np.exp(rate * grid)[:, np.newaxis]
        return 4 * np.column_stack([np.cos(2 * grid), -2 * np.sin(2 * grid)])

    grid = meshes(list(cl.Trials.from_arrays(times, states(times)[:, :1], names=["x"])), points)
    unit = np.array([white, white / times[1]])[:order]
    latent = LatentProcesses(np.array([correlated]), 0.5)
    model = TrajectoryModel(law.terms, grid, ObservationModel(np.array([white])), unit, latent)
    nodes = tuple(np.column_stack([states(mesh.times), 0 * mesh.times]) for mesh in grid)
    return linearize(model, Estimate(nodes, np.array([[rate]])), 1e-5)


def by_generalized_least_squares(order, white, correlated):
    """Return the same from a dense covariance: the standard error of a, and the deviance with starts integrated out."""
    t = np.linspace(0, 4, 40)
    starts, slope = np.exp(-0.7 * t)[:, np.newaxis], 4 * t * np.exp(-0.7 * t)
    if order == 2:
        starts, slope = np.column_stack([np.cos(2 * t), np.sin(2 * t) / 2]), t * np.sin(2 * t)
    covariance = white**2 * np.eye(40) + correlated**2 * np.exp(-np.abs(t - t[:, np.newaxis]) / 0.5)
    columns = np.column_stack([slope, starts])
    information = columns.T @ np.linalg.solve(covariance, columns)
    deviance = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information[1:, 1:])[1]
    return np.sqrt(np.linalg.inv(information)[0, 0]), deviance


@pytest.mark.parametrize("points", [1, 2, 4])
@pytest.mark.parametrize("white", [0.03, 0.001])
@pytest.mark.parametrize("order", [1, 2])
def test_nodes_between_samples_leave_errors_and_evidence_of_autocorrelated_noise(order, white, points):
    inside = [autocorrelated(order, white, level, points) for level in (0.1, 0.3)]
    exact = [by_generalized_least_squares(order, white, level) for level in (0.1, 0.3)]
    errors = [1 / abs(linear.problem.factor[0, 0]) for linear in inside]
    assert errors == pytest.approx([error for error, _ in exact], rel=2e-3)
    change = inside[1].log_determinant - inside[0].log_determinant
    # The prior of initial rates is in units of all errors
    prior = np.log((white**2 + 0.3**2) / (white**2 + 0.1**2)) if order == 2 else 0.0
    assert change == pytest.approx(exact[1][1] - exact[0][1] + prior, abs=0.02)
