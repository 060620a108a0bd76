"""A vector field and its derivatives, at one point and at many."""

import numpy as np
import pytest

from commonlaw.integration import Inputs, VectorField
from commonlaw.library import Order, PolynomialLibrary, Variables

FREE = np.random.default_rng(1).random((2, 28)) < 0.5


RATES = {2: ("v_x", "v_y"), (1, 2): ("v_y",)}
"""The rates by order of the law."""
ORDERS = [0, 1, *RATES]


def field(order: Order, free: np.ndarray | None = None) -> VectorField:
    terms = PolynomialLibrary(2).bind(Variables(("x", "y", *RATES.get(order, ())), ("u",), "t"))
    coefficients = np.random.default_rng(0).standard_normal((2, len(terms)))
    coefficients[:, 3] = 0
    return VectorField(terms, coefficients, order, Inputs.of(np.array([0.4]), np.sin([[0.4]])), free)


def points(order: Order) -> np.ndarray:
    return np.random.default_rng(2).uniform(-1, 1, (7, 4 + len(RATES.get(order, ()))))


@pytest.mark.parametrize("order", ORDERS)
def test_derivatives_are_sums_of_terms_behind_the_rates(order):
    found, values = field(order), points(order)
    highest = found.terms.evaluate(values) @ found.coefficients.T
    expected = {
        2: np.hstack([values[:, 2:4], highest]),
        (1, 2): np.column_stack([highest[:, 0], values[:, 2], highest[:, 1]]),
    }.get(order, highest)
    np.testing.assert_allclose(found.derivatives(values), expected, atol=1e-14)
    np.testing.assert_allclose(found.linearize(values).derivatives, expected, atol=1e-14)


@pytest.mark.parametrize("order", ORDERS)
def test_the_derivatives_by_the_states_are_those_of_differences(order):
    found, values = field(order), points(order)
    by_states = found.linearize(values).by_states
    for k in range(found.width):
        step = 1e-6 * np.eye(values.shape[1])[k]
        numeric = (found.derivatives(values + step) - found.derivatives(values - step)) / 2e-6
        np.testing.assert_allclose(by_states[:, :, k], numeric, atol=1e-8)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("every", [True, False])
def test_the_derivatives_by_the_parameters_are_those_of_differences(order, every):
    plain = field(order)
    mask = plain.coefficients != 0 if every else FREE[:, : len(plain.terms)]
    found, values = field(order, None if every else mask), points(order)
    by_parameters = found.linearize(values).by_parameters
    assert by_parameters.shape == (7, found.width, mask.sum())
    assert len(found.parameters) == mask.sum()
    for i, (j, k) in enumerate(np.argwhere(mask)):
        changed = plain.coefficients.copy()
        changed[j, k] += 1.0
        numeric = VectorField(plain.terms, changed, order).derivatives(values) - plain.derivatives(values)
        np.testing.assert_allclose(by_parameters[:, :, i], numeric, atol=1e-13)


@pytest.mark.parametrize("order", ORDERS)
def test_one_point_is_a_row_with_the_inputs_at_its_time(order):
    found, z = field(order), np.array([0.3, -0.7, 0.2, 0.5])[: 2 + len(RATES.get(order, ()))]
    values = np.concatenate([z, [np.sin(0.4), 0.4]])[np.newaxis]
    np.testing.assert_array_equal(found.point(0.4, z), values)
    np.testing.assert_array_equal(found(0.4, z), found.derivatives(values)[0])
    np.testing.assert_allclose(found.jacobian(0.4, z), found.linearize(values).by_states[0], atol=1e-14)
