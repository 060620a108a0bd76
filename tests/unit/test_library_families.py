"""The families of terms: which terms, in which order, under which names."""

import math

import numpy as np
import pytest

from commonlaw.diagnostics import Diagnostic
from commonlaw.library import (
    ConstantLibrary,
    ExpressionLibrary,
    FourierLibrary,
    PolynomialLibrary,
    RationalLibrary,
    Terms,
    Variables,
    parse_library,
)
from tests.refusals import refused

XV = Variables(("x", "v"))


def test_polynomial_is_ordered_by_degree_as_in_the_field():
    names = PolynomialLibrary(3).bind(XV).names
    assert names == ("1", "x", "v", "x^2", "x v", "v^2", "x^3", "x^2 v", "x v^2", "v^3")


@pytest.mark.parametrize(("count", "degree"), [(1, 5), (2, 3), (3, 5), (4, 4)])
def test_polynomial_has_as_many_terms_as_there_are_monomials(count, degree):
    variables = Variables(tuple(f"x{i}" for i in range(count)))
    terms = PolynomialLibrary(degree).bind(variables)
    assert len(terms) == len(set(terms.terms)) == math.comb(count + degree, degree)


def test_polynomial_leaves_out_constant_and_interactions_when_asked():
    assert PolynomialLibrary(2, constant=False).bind(XV).names == ("x", "v", "x^2", "x v", "v^2")
    assert PolynomialLibrary(2, interactions=False).bind(XV).names == ("1", "x", "v", "x^2", "v^2")


def test_families_use_states_and_inputs_but_time_only_by_name():
    variables = Variables(("x",), ("u",))
    assert PolynomialLibrary(1).bind(variables).names == ("1", "x", "u")
    assert FourierLibrary().bind(variables).names == ("sin(x)", "cos(x)", "sin(u)", "cos(u)")
    assert PolynomialLibrary(2, ["t"]).bind(variables).names == ("1", "t", "t^2")
    assert FourierLibrary(1, ("t",)).bind(variables).names == ("sin(t)", "cos(t)")


def test_rational_divides_every_monomial_and_cancels_common_powers():
    assert RationalLibrary(1, "1 + x^2").bind(XV).names == ("1/(1 + x^2)", "x/(1 + x^2)", "v/(1 + x^2)")
    assert RationalLibrary(1, "x").bind(XV).names == ("1/x", "1", "v/x")
    assert RationalLibrary(1, "x*(1+v)").bind(XV).names == ("1/(x (1 + v))", "1/(1 + v)", "v/(x (1 + v))")


def test_expressions_keep_their_order_and_appear_once():
    assert ExpressionLibrary("v*abs(v)", "1", "abs(v)*v").bind(XV).names == ("v*abs(v)", "1")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: PolynomialLibrary(-1), Diagnostic("whole-number", {"value": -1, "bounds": "from 0 to 100"})),
        (lambda: PolynomialLibrary(2.5), Diagnostic("whole-number", {"value": 2.5, "bounds": "from 0 to 100"})),
        (lambda: PolynomialLibrary(0, constant=False), "polynomial-empty"),
        (lambda: PolynomialLibrary(2, ()), Diagnostic("library-variables", {"variables": "none"})),
        (lambda: PolynomialLibrary(2, ("x", "x")), "library-variables"),
        (lambda: PolynomialLibrary(2, ("y",)).bind(XV), Diagnostic("unknown-name", {"kind": "variable", "name": "y"})),
        (
            lambda: PolynomialLibrary(30).bind(Variables(tuple("abcdefgh"))),
            Diagnostic("library-too-large", {"count": 48903492}),
        ),
        (lambda: FourierLibrary(0), Diagnostic("whole-number", {"value": 0, "bounds": "from 1 to 1000"})),
        (lambda: RationalLibrary(2, "y").bind(XV), Diagnostic("unknown-name", {"kind": "variable", "name": "y"})),
        (ExpressionLibrary, "expressions-empty"),
    ],
)
def test_what_a_family_cannot_be_is_refused(make, message):
    with refused(message):
        make()


def test_terms_are_found_by_name_whatever_the_spaces_and_stars():
    terms = PolynomialLibrary(3).bind(XV)
    assert [terms.index(name) for name in ("x^2 v", "x^2v", "x**2*v", "x**2 * v")] == [7, 7, 7, 7]
    with refused("unknown-name", kind="term", name="x^2 u"):
        terms.index("x^2 u")


def test_an_exact_name_wins_over_one_that_differs_in_spaces():
    terms = PolynomialLibrary(2).bind(Variables(("xv", "x", "v")))
    assert (terms.index("xv"), terms.names[terms.index("x v")]) == (1, "x v")


def test_select_and_without_keep_and_drop_by_name():
    library = PolynomialLibrary(2)
    assert library.select("v", "1", "x*v", "v").bind(XV).names == ("v", "1", "x v")
    assert library.without("x^2", "xv").bind(XV).names == ("1", "x", "v", "v^2")
    assert library.select("x", "v").without("x").bind(XV).names == ("v",)


@pytest.mark.parametrize(
    ("library", "message"),
    [
        (PolynomialLibrary(2).without("x^4"), Diagnostic("unknown-name", {"kind": "term", "name": "x^4"})),
        (PolynomialLibrary(2).select("x^4"), Diagnostic("unknown-name", {"kind": "term", "name": "x^4"})),
        (PolynomialLibrary(2).select(), "no-term-selected"),
        (ConstantLibrary().without("1"), "no-term-left"),
    ],
)
def test_a_selection_that_cannot_be_made_is_refused(library, message):
    with refused(message):
        library.bind(XV)


@pytest.mark.parametrize(
    ("text", "library"),
    [
        ("poly:3", PolynomialLibrary(3)),
        ("poly:2:x,t:interactions=False", PolynomialLibrary(2, ("x", "t"), interactions=False)),
        ("fourier:2", FourierLibrary(2)),
        ("rational:2:1+x**2", RationalLibrary(2, "1+x**2")),
        ("terms:1", ExpressionLibrary("1")),
        ("terms:1,v,v*abs(v)", ExpressionLibrary("1", "v", "v*abs(v)")),
        ("terms:`a,b`,x", ExpressionLibrary("`a,b`", "x")),
        ("constant", ConstantLibrary()),
        ("poly:2 + fourier:1", PolynomialLibrary(2) + FourierLibrary(1)),
        ("constant + poly:1 * terms:abs(v)", ConstantLibrary() + PolynomialLibrary(1) * ExpressionLibrary("abs(v)")),
    ],
)
def test_a_library_is_read_from_its_text(text, library):
    assert parse_library(text) == library


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("polly:3", Diagnostic("unknown-name", {"kind": "library", "name": "polly"})),
        ("poly:3:4:5:6:7", "spec-syntax"),
        ("poly:x", Diagnostic("whole-number", {"value": "x", "bounds": "from 0 to 100"})),
        ("fourier:1 + x", Diagnostic("unknown-name", {"kind": "library", "name": "x"})),
    ],
)
def test_a_library_text_that_makes_no_sense_is_refused(text, message):
    with refused(message):
        parse_library(text)


def test_libraries_are_values():
    assert hash(PolynomialLibrary(2, ["x"])) == hash(PolynomialLibrary(2, ("x",)))
    assert len({parse_library("poly:2 + fourier:1"), PolynomialLibrary(2) + FourierLibrary(1)}) == 1


def test_no_terms_are_a_matrix_without_columns():
    terms = Terms(XV, ())
    assert terms.evaluate(np.zeros((5, 3))).shape == (5, 0)
    assert terms.jacobian(np.zeros((5, 3))).shape == (5, 0, 3)
