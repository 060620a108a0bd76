"""Compressed least-squares problems equal those of all rows, also by normal equations."""

import numpy as np
import pytest

from commonlaw.formulation import LeastSquaresProblem, column_scales, explained, least_squares_of_each
from commonlaw.likelihood import Estimate, NotPositiveError, ObservationModel, TrajectoryModel, fit, linearize
from commonlaw.likelihood.collocation import jacobians
from commonlaw.likelihood.fitting import eliminate_states
from tests.refusals import refused
from tests.unit.trajectories import DIFFICULT, difficult


@pytest.fixture
def rows():
    generator = np.random.default_rng(0)
    x = generator.uniform(0.5, 2, (200, 2))
    library = np.column_stack([np.ones(200), x, x[:, 0] * x[:, 1], x**2])
    return library, generator.standard_normal((200, 2))


@pytest.mark.parametrize("support", [[0, 1, 2, 3, 4, 5], [1, 4], [3]])
def test_least_squares_on_a_system_equals_least_squares_on_all_rows(rows, support):
    library, targets = rows
    chosen = np.isin(np.arange(6), support)
    problem = LeastSquaresProblem.of(library, targets)
    for target in range(2):
        expected = np.linalg.lstsq(library[:, support], targets[:, target], rcond=None)[0]
        np.testing.assert_allclose(problem.least_squares(chosen, target)[support], expected, rtol=1e-10)
        assert not problem.least_squares(chosen, target)[~chosen].any()


def test_merged_systems_equal_the_system_of_all_rows(rows):
    library, targets = rows
    parts = [LeastSquaresProblem.of(library[i : i + 50], targets[i : i + 50]) for i in range(0, 200, 50)]
    merged, whole = parts[0] + (parts[1] + parts[2]) + parts[3], LeastSquaresProblem.of(library, targets)
    everything = np.ones(6, dtype=bool)
    assert merged.rows == 200
    np.testing.assert_allclose(merged.least_squares(everything, 1), whole.least_squares(everything, 1), rtol=1e-10)
    np.testing.assert_allclose(merged.norms, np.linalg.norm(library, axis=0), rtol=1e-12)


def test_residual_and_subtraction_agree_with_the_rows(rows):
    library, targets = rows
    problem, coefficients = LeastSquaresProblem.of(library, targets), np.arange(12.0).reshape(2, 6)
    left = targets - library @ coefficients.T
    np.testing.assert_allclose(
        [problem.rss(coefficient, j) for j, coefficient in enumerate(coefficients)], np.sum(left**2, axis=0), rtol=1e-10
    )
    everything = np.ones(6, dtype=bool)
    np.testing.assert_allclose(
        problem.subtract(coefficients).least_squares(everything, 0),
        np.linalg.lstsq(library, left[:, 0], rcond=None)[0],
        rtol=1e-9,
    )


def test_ridge_solves_the_penalised_normal_equations(rows):
    library, targets = rows
    expected = np.linalg.solve(library.T @ library + 3.0 * np.eye(6), library.T @ targets[:, 0])
    found = LeastSquaresProblem.of(library, targets).least_squares(np.ones(6, dtype=bool), 0, ridge=3.0)
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_dependent_columns_give_the_fit_of_least_norm_and_a_large_condition(rows):
    library, targets = rows
    doubled = np.column_stack([library[:, 0], library[:, 0]])
    problem, both = LeastSquaresProblem.of(doubled, targets), np.array([True, True])
    first, second = problem.least_squares(both, 0)
    assert first == pytest.approx(second)
    assert first + second == pytest.approx(targets[:, 0].mean())
    assert problem.condition(both) > 1e12


def test_weights_count_rows_several_times(rows):
    library, targets = rows
    twice = LeastSquaresProblem.of(library, targets, np.where(np.arange(200) < 50, 2.0, 1.0))
    repeated = LeastSquaresProblem.of(library, targets) + LeastSquaresProblem.of(library[:50], targets[:50])
    everything = np.ones(6, dtype=bool)
    np.testing.assert_allclose(twice.least_squares(everything, 0), repeated.least_squares(everything, 0), rtol=1e-10)
    half = LeastSquaresProblem.of(library[:50], targets[:50]).weighted(2.0) + LeastSquaresProblem.of(
        library[50:], targets[50:]
    )
    np.testing.assert_allclose(half.least_squares(everything, 0), repeated.least_squares(everything, 0), rtol=1e-10)


def test_a_restricted_system_has_the_same_fits(rows):
    library, targets = rows
    small = LeastSquaresProblem.of(library, targets).restrict([4, 1])
    expected = np.linalg.lstsq(library[:, [4, 1]], targets[:, 1], rcond=None)[0]
    np.testing.assert_allclose(small.least_squares(np.ones(2, dtype=bool), 1), expected, rtol=1e-10)


@pytest.mark.parametrize("alike", [False, True])
@pytest.mark.parametrize("support", [[False] * 4, [True, False, True, False], [True] * 4])
def test_several_problems_are_solved_as_one_by_one(support, alike):
    generator = np.random.default_rng(0)
    problems = []
    for _ in range(3):
        library = generator.standard_normal((20, 4)) * 10.0 ** np.arange(-4, 4, 2)
        library[:, 2] = library[:, 0] if alike else library[:, 2]
        problems.append(LeastSquaresProblem.of(library, generator.standard_normal((20, 2))))
    found = least_squares_of_each(problems, np.array(support), 1)
    expected = [problem.least_squares(np.array(support), 1) for problem in problems]
    np.testing.assert_allclose(found, expected, rtol=1e-11)


def test_the_deviance_is_the_sum_of_squares_and_beyond_the_threshold_that_of_huber():
    residuals, noise = np.array([[0.1, np.nan], [-0.2, 1.0], [3.0, -8.0]]), np.array([0.1, 2.0])
    sizes = np.array([1.0, 2.0, 30.0, 0.5, 4.0])
    assert ObservationModel(noise).deviance(residuals) == pytest.approx(np.sum(sizes**2))
    expected = sum(s**2 if s <= 3 else 2 * 3 * s - 3**2 for s in sizes)
    assert ObservationModel(noise, 3.0).deviance(residuals) == pytest.approx(expected)
    with refused("huber-threshold", value=0.0):
        ObservationModel(noise, 0.0)
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


@pytest.mark.parametrize("bound", [False, True])
@pytest.mark.parametrize("inside", [[], [2], [3, 0], [0, 2, 3, 4]])
def test_what_columns_explain_is_what_they_lower_the_residual_by(inside, bound):
    rows = np.random.default_rng(0).standard_normal((3, 8, 6))
    rows[1, :, 1] = 2 * rows[1, :, 2] - rows[1, :, 0]

    def residual(block, columns):
        coefficients = np.linalg.lstsq(block[:, columns], block[:, -1], rcond=None)[0]
        return np.sum((block[:, -1] - block[:, columns] @ coefficients) ** 2)

    found, expected = explained(rows, np.array(inside, dtype=int), 1e-12, bound=bound), np.zeros(6)
    for block in rows:
        least = residual(block, inside)
        expected[-1] += least
        for column in range(5):
            known = [*inside, column]
            if np.linalg.matrix_rank(block[:, known]) == len(known):
                expected[column] += least - residual(block, known)
            else:
                expected[column] += least if bound else 0.0
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("scale", [1e-220, 1e-100, 1.0, 1e100, 1e220])
def test_norms_of_columns_are_in_proportion_to_their_unit(rows, scale):
    library, targets = rows
    problem = LeastSquaresProblem.of(scale * library, targets)
    np.testing.assert_allclose(problem.norms / scale, np.linalg.norm(library, axis=0), rtol=1e-12)
    np.testing.assert_allclose(column_scales(scale * library) / scale, np.linalg.norm(library, axis=0), rtol=1e-12)
    assert column_scales(np.array([[0.0, np.inf], [0.0, 1e200]])).tolist() == [1.0, np.inf]
