"""Laws whose equations have different orders: theta'' = ... beside i' = ..."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw.app.result import results
from commonlaw.diagnostics import Diagnostic
from commonlaw.law import to_latex, to_script, to_sympy
from commonlaw.law.parameters import coefficient_units, left_hand_sides, named_parameters, rate_names, state_rates
from commonlaw.library import Terms
from tests.refusals import refused
from tests.simulations import solved

TIMES = np.linspace(0, 6, 90)
EQUATIONS = "theta'' = -a sin(theta) - b theta' + k i; i' = -r i - m theta' + u"
TRUE = {"a": 4.0, "b": 0.3, "k": 1.5, "r": 1.2, "m": 0.4}
STARTS = [(1.2, 0.5, 0.0), (-0.8, 1.5, 1.0)]
UNITS = {"theta": "rad", "i": "A", "u": "A/s", "t": "s"}


def motor(numbers, start, drive=1.0):
    """A pendulum on a motor: angle, current, rate of the angle."""

    def rates(t, z, a, b, k, r, m):
        return [z[2], -r * z[1] - m * z[2] + drive * np.sin(0.7 * t), -a * np.sin(z[0]) - b * z[2] + k * z[1]]

    angle, speed, current = start
    return solved(rates, [angle, current, speed], TIMES, *numbers)


def trials_of(states, inputs, noise, seed, names, **settings):
    generator = np.random.default_rng(seed)
    scale = noise * np.mean([state.std(axis=0) for state in states], axis=0)
    measured = [state + scale * generator.standard_normal(state.shape) for state in states]
    given = {} if inputs is None else {"inputs": [inputs] * len(states)}
    return cl.Trials.from_arrays([TIMES] * len(states), measured, names=names, **given, **settings)


def motors(noise, seed=0):
    drive = np.sin(0.7 * TIMES)[:, np.newaxis]
    states = [motor(TRUE.values(), start)[:, :2] for start in STARTS]
    return trials_of(states, drive, noise, seed, ["theta", "i", "u"], units=UNITS)


def heated(noise, seed=0):
    """An oscillator whose spring softens with a temperature, which its friction heats: order 1 before order 2."""

    def rates(_, z):
        return [0.4 * z[2] ** 2 - 0.5 * z[0], z[2], -3 * z[1] + 0.8 * z[0] * z[1] - 0.2 * z[2]]

    starts = [(0.0, 1.5, 0.0), (1.0, -1.0, 1.0)]
    return trials_of([solved(rates, start, TIMES)[:, :2] for start in starts], None, noise, seed, ["T", "x"])


def three(noise, seed=0):
    """A cascade: a mass that follows what relaxes to it, and drives another that relaxes."""

    def rates(_, z):
        return [-z[0] + 0.5 * z[1], z[3], -0.7 * z[2] + z[1], -2 * z[1] + z[0] - 0.3 * z[3]]

    starts = [(1.0, 1.0, 0.0, 0.0), (0.0, -1.0, 2.0, 1.0)]
    return trials_of([solved(rates, start, TIMES)[:, :3] for start in starts], None, noise, seed, list("xyz"))


@pytest.fixture(scope="module")
def law():
    return cl.fit(EQUATIONS, motors(0.01), errors="white")


def test_a_fit_is_that_of_least_squares_by_scipy():
    noise = {"theta": 0.02, "i": 0.01}
    generator, scale = np.random.default_rng(3), np.array([*noise.values()])
    clean = [motor(TRUE.values(), start)[:, :2] for start in STARTS]
    measured = [each + scale * generator.standard_normal(each.shape) for each in clean]
    drive = np.sin(0.7 * TIMES)[:, np.newaxis]
    trials = cl.Trials.from_arrays([TIMES] * 2, measured, names=["theta", "i", "u"], inputs=[drive] * 2)

    def left(values):
        starts = values[5:].reshape(2, 3)
        pairs = zip(starts, measured, strict=True)
        return np.concatenate([((motor(values[:5], start)[:, :2] - own) / scale).ravel() for start, own in pairs])

    begin = np.concatenate([[*TRUE.values()], *STARTS])
    expected = least_squares(left, begin, xtol=1e-12, ftol=1e-12)
    errors = np.sqrt(np.diag(np.linalg.inv(expected.jac.T @ expected.jac)))[:5]
    settings = {"noise": noise, "errors": "white", "huber_threshold": np.inf, "input_interpolation": "cubic"}
    found = cl.fit(EQUATIONS, trials, **settings)
    parameters = named_parameters(found)
    values, own = (dict(zip(parameters.names, each[0], strict=True)) for each in (parameters.values, parameters.errors))
    for name, value, error in zip(TRUE, expected.x, errors, strict=False):
        assert values[name] == pytest.approx(value, abs=0.02 * error)
        assert own[name] == pytest.approx(error, rel=0.02)


@pytest.mark.parametrize("method", ["heyoka", "scipy"])
def test_integrators_follow_it(method):
    own = cl.Law.from_text(EQUATIONS.replace(" + u", ""), TRUE)
    if method == "heyoka":
        pytest.importorskip("heyoka")
    found = own.simulate(TIMES, [1.2, 0.0, 0.5], method=method, tolerance=1e-12)["object"].states
    np.testing.assert_allclose(found, motor(TRUE.values(), (1.2, 0.5, 0.0), drive=0.0), atol=1e-7)


def test_forecasts_and_their_bands_are_those_of_its_states(law):
    trials = motors(0.01, seed=5)
    forecast = law.predict(trials, start=20, return_std=True)
    assert forecast.score() > 0.99
    assert [trajectory.states.shape for trajectory in forecast.trajectories] == [(90, 3)] * 2
    first = law.predict(trials, start=1, return_std=True)
    assert np.isfinite(first.std[0]).all()
    low, high = (np.array(each) for each in zip(*forecast.bands(measured=True), strict=True))
    measured = np.stack([trial.states for trial in trials])
    assert 0.9 < np.mean((low <= measured) & (measured <= high)) <= 1


def test_what_it_says_names_the_order_of_each(law):
    assert law.order == (2, 1)
    assert left_hand_sides(law) == ("theta''", "i'")
    assert state_rates(law) == (("theta", "v_theta"),)
    assert "with v_theta = theta'" in str(law)
    assert r"\ddot{\theta} &=" in to_latex(law)
    assert r"\dot{i} &=" in to_latex(law)
    units = coefficient_units(law)
    assert (units["theta''", "i"], units["i'", "v_theta"], units["i'", "i"]) == ("rad/A/s²", "A/rad", "1/s")
    assert [str(each) for each in to_sympy(law)] == ["theta''", "i'"]


def test_it_is_saved_and_written_as_a_program(law, tmp_path):
    path = tmp_path / "law.json"
    law.save(path)
    again = cl.Law.load(path)
    assert again.order == (2, 1)
    assert again.terms == law.terms
    assert str(again) == str(law)
    assert repr(EQUATIONS) in to_script(law)
    np.testing.assert_array_equal(again.predict(motors(0.01)).score(), law.predict(motors(0.01)).score())


@pytest.mark.parametrize(("order", "orders"), [((2, 1), ()), ((1, 2), (2, 1))])
def test_a_law_whose_variables_have_other_orders_is_refused(law, order, orders):
    terms = Terms(replace(law.terms.variables, orders=orders), law.terms.terms)
    with refused("law-orders"):
        cl.Law(terms, law.schema, order, law.objects, law.coefficients)


SYSTEMS = {
    "motor": (
        motors,
        (2, 1),
        "poly:1 + terms:sin(theta)",
        ("theta'' = a i + b v_theta + c sin(theta)", "i' = d i + f v_theta + g u"),
    ),
    "heated": (heated, (1, 2), "poly:2", ("T' = a T + b v_x^2", "x'' = c x + d v_x + f T x")),
    "three": (three, (1, 2, 1), "poly:1", ("x' = a x + b y", "y'' = c x + d y + f v_y", "z' = g y + h z")),
}


@pytest.mark.parametrize(
    ("name", "noise"),
    [
        pytest.param(*each, marks=[pytest.mark.slow] * (each != ("motor", 0.01)))
        for each in product(["motor", "three", "heated"], [0.0, 0.01, 0.05])
    ],
)
def test_the_orders_of_the_law_that_made_the_data_are_found(name, noise):
    simulate, order, library, equations = SYSTEMS[name]
    law = cl.discover(simulate(noise), order="auto", library=library, cache=False)
    assert law.order == order
    if noise < 0.05:
        assert law.structure == equations
    said = ", ".join(f"{state} {each}" for state, each in zip(law.schema.states, order, strict=True))
    assert (law.history[0].stage, law.history[0].choice) == ("order", said)


def test_regression_on_derivatives_takes_that_of_each_order():
    law = cl.discover(
        heated(0.0),
        order={"x": 2, "T": 1},
        library="terms:T,v_x**2,x,v_x,T*x",
        method=cl.DerivativeRegression(solver=cl.solvers.STLSQ(0.0), differentiation="finite:6"),
        cache=False,
    )
    np.testing.assert_allclose(law.coefficients[0], [[-0.5, 0.4, 0, 0, 0], [0, 0, -3, -0.2, 0.8]], atol=1e-3)
    assert "order={'x': 2, 'T': 1}" in to_script(law)


def test_a_column_that_is_the_rate_of_a_state_of_second_order_is_left_out():
    states = [motor(TRUE.values(), start) for start in STARTS]
    trials = trials_of(states, np.sin(0.7 * TIMES)[:, np.newaxis], 1e-3, 0, ["theta", "i", "omega", "u"])
    for law in (
        cl.fit(EQUATIONS, trials),
        cl.discover(trials, order={"theta": 2, "i": 1}, library="poly:1 + terms:sin(theta)", cache=False),
    ):
        assert law.schema.states == ("theta", "i")
        assert rate_names(law) == ("omega",)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"order": (1, 2, 1)}, "order-per-state"),
        ({"order": {"T": 1}}, "order-missing"),
        ({"order": {"T": 1, "y": 2}}, Diagnostic("unknown-name", {"name": "y"})),
        ({"order": {"T": 0, "x": 2}}, Diagnostic("order-of-state", {"order": 0, "name": "T"})),
        ({"method": cl.WeakRegression()}, Diagnostic("mixed-orders-unsupported", {"method": "WeakRegression"})),
        ({"known": "T' = 1; x' = 2"}, Diagnostic("known-physics-order-given", {"order": "1", "sought": "T 1, x 2"})),
    ],
)
def test_what_does_not_fit_orders_by_state_is_refused(settings, message):
    with refused(message):
        cl.discover(heated(0.01), **{"order": {"T": 1, "x": 2}, "library": "poly:1", "cache": False} | settings)


def swing(numbers, start):
    """A pendulum that is driven by what decays: angle, rate, drive."""
    return solved(lambda _, z, a, b, c: [z[1], -a * np.sin(z[0]) - b * z[1] + z[2], -c * z[2]], start, TIMES, *numbers)


@pytest.mark.parametrize("known", [pytest.param(True, marks=pytest.mark.slow), False])
def test_a_drive_that_nobody_measured_beside_an_angle_is_fitted_as_by_scipy(known):
    true, noise = (4.0, 0.3, 0.35), 0.01
    begin = np.array([[1.2, 0.5, 0.8], [-0.8, 1.5, 0.8 if known else -0.6]])
    generator = np.random.default_rng(0)
    measured = [swing(true, start)[:, :1] + noise * generator.standard_normal((len(TIMES), 1)) for start in begin]
    trials = cl.Trials.from_arrays([TIMES] * 2, measured, names=["theta"])

    def left(values):
        starts = values[3:].reshape(2, -1)
        starts = np.column_stack([starts, [0.8, 0.8]]) if known else starts
        pairs = zip(starts, measured, strict=True)
        return np.concatenate([((swing(values[:3], start)[:, :1] - own) / noise).ravel() for start, own in pairs])

    expected = least_squares(left, [*true, *begin[:, : 2 if known else 3].ravel()], xtol=1e-12, ftol=1e-12)
    errors = np.sqrt(np.diag(np.linalg.inv(expected.jac.T @ expected.jac)))[:3]
    law = cl.fit(
        "theta'' = -a sin(theta) - b theta' + 1 q; q' = -c q",
        trials,
        initial_values={"q": 0.8 if known else None},
        noise={"theta": noise},
        errors="white",
        huber_threshold=np.inf,
    )
    assert law.order == (2, 1)
    parameters = named_parameters(law)
    values, own = (each[0] for each in (parameters.values, parameters.errors))
    np.testing.assert_allclose(values, expected.x[:3], atol=0.02 * errors.min())
    np.testing.assert_allclose(own, errors, rtol=0.02)


def test_an_unmeasured_state_of_second_order_is_refused():
    with refused("latent-of-second-order", state="q"):
        cl.fit("x'' = -a x + q; T' = -b T; q'' = -c q", heated(0.01), initial_values={"q": 1.0})


def test_the_page_of_the_app_is_told_the_order_of_each_state(law):
    *_, last = results(law, motors(0.01), motors(0.01), lambda _: None)
    assert (last.shown["orders"], last.shown["rates"]) == ((2, 1), [{"name": "v_theta", "unit": "rad/s"}])
