import numpy as np
import pytest
from scipy.integrate import solve_ivp

from commonlaw.integration import VectorField, integrate
from commonlaw.library import PolynomialLibrary, Variables
from tests.refusals import refused


def lorenz_field():
    terms = PolynomialLibrary(2).bind(Variables(("x", "y", "z")))
    coefficients = np.zeros((3, len(terms)))
    for row, name, value in [
        (0, "x", -10), (0, "y", 10), (1, "x", 28), (1, "x z", -1), (1, "y", -1), (2, "x y", 1), (2, "z", -8 / 3)
    ]:  # fmt: skip
        coefficients[row, terms.index(name)] = value
    return VectorField(terms, coefficients)


def test_a_trajectory_agrees_with_another_integrator():
    times = np.linspace(0, 2, 50)

    def lorenz(_, y):
        return [10 * (y[1] - y[0]), y[0] * (28 - y[2]) - y[1], y[0] * y[1] - 8 / 3 * y[2]]

    expected = solve_ivp(lorenz, (0, 2), [1, 2, 3], "DOP853", t_eval=times, rtol=1e-11, atol=1e-11).y.T
    field = lorenz_field()
    for jacobian in (None, field.jacobian):
        found = integrate(field, np.array([1.0, 2.0, 3.0]), times, jacobian=jacobian)
        assert found.outcome is None
        np.testing.assert_allclose(found.states, expected, rtol=1e-5, atol=1e-5)


def test_a_stiff_law_is_integrated():
    terms = PolynomialLibrary(1).bind(Variables(("x",)))
    field = VectorField(terms, np.array([[0.0, -1e6]]))
    found = integrate(field, np.array([1.0]), np.array([0.0, 1e-6, 10.0]), jacobian=field.jacobian)
    np.testing.assert_allclose(found.states[:, 0], [1, np.exp(-1), 0], atol=1e-6)


def test_exponential_growth_is_followed_until_it_has_run_away():
    terms = PolynomialLibrary(1).bind(Variables(("x",)))
    found = integrate(VectorField(terms, np.array([[0.0, 1.0]])), np.array([1.0]), np.linspace(0, 100, 101))
    assert found.outcome is not None
    np.testing.assert_allclose(found.states[:10, 0], np.exp(np.arange(10.0)), rtol=1e-6)


@pytest.mark.parametrize("start", [0.0, 1.7e9])
def test_a_point_that_the_law_does_not_lead_out_of_ends_the_trajectory_soon(start):
    calls = []

    def falling_to_zero(t, y):
        calls.append(t)
        return -1 / y

    found = integrate(falling_to_zero, np.ones(1), start + np.linspace(0, 1, 11))
    assert found.outcome.kind == "diverged"
    assert found.ended == pytest.approx(start + 0.5, rel=1e-6)
    assert len(calls) < 30_000
    np.testing.assert_allclose(found.states[:5, 0], np.sqrt(1 - 2 * np.linspace(0, 0.4, 5)), rtol=1e-5)


def test_more_periods_than_steps_can_follow_end_in_an_outcome_and_never_in_zeros():
    def oscillating(_, y):
        return np.array([y[1], -y[0]])

    found = integrate(oscillating, np.array([1.0, 0.0]), np.array([0.0, 1e12]))
    assert found.outcome is not None
    assert found.outcome.code == "diverged"
    assert np.isnan(found.states[1]).all()


def test_a_first_sample_after_many_periods_is_as_accurate_as_one_after_few():
    def oscillating(_, y):
        return np.array([y[1], -y[0]])

    times = np.array([0.0, 2000.0])
    found = integrate(oscillating, np.array([0.0, 1.0]), times)
    np.testing.assert_allclose(found.states[1], [np.sin(times[1]), np.cos(times[1])], atol=1e-3)


def test_initial_states_and_times_are_checked():
    field = lorenz_field()
    with refused("initial-state-not-finite"):
        integrate(field, np.array([1.0, np.nan, 0.0]), np.array([0.0, 1.0]), where="pendulum")
    with refused("forecast-times-not-increasing"):
        integrate(field, np.ones(3), np.array([0.0, 0.0]))
