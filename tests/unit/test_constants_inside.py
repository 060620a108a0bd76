"""Constants inside of the terms of a law: fitted, as sure as they are, and used as any coefficient."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import curve_fit
from scipy.special import lambertw

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.inference import settings
from commonlaw.inference.fit.parameter_grid import grid_product
from commonlaw.law import from_json, relations_frame, to_json, to_latex, to_script, to_sympy
from commonlaw.law.parameters import named_parameters
from commonlaw.law.parse import read_equations
from commonlaw.law.text import with_error
from commonlaw.trials.headers import parse_unit
from tests.refusals import refused
from tests.simulations import simulated

ENZYMES = {"a": (1.0, 0.5), "b": (2.0, 3.0)}
SATURATING = "s' = -V s/(K + s)"


def michaelis_menten(t, start, rate, half):
    return half * lambertw(start / half * np.exp((start - rate * t) / half)).real


def gompertz(t, start, rate, capacity):
    return capacity * np.exp(np.log(start / capacity) * np.exp(-rate * t))


@pytest.fixture(scope="module")
def enzymes():
    times = np.linspace(0, 5, 25)
    return simulated(lambda _, s, rate, half: -rate * s / (half + s), ENZYMES, [[3.0], [1.5]], times, 0.01)


@pytest.fixture(scope="module")
def fitted(enzymes):
    return cl.fit(SATURATING, enzymes, errors="white")


def by_parameter(law):
    parameters = named_parameters(law)
    return [dict(zip(parameters.names, each.T, strict=True)) for each in (parameters.values, parameters.errors)]


@pytest.mark.parametrize(
    ("text", "solution", "values"),
    [(SATURATING, michaelis_menten, (3.0, 1.0, 0.5)), ("s' = -r s log(s/K)", gompertz, (0.3, 0.8, 5.0))],
    ids=["Michaelis-Menten by Lambert's W", "Gompertz"],
)
@pytest.mark.parametrize("noise", [pytest.param(0.01, marks=pytest.mark.slow), 0.1])
def test_constants_are_those_of_least_squares_on_the_solution_in_closed_form(text, solution, values, noise):
    times = np.linspace(0, 6, 81)
    measured = solution(times, *values) + noise * np.random.default_rng(1).standard_normal(81)
    law = cl.fit(text, cl.Trials.from_arrays(times, measured, names=["s"]), huber_threshold=np.inf)
    expected, covariance = curve_fit(solution, times, measured, values, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    parameters = named_parameters(law)
    np.testing.assert_allclose(parameters.values[0], expected[1:], rtol=1e-6)
    # The noise has as many degrees of freedom but for a few samples
    np.testing.assert_allclose(parameters.errors[0], np.sqrt(np.diag(covariance))[1:], rtol=0.01)


LAWS: dict[str, tuple[Any, ...]] = {
    "an unknown power of the speed": (
        "x'' = -9.81 - k sign(v) abs(v)^p",
        lambda _, z, k, p: [z[1], -9.81 - k * np.sign(z[1]) * abs(z[1]) ** p],
        {"a": (0.5, 1.7), "b": (0.3, 1.3)},
        [[0.0, 15.0], [20.0, 0.0]],
        np.linspace(0, 2, 60),
        ("x",),
    ),
    "a driver of unknown frequency": (
        "x'' = -k x + A cos(w t + p)",
        lambda t, z, k, height, frequency, phase: [z[1], -k * z[0] + height * np.cos(frequency * t + phase)],
        {"a": (4.0, 1.0, 2.3, 0.7)},
        [[1.0, 0.0], [0.0, 0.5]],  # From one start alone, driver and spring could be exchanged
        np.linspace(0, 15, 80),
        ("x",),
    ),
    "Hill": (
        "s' = a - V s^n/(K^n + s^n)",
        lambda _, s, a, rate, power, half: a - rate * s**power / (half**power + s**power),
        {"a": (0.2, 1.0, 2.0, 0.5), "b": (0.3, 2.0, 3.0, 0.8)},
        [[2.0], [0.1], [0.7]],
        np.linspace(0, 5, 50),
        ("s",),
    ),
    "an epidemic, in which one number stands in two equations": (
        "S' = -b S I; I' = b S I - g I",
        lambda _, y, recovery, contact: [-contact * y[0] * y[1], contact * y[0] * y[1] - recovery * y[1]],
        {"a": (0.3, 0.8), "b": (0.25, 1.2)},
        [[0.99, 0.01], [0.8, 0.05]],
        np.linspace(0, 25, 60),
        ("S", "I"),
    ),
}
SLOW = ("a driver of unknown frequency", "an unknown power of the speed", "Hill")


@pytest.mark.parametrize("law", [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW)) for name in LAWS])
def test_constants_are_found_from_nothing_but_the_text(law):
    text, function, objects, starts, times, states = LAWS[law]
    found = cl.fit(text, simulated(function, objects, starts, times, 0.01, states))
    parameters = named_parameters(found)
    values, errors = parameters.values, parameters.errors
    assert found.objects == tuple(objects)
    assert np.all(np.abs(values - list(objects.values())) < 4 * errors), (parameters.names, values, errors)
    assert np.all(errors < 0.2 * np.abs(values))


def test_constants_are_written_where_they_stand(fitted):
    values, errors = by_parameter(fitted)
    (equation,) = fitted.equations("b", errors=False)
    stated = cl.Law.from_text(equation)
    points = np.array([[0.5, 0.0], [2.0, 0.0]])
    np.testing.assert_allclose(stated.rhs("object", points), fitted.rhs("b", points), rtol=1e-3)
    assert fitted.equations("b")[0].endswith(f"s/({with_error(values['K'][1], errors['K'][1], bracket=True)} + s)")
    block = to_latex(fitted, "b", errors=False)
    assert r"\frac{V s}{K + s}" in block
    assert f"K &= {values['K'][1]:.4g}" in block
    ((_, right),) = to_sympy(fitted, "b").items()
    expected = float(fitted.rhs("b", [[2.0, 0.0]])[0, 0])
    assert float(right.subs(dict.fromkeys(right.free_symbols, 2.0))) == pytest.approx(expected)


def test_a_law_simulates_and_forecasts_by_its_constants(fitted, enzymes):
    values, _ = by_parameter(fitted)
    times = np.linspace(0, 4, 9)
    for method in ("scipy", "heyoka"):
        paths = fitted.simulate(times, [2.0], method=method)
        for name, rate, half in zip(fitted.objects, values["V"], values["K"], strict=True):
            np.testing.assert_allclose(paths[name].states[:, 0], michaelis_menten(times, 2.0, rate, half), rtol=1e-5)
    assert fitted.predict(enzymes).score() > 0.99


@pytest.mark.parametrize("method", ["scipy", "heyoka"])
def test_standard_deviations_of_forecasts_are_those_of_drawn_constants_and_starts(fitted, enzymes, method):
    first = enzymes.select(object="a", trial="0")
    forecast = fitted.predict(first, start=1, return_std=True, method=method)
    draws = fitted.sample(2000).xs("a", level="object")
    starts = first[0].states[0, 0] + fitted.uncertainty.noise[0] * np.random.default_rng(0).standard_normal(2000)
    times = first[0].times[:, np.newaxis] - first[0].times[0]
    paths = michaelis_menten(times, starts, draws["V"].to_numpy(), draws["K"].to_numpy())
    # Three and a half times the relative error of a standard deviation of so many draws
    np.testing.assert_allclose(forecast.std[0][:, 0], paths.std(axis=1), rtol=0.055)


def test_what_decides_a_constant_is_explained():
    objects = {name: (1.0, half) for name, half in zip("abcde", (0.4, 0.6, 0.8, 1.2, 1.6), strict=True)}
    times = np.linspace(0, 6, 40)
    trials = simulated(lambda _, s, rate, half: -rate * s / (half + s), objects, [[3.0]], times, 0.01)
    law = cl.fit(SATURATING, trials)
    explained = law.explain({name: {"inhibitor": 2 * half} for name, (_, half) in objects.items()})
    relations = relations_frame(explained).set_index("term")
    assert relations.loc["K", "follows"] == "inhibitor"
    assert relations.loc["s/(K + s)", "kind"] == "universal"
    low, high = relations.loc["K", ["factor", "standard error"]] @ [[1, 1], [-4, 4]]
    assert low < 0.5 < high
    assert re.fullmatch(r"K = \(0\.\d+ ± 0\.\d+\) inhibitor", explained.equations()[1])


def test_a_property_is_a_constant_that_is_known(enzymes):
    known = replace(enzymes, properties={name: {"K": half} for name, (_, half) in ENZYMES.items()})
    law = cl.fit(SATURATING, known)
    values, errors = by_parameter(law)
    np.testing.assert_array_equal(values["K"], [half for _, half in ENZYMES.values()])
    assert (errors["K"] == 0).all()
    assert (np.abs(values["V"] - [rate for rate, _ in ENZYMES.values()]) < 4 * errors["V"]).all()


def test_refining_begins_with_the_constants_of_the_law(fitted, enzymes):
    refined = cl.refine(fitted, enzymes, errors="white")
    np.testing.assert_allclose(named_parameters(refined).values, named_parameters(fitted).values, rtol=1e-6)


def test_laws_with_constants_are_compared_with_others(fitted, enzymes):
    table = cl.compare([fitted, cl.fit("s' = a + b s + c s^2", enzymes, errors="white")], enzymes)
    assert table["equations"][0] == SATURATING
    assert table["coefficients"][0] == 2
    assert table["2 log B"][1] > 10


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{SATURATING}; K > a", Diagnostic("bound-syntax", {"text": "K > a"})),
        (
            f"{SATURATING}; K > 3; K < 1",
            Diagnostic("bound-contradiction", {"parameter": "K", "bounds": "K > 3; K < 1"}),
        ),
        (f"{SATURATING}; 2 < K < 1", Diagnostic("bound-empty", {"text": "2 < K < 1"})),
        (f"{SATURATING}; Q > 0", Diagnostic("unknown-name", {"kind": "coefficient", "name": "Q"})),
        ("s' = -k s + b sin(q)", Diagnostic("parameters-not-identifiable", {"names": "b, q", "variables": "s, t"})),
        ("s' = -k abs(w)", Diagnostic("parameters-not-identifiable", {"names": "k, w"})),
        ("s' = -exp(-E/(2 R)) s", Diagnostic("parameters-not-identifiable", {"names": "E, R"})),
        ("s' = -V sqrt(-abs(s) - K^2)", "terms-nowhere-finite"),
        ("s[k+1] = V s/(K + s)", Diagnostic("discrete-with-parameters", {"names": "K"})),
    ],
)
def test_what_cannot_be_fitted_is_refused_in_words(enzymes, text, message):
    with refused(message):
        cl.fit(text, enzymes)


def test_a_constant_that_fits_best_outside_of_its_bound_is_at_the_bound(enzymes):
    law = cl.fit(f"{SATURATING}; 0 < K < 0.1", enzymes, errors="white")
    at_bound = cl.fit(SATURATING.replace("K", "0.1"), enzymes, errors="white", partial_pooling=False)
    values, errors = by_parameter(law)
    np.testing.assert_array_equal(values["K"], 0.1)
    assert (errors["K"] == 0).all()
    np.testing.assert_allclose(values["V"], by_parameter(at_bound)[0]["V"], rtol=0.02)
    named = [diagnostic for diagnostic in law.diagnostics if diagnostic.kind == "bound"]
    assert [each.where for each in named] == list(enzymes.objects)
    assert "K is at its bound, 0.1" in named[0].text


@pytest.mark.parametrize("settings", [{}, pytest.param({"shared": "V"}, marks=pytest.mark.slow)])
def test_what_a_term_does_not_show_of_its_constants_is_said(settings):
    times = np.linspace(0, 3, 40)
    decay = simulated(lambda _, s, rate: -rate * s, {"a": (1.0,), "b": (0.7,)}, [[3.0], [1.0]], times, 0.01)
    outcomes = cl.fit(SATURATING, decay, errors="white", **settings).diagnostics
    (outcome,) = (each for each in outcomes if each.kind == "not identifiable")
    assert outcome.where == "a, b"
    assert outcome.code == "parameters-not-separable"
    assert "V and K" in outcome.text


@pytest.mark.slow
def test_bounds_choose_among_values_that_fit_alike():
    text, function, objects, starts, times, states = LAWS["Hill"]
    trials = simulated(function, objects, starts, times, 0.01, states)
    positive, negative = cl.fit(f"{text}; 0 < n < 10", trials), cl.fit(f"{text}; n < 0", trials)
    (values, errors), (others, _) = by_parameter(positive), by_parameter(negative)
    for name, sign in (("n", -1), ("V", -1), ("K", 1)):
        assert (np.abs(values[name] - sign * others[name]) < errors[name] / 2).all()
    assert "; 0 < n < 10" in to_script(positive)
    assert positive.structure == (text,)


def test_values_of_a_stated_law_keep_to_its_bounds():
    with refused("parameter-out-of-bounds", name="K", bound="K > 0"):
        cl.Law.from_text(f"{SATURATING}; K > 0", {"V": 1.0, "K": -2.0})
    assert cl.Law.from_text([SATURATING, "5 >= K"], {"V": 1.0, "K": 2.0}).structure == (SATURATING,)


def test_a_saved_law_without_the_terms_of_its_constants_is_refused(fitted):
    with refused("unknown-name", kind="variable", name="K"):
        from_json(to_json(fitted).replace('"constants": [\n  "K"\n ]', '"constants": []'))
    with refused("parameter-names"):
        cl.Law(fitted.terms.take([0]), fitted.schema, 1, ("a",), np.ones((1, 1, 1)))


def test_what_takes_no_constants_refuses_them(fitted, enzymes):
    with refused("discrepancy-with-parameters", parameters="K"):
        fitted.discrepancy(enzymes)
    with refused("known-physics-variables"):
        cl.discover(enzymes, known="s/(K + s)", order=1, library="poly:3")


@pytest.mark.parametrize(
    ("text", "parameters", "names"),
    [
        ("x' = V x/(K + x)", ("K",), ("V", "K")),
        ("x' = exp(k x)", ("k",), ("k",)),
        ("x' = a^2 (x - b)", ("a",), ("b", "a")),
        ("x' = k (x - a) + k^-1 x^2", ("k",), ("a", "k")),
        ("x' = a x + a", (), ("a",)),
        ("x' = -k (x - a)/(x + K)", ("K",), ("k", "a", "K")),
    ],
)
def test_names_that_are_no_factors_are_constants_of_their_terms(text, parameters, names):
    given = read_equations(text, cl.Schema(("x",)))
    assert {*given.terms.variables.parameters} == {*parameters}
    assert {coefficient.name for coefficient in given.coefficients} == {*names}


@pytest.mark.parametrize(
    ("text", "function", "values"),
    [
        ("x' = V x^n/(K^n + x^n)", lambda x, V, n, K: V * x**n / (K**n + x**n), {"V": 2.0, "n": 1.5, "K": 0.7}),
        ("x' = k (x - a) + k^-1 x^2", lambda x, k, a: k * (x - a) + x**2 / k, {"k": 2.0, "a": -1.0}),
        ("x' = b 2^-q exp(q x) + q", lambda x, b, q: b * 2**-q * np.exp(q * x) + q, {"b": 3.0, "q": 0.3}),
        ("x' = a x^2 + a", lambda x, a: a * x**2 + a, {"a": 2.0}),
        ("x' = r x (1 - x/K)", lambda x, r, K: r * x * (1 - x / K), {"r": 0.5, "K": 8.0}),
        (
            "x' = r x (1 - x/K) (1 - x/L)",
            lambda x, r, K, L: r * x * (1 - x / K) * (1 - x / L),
            {"r": -0.5, "K": 1.0, "L": 4.0},
        ),
        ("x' = -k (x - 20 - a)", lambda x, k, a: -k * (x - 20 - a), {"k": 0.5, "a": 3.0}),
        ("x' = x/(2 tau) + c/tau x^2", lambda x, tau, c: x / (2 * tau) + c / tau * x**2, {"tau": 4.0, "c": -3.0}),
        (
            "x' = q (1 + s (x - 2 u x^2))",
            lambda x, q, s, u: q * (1 + s * (x - 2 * u * x**2)),
            {"q": 2.0, "s": -1.5, "u": 0.7},
        ),
    ],
)
def test_a_law_of_constants_is_the_function_that_is_written(text, function, values):
    law, points = cl.Law.from_text(text, values), np.linspace(0.5, 5.0, 7)
    found = law.rhs("object", np.column_stack([points, 0 * points]))[:, 0]
    np.testing.assert_allclose(found, function(points, **values))
    parameters = named_parameters(law)
    np.testing.assert_allclose(parameters.values[0], [values[name] for name in parameters.names])


@pytest.mark.parametrize(
    ("text", "units"),
    [
        (SATURATING, {"V": "mol/min", "K": "mol"}),
        ("s' = a - b (exp(s/U) - 1)", {"a": "mol/min", "b": "mol/min", "U": "mol"}),
        ("s' = -k s cos(w t + p)", {"k": "1/min", "w": "1/min", "p": ""}),
        ("s' = a - V s^n/(K^n + s^n)", {"a": "mol/min", "n": "", "K": None}),
        ("s' = -k s/(1 + (s/K)^2) + q s (s + L)", {"k": "1/min", "K": "mol", "q": "1/min/mol", "L": "mol"}),
        ("s' = b s^2 + b s", {"b": None}),
    ],
)
def test_constants_have_the_units_that_make_sums_and_functions_possible(text, units):
    names = {each.name for each in read_equations(text, cl.Schema(("s",))).coefficients}
    parameters = named_parameters(cl.Law.from_text(text, dict.fromkeys(names, 1.0), units={"s": "mol", "t": "min"}))
    found = dict(zip(parameters.names, parameters.units, strict=True))
    for name, unit in units.items():
        assert (found[name] is None) == (unit is None), (name, found)
        assert unit is None or parse_unit(found[name] or "dimensionless") == parse_unit(unit or "dimensionless")


@pytest.mark.slow
def test_an_unknown_frequency_and_an_unknown_period_are_found():
    times = np.linspace(0, 40, 80)
    motion = 3 + np.cos(0.3 * times) + 0.5 * np.sin(1.1 * times)
    motion = motion + 0.05 * np.random.default_rng(0).standard_normal(80)
    trials = cl.Trials.from_arrays(times, motion, names=["x"])
    law = cl.fit("x' = a sin(w t + p) + b cos(2 pi t/Q)", trials, errors="white")
    parameters = named_parameters(law)
    values = dict(zip(parameters.names, np.abs(parameters.values[0]), strict=True))
    found = sorted([values["w"], 2 * np.pi / values["Q"]])  # The two may exchange what they stand for
    np.testing.assert_allclose(found, [0.3, 1.1], rtol=0.01)
    assert law.uncertainty.noise[0] == pytest.approx(0.05, rel=0.2)


def test_values_between_two_bounds_are_tried_where_no_others_are():
    times = np.linspace(0, 40, 80)
    motion = np.cos(0.3 * times) + 0.4 * np.cos(1.1 * times)
    motion = motion + 0.02 * np.random.default_rng(0).standard_normal(80)
    trials = cl.Trials.from_arrays(times, motion, names=["x"])
    law = cl.fit("x' = a sin(w t) + b sin(u t); 0.295 < w < 0.305; u > 0.5", trials, errors="white")
    parameters = named_parameters(law)
    values = dict(zip(parameters.names, parameters.values[0], strict=True))
    assert values["w"] == pytest.approx(0.3, abs=0.005)
    assert values["u"] == pytest.approx(1.1, abs=0.01)


def test_a_fit_begins_at_guesses():
    times = np.arange(0, 30, 1.0)
    motion = np.cos(0.9 * times) + 0.01 * np.random.default_rng(0).standard_normal(30)
    trials, found = cl.Trials.from_arrays(times, motion, names=["x"]), {}
    for guess in (None, 0.6):
        law = cl.fit("x' = a sin(w t + p)", trials, guesses=guess and {"w": guess}, errors="white")
        found[guess] = dict(zip(named_parameters(law).names, named_parameters(law).values[0], strict=True))["w"]
    assert found[None] == pytest.approx(0.9, abs=0.002)
    assert found[0.6] == pytest.approx(0.6, abs=0.05)  # Another local optimum, as was asked for
    assert "guesses={'w': 0.6}" in to_script(law).replace('"', "'")
    with refused("unknown-name", kind="coefficient", name="v"):
        cl.fit("x' = a sin(w t + p)", trials, guesses={"v": 0.9})
    with refused("guess-out-of-bounds", name="w", value=3):
        cl.fit("x' = a sin(w t + p); w < 2", trials, guesses={"w": 3})


def test_combinations_of_many_parameters_are_drawn():
    values = grid_product([np.arange(26.0)] * 20)
    assert values.shape == (settings.MAX_COMBINATIONS, 20)
    assert values.mean() == pytest.approx(12.5, abs=0.1)
    assert grid_product([np.array([1.0, 2.0]), np.array([3.0, 4.0])]).tolist() == [[1, 3], [1, 4], [2, 3], [2, 4]]


@pytest.mark.parametrize("text", [pytest.param("x' = tan(0.5/w)", marks=pytest.mark.slow), "x' = exp(w x)"])
def test_parameters_at_the_end_of_numbers_are_refused_without_a_warning(text):
    """The angle is constant; the variance overflows."""
    times = np.linspace(0, 2, 12)
    with refused("parameters-not-identified", names=["w"]):
        cl.fit(text, cl.Trials.from_arrays(times, 50 - 4.9 * times**2, names=["x"]), errors="white")


def test_a_power_that_is_infinite_at_a_sample_is_refused_without_a_warning():
    times = np.linspace(0, 0.7, 6)
    with refused("terms-nowhere-finite"):
        cl.fit("x' = abs(t)^a", cl.Trials.from_arrays(times, 21 + np.exp(9 * times), names=["x"]))


def test_terms_whose_squares_overflow_are_refused_without_a_warning():
    falling = cl.Trials.from_arrays([0.0, 0.5, 1.0], [5.1, -2.1, -3.2], names=["x"])
    with refused("parameters-not-identified"):
        cl.fit("x' = exp(-k t)", falling)
    driven = cl.Trials.from_arrays(np.arange(3) / 3, [100.0, 74.1, 54.9], inputs=[0.0, 0.84, 0.91], names=["x", "u"])
    with refused("terms-nowhere-finite"):
        cl.fit("x'' = u^k", driven)
