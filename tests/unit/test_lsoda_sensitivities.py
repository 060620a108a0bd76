"""Derivatives of trajectories against closed forms, where the states alone would not show how they move."""

import numpy as np
import pytest

from commonlaw.integration import InitialValueProblem, Inputs, VectorField, simulate
from commonlaw.library import Terms, Variables, parse_term

TIMES = np.array([0.0, 0.3, 2.0, 20.0])


def derivatives(states, equations, initial, times=TIMES, inputs=None, **options):
    """Sensitivities by LSODA of equations given as coefficients by term, all of them parameters."""
    variables = Variables(tuple(states), () if inputs is None else ("u",))
    names = list(dict.fromkeys(name for equation in equations for name in equation))
    terms = Terms(variables, tuple(parse_term(name, variables) for name in names))
    rows = np.array([[float(equation.get(name, 0)) for name in names] for equation in equations])
    problem = InitialValueProblem(VectorField(terms, rows, 1, inputs), np.array(initial, float), times)
    return simulate([problem], method="scipy", sensitivities=True, **options)[0].sensitivities


def test_a_state_at_rest_has_derivatives_that_swing():
    """x' = y, y' = -9 x rests at zero: y follows from the initial x as -3 sin 3t."""
    found = derivatives("xy", [{"y": 1}, {"x": -9}], [0, 0])
    cosine, sine = np.cos(3 * TIMES), np.sin(3 * TIMES)
    np.testing.assert_allclose(found[:, 0, 2:], np.column_stack([cosine, sine / 3]), atol=1e-6)
    np.testing.assert_allclose(found[:, 1, 2:], np.column_stack([-3 * sine, cosine]), atol=1e-6)
    np.testing.assert_allclose(found[:, :, :2], 0, atol=1e-12)


def test_coefficients_that_change_with_time_are_followed_where_the_state_rests():
    found = derivatives("x", [{"x*cos(5*t)": 1}], [0])[:, 0, -1]
    np.testing.assert_allclose(found, np.exp(np.sin(5 * TIMES) / 5), rtol=1e-6)


@pytest.mark.parametrize("rate", [1e2, 1e6])
def test_derivatives_of_stiff_laws_die_out(rate):
    """x' = -r x + r: the equilibrium follows one of the coefficients by 1 / r, and forgets the start."""
    found = derivatives("x", [{"x": -rate, "1": rate}], [3.0])[:, 0]
    decay = np.exp(-rate * TIMES)
    by_constant = (1 - decay) / rate
    by_rate = by_constant + 2 * TIMES * decay
    np.testing.assert_allclose(found[1:], np.column_stack([by_rate, by_constant, decay])[1:], atol=1e-7 / rate + 1e-9)


def test_derivatives_end_where_the_trajectory_does():
    times = np.array([0.0, 0.5, 0.9, 1.5])
    found = derivatives("x", [{"x**2": 1}], [1.0], times)[:, 0]
    np.testing.assert_allclose(found[:3, 1], 1 / (1 - times[:3]) ** 2, rtol=1e-5)
    assert np.isnan(found[3]).all()


def test_derivatives_of_a_law_that_ends_at_once_are_those_of_the_start():
    found = derivatives("x", [{"1/x": 1}], [0.0])[:, 0]
    assert found[0].tolist() == [0, 1]
    assert np.isnan(found[1:]).all()


def test_inputs_that_jump_act_from_their_sample_on():
    """x' = b u with u = 0, 1, 0: the derivative by b is the time with u = 1."""
    inputs = Inputs.of(np.array([0.0, 1.0, 3.0]), np.array([[0.0], [1.0], [0.0]]), "held")
    times = np.array([0.0, 1.0, 2.0, 3.0, 9.0])
    found = derivatives("x", [{"u": 2}], [0.0], times, inputs)[:, 0, 0]
    np.testing.assert_allclose(found, [0, 0, 1, 2, 2], atol=1e-9)


def test_a_smaller_tolerance_gives_more_exact_derivatives():
    errors = []
    for tolerance in (1e-4, 1e-7, 1e-11):
        found = derivatives("xy", [{"y": 1}, {"x": -9}], [1, 0], tolerance=tolerance)
        errors.append(np.abs(found[:, 0, 2] - np.cos(3 * TIMES)).max())
    assert errors[0] > 10 * errors[1] > 100 * errors[2]
    assert errors[2] < 1e-9
