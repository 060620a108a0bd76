"""What measurements are worth, and the elimination of states, beside dense algebra."""

import numpy as np
import pytest

from commonlaw.likelihood import Estimate, NotPositiveError, ObservationModel, TrajectoryModel, fit, linearize
from commonlaw.likelihood.collocation import jacobians
from commonlaw.likelihood.fitting import eliminate_states
from tests.unit.trajectories import DIFFICULT, difficult


def test_the_deviance_is_the_sum_of_squares_and_beyond_the_threshold_that_of_huber():
    residuals, noise = np.array([[0.1, np.nan], [-0.2, 1.0], [3.0, -8.0]]), np.array([0.1, 2.0])
    sizes = np.array([1.0, 2.0, 30.0, 0.5, 4.0])
    assert ObservationModel(noise).deviance(residuals) == pytest.approx(np.sum(sizes**2))
    expected = sum(s**2 if s <= 3 else 2 * 3 * s - 3**2 for s in sizes)
    assert ObservationModel(noise, 3.0).deviance(residuals) == pytest.approx(expected)
    np.testing.assert_allclose(
        ObservationModel(noise, 3.0).weights(residuals), np.array([[1, 0], [1, 1], [0.1, 0.75]]) / noise**2
    )


def dense(field, mesh, states, precision, weights, residuals):
    """The Jacobian and the residuals of the whole least-squares problem; states first, then coefficients."""
    linear, free = jacobians(field, mesh, states), field.free
    n, width, measured = len(mesh), field.width, len(field.coefficients)
    rows = (n - 1) * width
    of_measurements = np.zeros((n, measured, n, width))
    for i in range(n):
        of_measurements[i, range(measured), i, range(measured)] = -np.sqrt(weights[i])
    of_defects = np.zeros((n - 1, width, n, width))
    for i in range(n - 1):
        of_defects[i, :, i], of_defects[i, :, i + 1] = linear.start[i], linear.end[i]
    root = np.sqrt(precision).ravel()[:, np.newaxis]
    jacobian = np.block(
        [
            [of_measurements.reshape(n * measured, -1), np.zeros((n * measured, int(free.sum())))],
            [root * of_defects.reshape(rows, -1), root * linear.coefficients.reshape(rows, -1)],
        ]
    )
    of_samples = np.nan_to_num(residuals) * np.sqrt(weights)
    both = np.concatenate([of_samples.ravel(), root[:, 0] * linear.defects.ravel()])
    return linear, jacobian, both


@pytest.mark.parametrize(("order", "library", "names"), DIFFICULT)
def test_the_states_are_eliminated_as_in_dense_algebra(order, library, names):
    field, mesh, states = difficult(order, library, names)
    generator = np.random.default_rng(9)
    residuals = mesh.measured - states[:, : len(field.coefficients)]
    residuals[2, 0] = np.nan
    weights = np.where(np.isnan(residuals), 0.0, generator.uniform(0.5, 2, residuals.shape))
    precision = generator.uniform(1, 5, (len(mesh) - 1, field.width)) * mesh.contiguous[:, np.newaxis]
    linear, jacobian, both = dense(field, mesh, states, precision, weights, residuals)
    reduced = eliminate_states(linear, precision, weights, residuals, np.eye(weights.shape[1], field.width))
    size = states.size
    matrix, right = jacobian.T @ jacobian, jacobian.T @ both
    follow = -np.linalg.solve(matrix[:size, :size], matrix[:size, size:])
    schur = matrix[size:, size:] + matrix[size:, :size] @ follow
    scale = np.abs(schur).max()
    np.testing.assert_allclose(reduced.information, schur, atol=1e-9 * scale)
    np.testing.assert_allclose(reduced.state_sensitivity.reshape(size, -1), follow, atol=1e-7 * np.abs(follow).max())
    covariance = np.linalg.inv(matrix[:size, :size])
    variances, last = reduced.state_covariances()
    np.testing.assert_allclose(variances.ravel(), np.diagonal(covariance), rtol=1e-7)
    np.testing.assert_allclose(last, covariance[-field.width :, -field.width :], atol=1e-7 * np.abs(last).max())
    gradient = right[size:] + follow.T @ right[:size]
    np.testing.assert_allclose(reduced.gradient, gradient, atol=1e-9 * np.abs(gradient).max())
    step = np.linalg.lstsq(matrix, -right, rcond=None)[0]
    # Whatever step the coefficients take, the states follow to where their gradient vanishes
    moved = (reduced.state_step + reduced.state_sensitivity @ step[size:]).ravel()
    np.testing.assert_allclose(moved, step[:size], atol=1e-6 * np.abs(step).max())


def test_numbers_that_are_not_finite_are_refused():
    field, mesh, states = difficult(*DIFFICULT[0])
    states[1, 0] = np.inf
    model = TrajectoryModel(field.terms, (mesh,), ObservationModel(np.ones(2)), np.ones(2))
    estimate = Estimate((states,), field.coefficients)
    with pytest.raises(NotPositiveError), np.errstate(all="ignore"):
        linearize(model, estimate, 0.1)
    assert fit(model, estimate, field.free, (0.1,)).objective == np.inf
