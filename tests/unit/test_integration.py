"""Integration of laws, rates and steps, and the least value of a function."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import commonlaw as cl
from commonlaw.diagnostics import OutcomeKind
from commonlaw.formulation import law_variables
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.integral_form import integrated
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.result.history import outcomes_of_fit
from commonlaw.inference.score.score import Score
from commonlaw.integration import InitialValueProblem, VectorField, integrate, runge_kutta_step, simulate
from commonlaw.library import PolynomialLibrary, Terms, Variables, parse_library, parse_term
from commonlaw.likelihood.levels import minimum
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


def test_a_level_that_hardly_matters_is_at_its_bound_within_few_values():
    points = list[np.ndarray]()

    def value(point):  # Of a variance exp(2 x) whose influence vanishes, and another level
        points.append(point)
        return np.exp(2 * point[0]) * (1 + point[1] ** 2) + (point[1] - 1) ** 2

    found = minimum(value, np.array([2.0, 0.0]), np.array([-9.0, -3.0]), np.array([3.0, 3.0]))
    np.testing.assert_allclose(found, [-9, 1], atol=1e-6)
    assert len(points) < 60


def test_a_variable_whose_bounds_are_one_stays():
    low, high = np.array([0.5, -3.0]), np.array([0.5, 3.0])
    np.testing.assert_allclose(minimum(valley, np.array([0.5, 2.0]), low, high), [0.5, 0.25], atol=1e-6)


@pytest.mark.parametrize(("order", "expected"), [(1, lambda t: 0.3 * t + t**3), (2, lambda t: 0.15 * t**2 + t**4 / 4)])
def test_cubic_splines_integrate_smooth_rates(order, expected):
    times = np.linspace(0, 2, 21)
    np.testing.assert_allclose(integrated(times, (0.3 + 3 * times**2)[:, np.newaxis], order)[:, 0], expected(times))


def test_rates_that_jump_are_integrated_between_the_jumps():
    times = np.concatenate([np.linspace(0, 1, 6), np.linspace(1, 3, 11), [3.0]])
    rates = np.repeat([2.0, -1.0, 50.0], [6, 11, 1])[:, np.newaxis]
    speed = np.where(times <= 1, 2 * times, 2 - (times - 1))
    place = np.where(times <= 1, times**2, 1 + 2 * (times - 1) - (times - 1) ** 2 / 2)
    np.testing.assert_allclose(integrated(times, rates, 1)[:, 0], speed, atol=1e-13)
    np.testing.assert_allclose(integrated(times, rates, 2)[:, 0], place, atol=1e-13)


TIMES = np.linspace(0, 8, 200)


def stated(library, coefficients, curve, model_error=0.0, noise=0.05):
    """A law with coefficients, and states on a curve that was measured with noise."""
    measured = curve + noise * np.random.default_rng(0).standard_normal(len(curve))
    trials = cl.Trials.from_arrays(TIMES, measured[:, np.newaxis], names=["x"])
    terms = parse_library(library).bind(law_variables(trials.schema, 1))
    problem = prepare(trials, terms, np.full((1, 1, len(terms)), np.nan), noise=np.array([noise]))
    (start,) = problem.starts
    estimate = replace(start, states=(curve[:, np.newaxis],), coefficients=np.array([coefficients]))
    return Fit(problem, np.ones((1, len(terms)), dtype=bool), (estimate,), model_error, Score({}))


def test_a_fit_that_is_no_solution_of_its_law_did_not_converge():
    resting = np.pi * np.random.default_rng(1).integers(20, 24, len(TIMES))  # Of sin(x), 12 rates of 20 in a step
    exact, erring = (stated("terms:sin(x)", [-500.0], resting.astype(float), error) for error in (0.0, 0.5))
    assert not erring.is_resolved
    assert not erring.is_solved
    (found, *_) = outcomes_of_fit(exact.problem.law, exact, is_converged=True, tried_errors=True)
    assert found.kind is OutcomeKind.NOT_CONVERGED
    solved = stated("terms:x", [-0.5], 3 * np.exp(-0.5 * TIMES))
    assert solved.is_solved
    assert outcomes_of_fit(solved.problem.law, solved, is_converged=True, tried_errors=True) == ()
    (found,) = outcomes_of_fit(solved.problem.law, solved, is_converged=False, tried_errors=True)
    assert found.kind is OutcomeKind.NOT_CONVERGED


def test_what_a_law_errs_by_in_each_step_is_no_error_of_the_step():
    wandering = 3 * np.exp(-0.5 * TIMES) + np.cumsum(0.05 * np.random.default_rng(2).standard_normal(len(TIMES)))
    assert stated("terms:x", [-0.5], wandering, model_error=1.0).is_resolved


def test_departures_from_the_estimated_states_are_those_of_the_solution():
    """A linear law has no terms beyond the first order; solutions of the other rate depart by four levels of noise."""
    (errors,) = stated("terms:x", [-0.6], 3 * np.exp(-0.5 * TIMES)).discretization_errors
    exact = 3 * (np.exp(-0.5 * TIMES) - np.exp(-0.6 * TIMES)) / 0.05
    np.testing.assert_allclose(errors.total[:, 0], exact, atol=1e-3)
    assert exact.max() > 4


def test_a_law_whose_trajectories_diverge_is_not_solved():
    fit = stated("terms:x^2", [1.0], np.full(len(TIMES), 1.0))
    assert fit.diverges
    assert not fit.is_solved


def test_a_step_of_runge_and_kutta_is_exact_to_fourth_order_in_states_and_simpsons_rule_in_time():
    h = 0.3
    (found,) = runge_kutta_step(lambda z, _: -2 * z, np.array([1.5]), h)
    assert found == pytest.approx(1.5 * np.polyval([1 / 24, 1 / 6, 1 / 2, 1, 1], -2 * h), rel=1e-14)
    (found,) = runge_kutta_step(lambda _, share: np.array([3 * (share * h) ** 2]), np.array([1.0]), h)
    assert found == pytest.approx(1 + h**3, rel=1e-14)


def test_a_fast_beginning_between_samples_costs_no_accuracy():
    """Rates at first would carry the states 1e5 times as far as they go, and the absolute tolerance with them."""
    variables = Variables(("x", "y"))
    terms = Terms(variables, tuple(parse_term(name, variables) for name in ("x", "y")))
    rates, start, times = np.array([[-1e5, 1e5], [-1.0, 0.0]]), np.array([3.0, 1.0]), np.linspace(0, 3, 4)
    (found,) = simulate([InitialValueProblem(VectorField(terms, rates), start, times)], method="scipy")
    np.testing.assert_allclose(found.states, [expm(rates * t) @ start for t in times], rtol=2e-7)


def test_a_state_that_overflows_within_the_first_step_has_diverged():
    law = cl.Law.from_text("x'' = k v", {"k": 1e5})
    how = {"method": "scipy", "tolerance": 1e-5, "sensitivities": True}
    trajectory = law.simulate([0.0, 0.07], [11.0, -4935.0], **how)["object"]
    assert trajectory.outcome.code == "diverged"
    assert trajectory.ended < 0.001
