"""Fits from known, estimated and steady initial values, held against least squares of solutions in closed form."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import commonlaw as cl
from tests.refusals import refused
from tests.unit.decays import T, assert_least_squares, errors_of, estimates, least, trials_of

pytestmark = pytest.mark.usefixtures("few_starts")


def test_known_initial_values_of_a_measured_state():
    times = np.linspace(0.5, 6, 12)
    y = 5 * (1 - np.exp(-0.7 * times)) + 0.05 * np.random.default_rng(2).standard_normal(12)
    law = cl.fit("y' = k (B - y)", trials_of({"A": (times, y)}), initial_values={"y": 0}, initial_time=0)
    assert_least_squares(law, {"k": 1.0, "B": 4.0}, lambda p: p[1] * (1 - np.exp(-p[0] * times)) - y)


def test_initial_values_may_be_parameters_that_trials_share():
    samples, source = [], np.random.default_rng(3)
    for i in range(3):
        samples.append(cl.Trial("A", str(i), T, 2 * np.exp(-0.5 * T) + 0.05 * source.standard_normal(len(T))))
    trials = cl.Trials(tuple(samples), cl.Schema(("x",)))
    law = cl.fit("x' = -k x", trials, initial_values={"x": "x0"})
    whole = np.concatenate([sample.states[:, 0] for sample in samples])
    assert_least_squares(law, {"k": 1.0, "x0": 1.0}, lambda p: np.tile(p[1] * np.exp(-p[0] * T), 3) - whole)


def test_an_initial_value_with_a_standard_deviation_is_a_prior():
    y = 2 * np.exp(-0.5 * T) + 0.1 * np.random.default_rng(4).standard_normal(len(T))
    law = cl.fit("x' = -k x", trials_of({"A": (T, y)}, ["x"]), initial_values={"x": (2.2, 0.01)}, noise={"x": 0.1})

    def residuals(p):
        return np.append((p[1] * np.exp(-p[0] * T) - y) / 0.1, (p[1] - 2.2) / 0.01)

    found = least(residuals, [1.0, 1.0])
    errors = errors_of(found)
    assert estimates(law)["k"] == pytest.approx((found.x[0], errors[0]), rel=1e-4)
    (initial,) = law.trial_estimates
    assert (initial.value, initial.error) == pytest.approx((found.x[1], errors[1]), rel=1e-4)
    assert "x(0) = 2.2 ± 0.01" in str(law)
    assert f"{initial.value:.4f}" in law.summary()


def test_initial_values_by_object_are_those_of_each_trial_where_they_are_free():
    source = np.random.default_rng(11)
    samples = {("A", "1"): 2.0, ("B", "1"): 3.0, ("B", "2"): 5.0}
    made = [
        cl.Trial(*key, T, start * np.exp(-0.5 * T) + 0.02 * source.standard_normal(len(T)))
        for key, start in samples.items()
    ]
    trials = cl.Trials(tuple(made), cl.Schema(("x",)))
    law = cl.fit("x' = -k x", trials, initial_values={"x": {"A": 2, "B": None}}, shared="k")
    found = {(each.object, each.trial): each.value for each in law.trial_estimates}
    assert {each.name for each in law.trial_estimates} == {"x(0)"}
    assert found == pytest.approx({("B", "1"): 3.0, ("B", "2"): 5.0}, rel=0.02)
    assert law.params["parameter"].unique().tolist() == ["k"]
    assert law.predict(trials).to_frame()["x forecast"].iloc[0] == 2.0
    with refused("initial-value-not-finite", object="B"):
        cl.fit("x' = -k x", trials, initial_values={"x": {"A": 2}})


@pytest.mark.parametrize(
    "text",
    [
        "a' = -k a u + m b; b' = k a u - m b; a(0) = steady; b(0) = steady",  # Any of one sum
        "a' = -k a u; a(0) = steady",  # Any value
        "a' = 1 + u; a(0) = steady",  # None
    ],
)
def test_steady_states_that_are_none_or_many_are_refused(text):
    times = T[::5]
    inputs = np.where(times > 1, 1.0, 0.0)[:, None]
    trial = cl.Trial("A", "1", times, np.exp(-0.5 * np.maximum(times - 1, 0))[:, None], inputs)
    trials = cl.Trials((trial,), cl.Schema(("a",), ("u",)))
    with refused("no-steady-state"):
        cl.fit(text, trials)


def test_trials_may_begin_in_the_steady_state_under_other_inputs():
    t, random = np.linspace(0, 10, 40), np.random.default_rng(5)
    level = {"1": 1.0, "2": 3.0}
    noise = {name: 0.01 * random.standard_normal(len(t)) for name in level}

    def solution(k, a, u):
        return (a + u) / k - u / k * np.exp(-k * t)

    made = tuple(
        cl.Trial("A", name, t, (solution(0.5, 1.5, u) + noise[name])[:, None], np.full((len(t), 1), u))
        for name, u in level.items()
    )
    law = cl.fit("x' = a + u - k x; x(0) = steady(u = 0)", cl.Trials(made, cl.Schema(("x",), ("u",))))

    def residuals(p):
        k, a = p
        return np.concatenate([solution(k, a, u) - solution(0.5, 1.5, u) - noise[name] for name, u in level.items()])

    assert_least_squares(law, {"k": 0.45, "a": 1.4}, residuals)
    assert "x(0) = steady(u = 0)" in str(law)


def test_states_may_be_measured_once_and_in_some_conditions_only():
    def samples(times, a, b):
        return np.column_stack([a * np.exp(-0.3 * times), b + a * (1 - np.exp(-0.3 * times))])

    times = np.array([0.0, 1.0, 2.0, 4.0, 8.0])
    one = samples(times, 3.0, 0.0)
    one[1:, 0] = np.nan
    other = samples(times, 1.0, 2.0)
    other[:, 1] = np.nan
    trials = cl.Trials((cl.Trial("A", "1", times, one), cl.Trial("B", "1", times, other)), cl.Schema(("x", "y")))
    starts = {"y": {"A": 0, "B": 2}, "x": None}
    law = cl.fit("x' = -k x; y' = k x", trials, shared="k", initial_values=starts, noise={"x": 0.1, "y": 0.1})
    assert [estimates(law, name)["k"][0] for name in "AB"] == pytest.approx([0.3, 0.3], rel=1e-6)


def test_a_law_with_known_initial_values_may_be_known_physics():
    """Of ``y' = 1 - k y - 0.5 y^2`` the first is known by a law that was fitted from y(0) = 0."""
    first = trials_of({"A": (T, (1 - np.exp(-0.5 * T)) / 0.5)})
    known = cl.fit("y' = 1 - k y", first, initial_values={"y": 0})
    y = solve_ivp(lambda _, y: 1 - 0.5 * y - 0.5 * y**2, (0, 6), [0.0], t_eval=T, rtol=1e-9).y[0]
    trials = trials_of({"A": (T, y + 1e-3 * np.random.default_rng(0).standard_normal(len(T)))})
    law = cl.discover(trials, order=1, library="poly:2", known=known, cache=False)
    assert law.structure == ("y' = 1 - 0.5 y + a y^2",)
    assert estimates(law)["a"][0] == pytest.approx(-0.5, abs=4 * estimates(law)["a"][1])
