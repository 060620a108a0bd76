from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import curve_fit

import commonlaw as cl
from commonlaw.law.parameters import named_parameters
from tests.refusals import refused

pytestmark = pytest.mark.usefixtures("few_starts")

NOISE = 0.01
"""Of measurements, in the size of the population."""


def logistic(times, r, start):
    """Return a population in its capacity; `start` is the logarithm of what it begins with."""
    return 1 / (1 + np.expm1(-start) * np.exp(-r * times))


def sir(times, b, g, susceptible, infected):
    """Return the infected of a population in its size."""

    def rates(_, states):
        new = b * states[0] * states[1]
        return [-new, new - g * states[1]]

    start = [susceptible, infected]
    return solve_ivp(rates, (0, times[-1]), start, t_eval=times, rtol=1e-9, atol=1e-12).y[1]


def least_squares(function, times, measured, guess):
    """Return estimates and their standard errors."""
    noise = np.full(len(times), NOISE)
    found, covariance = curve_fit(function, times, measured, guess, noise, absolute_sigma=True, method="lm")
    return found, np.sqrt(np.diagonal(covariance))


def estimates(law, name):
    parameters = named_parameters(law)
    index = parameters.names.index(name)
    return parameters.values[:, index], parameters.errors[:, index]


@pytest.fixture(scope="module")
def measured():
    random, times = np.random.default_rng(0), np.linspace(0, 20, 30)
    return times, {r: logistic(times, r, np.log(0.05)) + NOISE * random.standard_normal(30) for r in (0.5, 0.7)}


def populations(measured, size):
    times, grown = measured
    frames = [pd.DataFrame({"r": r, "t": times, "x": size * x, "K": size}) for r, x in grown.items()]
    return cl.Trials.from_frame(pd.concat(frames), object="r", time="t", states=["x"], properties=["K"])


@pytest.mark.parametrize(
    ("size", "start"), [(1e-9, ""), (1e9, "; x(0) = x0"), pytest.param(1.0, "", marks=pytest.mark.slow)]
)
def test_a_capacity_that_is_a_property_stays_whatever_its_size(measured, size, start):
    times, grown = measured
    law = cl.fit(f"x' = r x (1 - x/K){start}", populations(measured, size), errors="white", noise={"x": NOISE * size})
    expected = [least_squares(logistic, times, x, (r, np.log(0.05))) for r, x in grown.items()]
    rates, errors = estimates(law, "r")
    assert rates == pytest.approx([values[0] for values, _ in expected], rel=1e-3)
    assert errors == pytest.approx([own[0] for _, own in expected], rel=0.05)
    capacities, none = estimates(law, "K")
    assert (capacities == size).all()
    assert (none == 0).all()


def test_an_epidemic_in_a_large_population_begins_with_an_unknown_number_of_susceptible():
    size, times, truth = 1.3e9, np.linspace(0, 60, 61), (0.5, 0.15, 0.9, 0.001)
    infected = sir(times, *truth) + NOISE * np.random.default_rng(1).standard_normal(len(times))
    frame = pd.DataFrame({"town": "A", "t": times, "I": size * infected, "N": size})
    trials = cl.Trials.from_frame(frame, object="town", time="t", states=["I"], properties=["N"])
    settings = {"initial_values": {"S": None}, "errors": "white", "noise": {"I": NOISE * size}}
    law = cl.fit("S' = -b S I/N; I' = b S I/N - g I", trials, **settings)
    expected, errors = least_squares(sir, times, infected, truth)
    for i, name in enumerate("bg"):
        (value,), (error,) = estimates(law, name)
        assert value == pytest.approx(expected[i], abs=0.02 * errors[i])
        assert error == pytest.approx(errors[i], rel=0.05)


def test_a_known_number_is_not_replaced_when_a_law_is_simplified(measured):
    law = cl.fit("x' = r x (1 - (x/K)^p)", populations(measured, 1e6), errors="white")
    found = law.simplify()
    assert [each.parameter for each in found.replaced] == ["p"]
    assert {*found.parameters} == {"r", "K"}


def test_bounds_are_of_the_parameter_of_that_name_in_whichever_equation_it_stands():
    times = np.linspace(0, 8, 30)

    def rates(_, states):
        used = states[0] / (0.5 + states[0])
        return [-used, used - 60 * states[1] / (40 + states[1])]

    states = solve_ivp(rates, (0, 8), [4.0, 0.0], t_eval=times, rtol=1e-10, atol=1e-12).y.T
    trials = cl.Trials.from_arrays(times, states, names=["x", "y"])
    law = cl.fit("x' = -V x/(K + x); y' = V x/(K + x) - W y/(L + y); 20 < L < 80", trials, errors="white")
    assert estimates(law, "V")[0] == pytest.approx(1.0, rel=0.01)
    assert estimates(law, "L")[0] == pytest.approx(40, rel=0.1)


def test_forecasts_of_a_new_object_take_its_own_property(measured):
    law = cl.fit("x' = r x (1 - x/K)", populations(measured, 1e6), errors="white")
    times = np.linspace(0, 20, 30)
    frame = pd.DataFrame({"r": 0.6, "t": times, "x": 4e6 * logistic(times, 0.6, np.log(0.05)), "K": 4e6})
    new = cl.Trials.from_frame(frame, object="r", time="t", states=["x"], properties=["K"])
    forecast = law.predict(new, return_std=True)
    expected = 4e6 * logistic(times, estimates(law, "r")[0].mean(), np.log(0.05))
    np.testing.assert_allclose(forecast.trajectories[0].states[:, 0], expected, rtol=0.01)
    assert forecast.std[0][-1, 0] < 0.01 * forecast.std[0].max()  # Its capacity is known, unlike its rate
    with refused("property-missing", property="K"):
        law.predict(cl.Trials.from_frame(frame.drop(columns="K"), object="r", time="t", states=["x"]))


def test_a_property_that_an_object_lacks_or_that_is_no_number_is_refused(measured):
    trials = populations(measured, 1.0)
    first, second = trials.objects
    for code, values in {
        "property-missing": {first: {"M": 1.0}},
        "property-number": {first: {"M": "few"}, second: {"M": "many"}},
    }.items():
        for equation in ("x' = r x (1 - x/M)", "x' = r - M x"):
            with refused(code, property="M"):
                cl.fit(equation, trials.with_properties(values))


@pytest.mark.parametrize("scheme", ["collocation", "shooting"])
def test_a_discrepancy_is_estimated_for_a_law_with_a_property(scheme):
    """The law is that of a product with the inverse of the property as an input."""
    times, random, made = np.linspace(0, 6, 30), np.random.default_rng(1), []
    masses = {"a": {"m": 1.0}, "b": {"m": 2.0}}
    for owner, mass in masses.items():
        rate = 0.8 / mass["m"]
        x = rate * 4 / ((rate + 0.2) * np.exp(rate * times) - 0.2)  # Of x' = -rate x - 0.05 x^2
        made.append(cl.Trial(owner, "1", times, x + 0.01 * random.standard_normal(len(times))))
    trials = cl.Trials(tuple(made), cl.Schema(("x",)), masses)
    law = cl.fit("x' = -k/m x", trials, scheme=scheme, errors="white", n_jobs=1)
    discrepancy = law.discrepancy(trials, of="x")
    assert discrepancy.claimed
    assert discrepancy.law.coefficients[:, 0, 1].tolist() == [1.0, 2.0]
    assert discrepancy.law.predict(trials, discrepancy=True).metric() > 0.999
    listed = [replace(trial, inputs=np.full((30, 1), 1 / masses[trial.object]["m"])) for trial in trials]
    driven = cl.Trials(tuple(listed), cl.Schema(("x",), ("w",)))
    product = cl.fit("x' = -k w x", driven, scheme=scheme, errors="white", n_jobs=1).discrepancy(driven, of="x")
    assert discrepancy.evidence == pytest.approx(product.evidence, abs=0.1)
    one, as_product = (named_parameters(of.law) for of in (discrepancy, product))
    assert one.values[:, 0] == pytest.approx(as_product.values[:, 0], rel=1e-3)
    assert one.errors[:, 0] == pytest.approx(as_product.errors[:, 0], rel=1e-2)
