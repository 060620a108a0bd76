"""Equations that are fitted: what names in them mean, and coefficients in parentheses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.law import from_json, to_frame, to_json, to_latex
from commonlaw.law.parameters import left_hand_sides, named_parameters, reach_of_equations
from commonlaw.law.parse import read_equations
from commonlaw.law.tables import coefficient_rows
from commonlaw.law.text import with_error
from tests.refusals import refused

X = cl.Schema(("x",))


@pytest.fixture(scope="module")
def cups():
    """Return two cups that cool with k = 0.1 and 0.2 to a = 20 and 15 degrees; exact solutions and noise."""
    rng, t = np.random.default_rng(0), np.linspace(0.0, 30.0, 25)
    states = [a + (80.0 - a) * np.exp(-k * t) + rng.normal(0.0, 0.1, 25) for k, a in ((0.1, 20.0), (0.2, 15.0))]
    units = {"T": "degC", "t": "min"}
    return cl.Trials.from_arrays([t, t], states, object=["cup", "mug"], names=["T"], units=units)


@pytest.fixture(scope="module")
def law(cups):
    return cl.fit("T' = -k (T - a)", cups, errors="white", noise={"T": 0.1}, partial_pooling=False)


def test_coefficients_in_parentheses_are_multiplied_out_and_found(law):
    assert law.terms.names == ("T", "1")
    assert named_parameters(law).names == ("k", "a")
    values, errors = named_parameters(law).values, named_parameters(law).errors
    truth = np.array([[0.1, 20.0], [0.2, 15.0]])
    assert (errors > 0).all()
    assert (abs(values - truth) < 4 * errors).all()
    np.testing.assert_allclose(law.coefficients[:, 0, 1], values[:, 0] * values[:, 1])


def test_standard_errors_of_coefficients_in_parentheses_are_those_of_draws(law):
    errors = named_parameters(law).errors
    scatter = law.sample(4000, seed=1).groupby("object").std().loc[list(law.objects)]
    np.testing.assert_allclose(errors, scatter.to_numpy(), rtol=0.06)


def test_a_law_prints_and_states_the_coefficients_of_its_text(law):
    assert str(law).startswith("T' = -k (T - a)")
    assert named_parameters(law).units == ("1/min", "°C")
    stated = cl.Law.from_text("T' = -k (T - a)", {"k": 0.1, "a": 20.0})
    assert stated.equations() == ("T' = -0.1 (T - 20)",)
    assert "with k = 0.1, a = 20" in str(stated)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x' = (k + m) (x - 20)", Diagnostic("term-twice", {"term": "x - 20"})),
        ("x' = (a + b x)/tau", "product-of-parameters"),
        ("x' = " + "*".join("(a + b x)" for _ in range(20)), Diagnostic("too-many-summands", {"limit": 200})),
        ("x' = a x + e", "letter-e"),
    ],
)
def test_what_cannot_be_multiplied_out_is_refused_in_words(text, message):
    with refused(message):
        read_equations(text, X)


@pytest.mark.parametrize(("column", "name"), [("time", "t"), ("t", "time"), ("hours", "t")])
def test_t_and_time_are_the_time_whatever_its_column_is_called(column, name):
    given = read_equations(f"x' = -k x + a sin(2 {name}) + b {name}", cl.Schema(("x",), time=column))
    assert given.terms.names == ("x", f"sin(2 {column})", column)


def test_pi_is_a_number_unless_it_is_measured():
    given = read_equations("x' = pi x + a sin(2 pi t)", X)
    assert given.known[0, 0] == np.pi
    np.testing.assert_allclose(given.terms.evaluate(np.array([[1.0, 0.25]]))[0, 1], 1.0)
    assert read_equations("x' = a pi", cl.Schema(("x",), inputs=("pi",))).terms.names == ("pi",)


def test_v_that_was_measured_is_not_taken_for_the_rate_nor_the_rate_for_it():
    schema = cl.Schema(("x",), inputs=("v",))
    with refused("rate-or-column", name="v", state="x"):
        read_equations("x'' = -g - c v", schema)
    assert read_equations("x'' = -g - c x'", schema).terms.names == ("1", "x_rate")
    assert read_equations("x'' = -g - c `v`", schema).terms.names == ("1", "v")
    assert read_equations("x' = a v", schema).terms.names == ("v",)


def test_a_property_in_an_equation_has_the_value_of_its_object():
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.3), trials=1, samples=40, noise=0.02)
    law = cl.fit("x'' = -g + drag v", drops, errors="white", noise={"x": 0.02})
    parameters = named_parameters(law)
    values, errors = parameters.values, parameters.errors
    assert values[:, 1].tolist() == [drops.properties[name]["drag"] for name in law.objects] == [-0.1, -0.3]
    assert (errors[:, 1] == 0).all()
    assert (errors[:, 0] > 0).all()
    assert ("property", "drag") in [(each.stage, each.choice) for each in law.history]


def test_counts_that_make_no_sense_are_refused(law, cups):
    for count in (-1, 0, 10**18):
        with refused("whole-number", name="n"):
            law.sample(count)
        with refused("curve-points"):
            law.predict(cups).smooth(count)


def test_laws_are_compared_in_a_list_too(law, cups):
    frame = cl.compare(
        [law, cl.Law.from_text("T' = -k (T - 20)", {"k": {"cup": 0.1, "mug": 0.2}})], cups, errors="white"
    )
    assert frame["law"].tolist() == ["law 1", "law 2"]
    for wrong in ([], ["T' = a"], {"a": None}):
        with refused("laws-without-names"):
            cl.compare(wrong, cups)


def test_a_known_coefficient_that_is_no_number_is_refused_in_words(cups):
    known: Any = {"T": "0.01/min"}
    with refused("known-coefficient-not-a-number"):
        cl.discover(cups, order=1, library="poly:1", known=known)


def test_intervals_have_units(law):
    assert law.params["unit"].tolist() == ["1/min", "°C"] * 2


def fieller(constant, slope, covariance, reach):
    """Return the interval of the ratio -constant/slope of two coefficients (Fieller 1954)."""
    errors = reach**2 * covariance * [[1, -1], [-1, 1]]
    products = np.outer([-constant, slope], [-constant, slope]) - errors
    return sorted(np.roots([products[1, 1], -2 * products[0, 1], products[0, 0]]))


def test_parameters_of_equations_are_in_every_form_of_the_law(law):
    from commonlaw.plots.equations import equation_lines
    from commonlaw.plots.law import DotPlot

    for each in (law, from_json(to_json(law))):
        table = each.params
        assert table["parameter"].tolist() == ["k", "a"] * 2
        values, errors = named_parameters(each).values, named_parameters(each).errors
        np.testing.assert_array_equal(table["estimate"], values.ravel())
        (reach,) = reach_of_equations(each)  # Of Student's t distribution
        ends = table[["low", "high"]].to_numpy().reshape(2, 2, 2)
        np.testing.assert_allclose(ends[:, 0], values[:, :1] + errors[:, :1] * [-reach, reach])
        for o, covariance in enumerate(each.uncertainty.covariance):
            slope, constant = each.coefficients[o, 0]
            expected = fieller(constant, slope, covariance[::-1, ::-1], reach)
            np.testing.assert_allclose(ends[o, 1], expected, rtol=1e-6)
        assert to_frame(each).columns.tolist() == ["k", "a"]
        np.testing.assert_array_equal(coefficient_rows(each)["value"], table["estimate"])
        np.testing.assert_array_equal(to_frame(each, errors=True)["a ±"], errors[:, 1])
        assert to_latex(each, "cup").splitlines()[1:4] == [
            r"\dot{T} &= -k \left(T - a\right) \\",
            *(rf"{name} &= {with_error(*pair).replace('±', chr(92) + 'pm')}{end}"
              for name, pair, end in zip("ka", zip(values[0], errors[0], strict=True), (r" \\", ""), strict=True)),
        ]  # fmt: skip
        k, a = (with_error(*pair, bracket=True) for pair in zip(values[1], errors[1], strict=True))
        assert each.equations("mug") == (f"T' = -{k} (T - {a})",)
        assert [panel.name for panel in DotPlot(each).coefficients] == ["k", "a"]
        assert "a" in equation_lines(each)


def test_numbers_that_are_negative_turn_the_sign_before_them():
    law = cl.Law.from_text("x' = a - b x + c x^p - d^2 x^3", {"a": -1.5, "b": -2.0, "c": 3.0, "d": -4.0, "p": -0.5})
    assert law.equations() == ("x' = -1.5 + 2 x + 3 x^(-0.5) - (-4)^2 x^3",)
    again = cl.Law.from_text(law.equations()[0])
    np.testing.assert_allclose(again.rhs("object", [[2.0, 0.0]]), law.rhs("object", [[2.0, 0.0]]))


def test_a_column_whose_name_ends_in_a_prime_stands_between_backticks():
    """Without them its derivative would be the second one of another variable."""
    trials = cl.Trials.from_arrays(np.arange(9.0), np.exp(-0.3 * np.arange(9.0)), names=["x'"])
    law = cl.fit("`x'`' = -k `x'`", trials)
    assert left_hand_sides(law) == ("`x'`'",)
    assert law.terms.names == ("`x'`",)
    learned = replace(law, provenance=replace(law.provenance, equations=()))
    assert cl.Law.from_text(learned.equations(errors=False)).schema.states == ("x'",)
