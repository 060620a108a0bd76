"""Ratios of two sums of terms: how they are offered and written, and the laws of discover that have some."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import curve_fit
from scipy.special import lambertw

import commonlaw as cl
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.propose.rational import rank_ratios
from commonlaw.law import Provenance, to_latex, to_script
from commonlaw.law.parameters import named_parameters
from commonlaw.library import PolynomialLibrary, RatioLibrary, Terms, Variables, parse_library, parse_term
from tests.refusals import refused
from tests.simulations import simulated

S = Variables(("s",))
ENZYMES = {"a": (1.0, 0.7), "b": (2.0, 1.5), "c": (1.5, 1.0)}
QUADRATIC = "ratio(poly:2, poly:2)"


@pytest.fixture(scope="module")
def enzymes():
    times = np.linspace(0, 6, 40)
    return simulated(lambda _, s, rate, half: -rate * s / (half + s), ENZYMES, [[5.0], [2.5]], times, 0.01)


def test_a_text_names_ratios_of_two_libraries_alone_or_in_a_sum():
    assert parse_library(QUADRATIC) == RatioLibrary(PolynomialLibrary(2), PolynomialLibrary(2))
    library = parse_library("poly:1 + ratio(poly:2 + terms:s**3, poly:1)")
    (ratios,) = library.ratios(S)
    named = [tuple(each.text(("s", "t")) for each in side) for side in (ratios.above, ratios.below, ratios.added)]
    assert named == [("1", "s", "s^2", "s^3"), ("1", "s"), ("1", "s")]
    (ratios,) = parse_library("poly:1 * ratio(poly:1, poly:1)").ratios(S)
    assert [each.text(("s", "t")) for each in ratios.above] == ["1", "s", "s^2"]


@pytest.mark.parametrize("text", ["ratio(poly:2)", "ratio(poly:2, poly:2, poly:2)", "ratio(poly:2, poly:2"])
def test_a_text_that_is_no_ratio_of_two_libraries_is_refused(text):
    with refused("ratio-syntax"):
        parse_library(text)


def test_a_denominator_of_one_term_is_refused():
    with refused("denominator-one-term"):
        parse_library("ratio(poly:2, constant)").ratios(S)


@pytest.mark.parametrize(
    ("above", "below", "coefficients", "written", "parameters"),
    [
        ([1], [0, 1], [2.0, 4.0], ["(s)/(K + s)"], [0.5]),
        ([2], [0, 2], [1.0, 4.0], ["(s**2)/(K**2 + s**2)"], [0.5]),
        ([1, 2], [0, 1, 2], [1.0, 4.0, 2.0], ["(s)/(K + s + L*s**2)", "(s**2)/(K + s + L*s**2)"], [0.25, 0.5]),
        ([1], [0, 2], [-1.0, 4.0], ["(s)/(K**2 + s**2)"], None),
        ([1], [0, 1, 2], [1.0, 0.1, 4.0], ["(s)/(K + L*s + s**2)"], [0.25, 0.025]),
    ],
)
def test_the_largest_coefficient_below_before_a_variable_is_one(above, below, coefficients, written, parameters):
    (ratios,) = parse_library(QUADRATIC).ratios(S)
    ratio = ratios.ratio(above, below, S, np.abs(coefficients))
    assert ratio.expressions(S, ratio.shared_parameters) == written
    assert ratio.values_of_parameters(np.array(coefficients)) == parameters


def test_a_denominator_that_terms_share_counts_once():
    variables = Variables(("s",), parameters=("K",))
    terms = Terms(variables, tuple(parse_term(each, variables) for each in ("s/(K + s)", "s**2/(K + s)", "1/(1 + s)")))
    assert terms.complexities.tolist() == [3, 2, 1]


def test_a_term_whose_coefficient_is_known_in_an_equation_is_not_beside_its_ratios(enzymes):
    table = enzymes.to_frame()
    table["p"] = 6 * np.exp(-0.5 * table["t"]) + 0.1 * table["s"]
    trials = cl.Trials.from_frame(table, object="object", trial="trial", time="t", states=["s", "p"])
    variables = Variables(("s", "p"))
    terms, known = PolynomialLibrary(1).bind(variables), np.full((3, 2, 3), np.nan)
    known[:, 1, terms.index("p")] = 0.0
    problem = prepare(trials, terms, known)
    ratios = parse_library("poly:1 + ratio(poly:1, poly:1)").ratios(variables)
    found = rank_ratios(problem, problem.starts, ratios, {0: 7, 1: 7})
    of_s, of_p = ({k for each in own for k in each.plain} for own in found.values())
    assert terms.index("p") not in of_p
    assert of_s


def test_fractions_of_one_denominator_are_written_as_one():
    given = "s' = -c s + (a + b s)/(K + s)"
    law = cl.Law.from_text(given, {"a": 0.5, "b": -1.5, "K": 2.0, "c": 0.1})
    found = replace(law, provenance=Provenance())
    assert found.structure == ("s' = a s + (b + c s)/(K + s)",)
    assert found.equations() == ("s' = -0.1 s + (0.5 - 1.5 s)/(2 + s)",)
    assert r"\frac{0.5 - 1.5\, s}{K + s}" in to_latex(found)
    again = cl.Law.from_text(found.structure, {"a": -0.1, "b": 0.5, "c": -1.5, "K": 2.0})
    states = np.array([[0.3, 0.0], [4.0, 0.0]])
    np.testing.assert_allclose(again.rhs("object", states), law.rhs("object", states))


def test_they_agree_with_least_squares_on_the_exact_solution(tmp_path):
    times, noise = np.linspace(0, 6, 60), 0.05

    def solution(t, start, rate, half):
        return half * lambertw(start / half * np.exp((start - rate * t) / half)).real

    measured = solution(times, 4.0, 1.0, 0.8) + noise * np.random.default_rng(3).standard_normal(len(times))
    trials = cl.Trials.from_frame(pd.DataFrame({"t": times, "s": measured}), time="t", states=["s"])
    law = cl.discover(
        trials, library=QUADRATIC, method=cl.TrajectoryLikelihood(noise={"s": noise}), cache=False, order=1
    )
    assert law.structure == ("s' = a s/(K + s)",)
    expected, covariance = curve_fit(solution, times, measured, [4.0, 1.0, 1.0], np.full(60, noise), True)
    parameters = named_parameters(law)
    values, errors = parameters.values, parameters.errors
    np.testing.assert_allclose(values[0], expected[1:] * [-1, 1], rtol=1e-4)
    np.testing.assert_allclose(errors[0], np.sqrt(np.diag(covariance))[1:], rtol=0.01)
    law.save(tmp_path / "law.json")
    assert cl.Law.load(tmp_path / "law.json").equations() == law.equations()
    assert 'library="ratio(poly:2, poly:2)"' in to_script(law).replace("'", '"')


def test_a_law_whose_constants_trials_do_not_tell_is_not_taken():
    objects = {"a": (1.0,), "b": (0.7,), "c": (0.5,)}
    decay = simulated(lambda _, s, rate: -rate * s, objects, [[5.0], [2.5]], np.linspace(0, 5, 40), 0.05)
    assert cl.discover(decay, library="poly:1 + terms:s/(K+s)", cache=False, order=1).structure == ("s' = a s",)


def test_a_method_that_finds_no_constants_refuses_ratios(enzymes):
    with refused("parametric-terms-unsupported", term="ratios of sums", method="DerivativeRegression"):
        cl.discover(enzymes, library=QUADRATIC, method=cl.DerivativeRegression(), order=1)
