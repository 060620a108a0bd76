"""Minima that do not depend on rounding."""

import numpy as np
import pytest

from commonlaw.inference.search.error_models import minimum


def valley(point):
    """Rosenbrock's function in logarithms of variables of order one: its least value is at (1, 1)."""
    x, y = point
    return 10 * (y - x**2) ** 2 + (1 - x) ** 2


BOX = np.full(2, -3.0), np.full(2, 3.0)


def test_the_least_value_of_a_bent_valley_is_found():
    # Differences over the spacing move it by a little, always by the same
    np.testing.assert_allclose(minimum(valley, np.array([-1.0, 2.0]), *BOX), [1, 1], atol=0.03)


@pytest.mark.parametrize("seed", range(5))
def test_the_last_digits_of_values_do_not_matter(seed):
    generator = np.random.default_rng(seed)
    exact = minimum(valley, np.array([-1.0, 2.0]), *BOX)
    rough = minimum(lambda point: valley(point) + 1e-10 * generator.standard_normal(), np.array([-1.0, 2.0]), *BOX)
    np.testing.assert_allclose(rough, exact, atol=1e-6)


def test_where_a_function_falls_beyond_a_bound_the_least_is_at_it():
    found = minimum(lambda point: (point[0] - 1) ** 2 + (point[1] + 5) ** 2, np.array([0.0, 0.0]), *BOX)
    np.testing.assert_allclose(found, [1, -3], atol=1e-6)


def test_a_variable_whose_bounds_are_one_stays():
    low, high = np.array([0.5, -3.0]), np.array([0.5, 3.0])
    np.testing.assert_allclose(minimum(valley, np.array([0.5, 2.0]), low, high), [0.5, 0.25], atol=1e-6)
