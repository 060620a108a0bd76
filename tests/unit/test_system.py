import numpy as np
import pytest

from commonlaw.formulation import System


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
    system = System.of(library, targets)
    for target in range(2):
        expected = np.linalg.lstsq(library[:, support], targets[:, target], rcond=None)[0]
        np.testing.assert_allclose(system.least_squares(chosen, target)[support], expected, rtol=1e-10)
        assert not system.least_squares(chosen, target)[~chosen].any()


def test_merged_systems_equal_the_system_of_all_rows(rows):
    library, targets = rows
    parts = [System.of(library[i : i + 50], targets[i : i + 50]) for i in range(0, 200, 50)]
    merged, whole = parts[0] + (parts[1] + parts[2]) + parts[3], System.of(library, targets)
    everything = np.ones(6, dtype=bool)
    assert merged.rows == 200
    np.testing.assert_allclose(merged.least_squares(everything, 1), whole.least_squares(everything, 1), rtol=1e-10)
    np.testing.assert_allclose(merged.norms, np.linalg.norm(library, axis=0), rtol=1e-12)


def test_residual_and_subtraction_agree_with_the_rows(rows):
    library, targets = rows
    system, coefficients = System.of(library, targets), np.arange(12.0).reshape(2, 6)
    left = targets - library @ coefficients.T
    np.testing.assert_allclose(system.residual(coefficients), np.sum(left**2, axis=0), rtol=1e-10)
    everything = np.ones(6, dtype=bool)
    np.testing.assert_allclose(
        system.subtract(coefficients).least_squares(everything, 0),
        np.linalg.lstsq(library, left[:, 0], rcond=None)[0],
        rtol=1e-9,
    )


def test_ridge_solves_the_penalised_normal_equations(rows):
    library, targets = rows
    expected = np.linalg.solve(library.T @ library + 3.0 * np.eye(6), library.T @ targets[:, 0])
    found = System.of(library, targets).least_squares(np.ones(6, dtype=bool), 0, ridge=3.0)
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_badly_scaled_columns_lose_no_digits(rows):
    library, targets = rows
    scales = 10.0 ** np.array([-8, 0, 8, 3, -5, 1])
    found = System.of(library * scales, targets).least_squares(np.ones(6, dtype=bool), 0)
    expected = np.linalg.lstsq(library, targets[:, 0], rcond=None)[0]
    np.testing.assert_allclose(found * scales, expected, rtol=1e-10)


def test_dependent_columns_give_the_fit_of_least_norm_and_a_large_condition(rows):
    library, targets = rows
    doubled = np.column_stack([library[:, 0], library[:, 0]])
    system, both = System.of(doubled, targets), np.array([True, True])
    first, second = system.least_squares(both, 0)
    assert first == pytest.approx(second)
    assert first + second == pytest.approx(targets[:, 0].mean())
    assert system.condition(both) > 1e12


def test_fewer_rows_than_terms_are_fitted_exactly():
    system = System.of(np.array([[1.0, 2.0, 3.0]]), np.array([[4.0]]))
    coefficients = system.least_squares(np.ones(3, dtype=bool), 0)
    assert coefficients @ [1, 2, 3] == pytest.approx(4)
