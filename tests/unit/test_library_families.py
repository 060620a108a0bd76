"""Families of terms: which terms, in which order, under which names; those with a cap; forces towards a centre."""

import math

import numpy as np
import pytest

from commonlaw.diagnostics import Diagnostic
from commonlaw.inference.propose.integral_ranking import CandidateSupport
from commonlaw.inference.propose.parametric import reflected
from commonlaw.library import (
    AutoLibrary,
    CappedLibrary,
    ConstantLibrary,
    ExpressionLibrary,
    FourierLibrary,
    PolynomialLibrary,
    RationalLibrary,
    Terms,
    Variables,
    parametric_term,
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


VARIABLES = Variables(("x",), ("u",))


@pytest.mark.parametrize(
    ("library", "count", "names"),
    [
        ("poly:3", 2, ["1", "x", "u", "x^2", "x u", "x^3", "x^2 u"]),
        ("poly:3", 3, ["1", "x", "u", "x^2", "x u", "u^2", "x^3", "x^2 u", "x u^2"]),
        ("poly:2", 1, ["1", "x", "x^2"]),
        ("terms:x,u^2", 2, ["x", "u^2"]),
    ],
)
def test_powers_go_that_are_sums_of_lower_ones_in_the_library(library, count, names):
    terms = CappedLibrary(parse_library(library), (("u", count),)).bind(VARIABLES)
    assert list(terms.names) == names


def test_what_goes_is_what_measurements_cannot_tell():
    generator = np.random.default_rng(0)
    values = np.column_stack([generator.standard_normal(50), generator.choice([0.3, 2.0], 50), np.arange(50.0)])
    whole = parse_library("poly:3")
    capped = CappedLibrary(whole, (("u", 2),))
    columns, fewer = (each.bind(VARIABLES).evaluate(values) for each in (whole, capped))
    assert np.linalg.matrix_rank(columns) == np.linalg.matrix_rank(fewer) == fewer.shape[1] < columns.shape[1]


def test_what_is_offered_besides_stays():
    capped = CappedLibrary(AutoLibrary(), (("u", 2),))
    assert [each.count for each in capped.offers(VARIABLES)] == [each.count for each in AutoLibrary().offers(VARIABLES)]
    assert capped.higher is not None
    assert "u^4" not in capped.higher.bind(VARIABLES).names
    assert capped.higher.higher is None
    assert capped.seeks_latent_states


PLANE = Variables(("x", "y", "v_x", "v_y"))


def test_positions_and_velocities_are_vectors():
    texts = [each.text(PLANE) for each in parse_library("central").parametric(PLANE)]
    assert len(texts) == 16
    assert {"x*(x^2 + y^2)^p", "y/(x^2 + y^2)^1.5", "v_x*sqrt(v_x^2 + v_y^2)"} <= {*texts}
    assert not any("y^2 + v_x" in text for text in texts)
    named = [each.text(PLANE) for each in parse_library("central:x,y").parametric(PLANE)]
    assert named == texts[:8]


def test_the_exponent_is_called_otherwise_where_a_variable_is():
    variables = Variables(("p", "q"))
    assert parse_library("central").parametric(variables)[0].text(variables) == "p*(p^2 + q^2)^p2"


def test_a_single_state_has_no_direction():
    assert parse_library("central:x").parametric(PLANE) == ()
    assert len([*AutoLibrary().offers(Variables(("x", "v")))]) + 1 == len([*AutoLibrary().offers(PLANE)])


@pytest.mark.parametrize("constant", [0.5, 2.0])
def test_of_a_sigmoid_beside_a_constant_the_form_without_is_proposed(constant):
    variables = Variables(("x",))
    terms = PolynomialLibrary(1).bind(variables)
    sigmoid = parametric_term("1/(1 + exp(-(a*x + c)))", variables)
    row = CandidateSupport((0, 1), (sigmoid,), (np.array([[constant, -1.0, -constant, 3.0, 0.2]]),))
    (found,) = reflected(terms, row)
    assert (found.plain, found.others) == ((1,), (sigmoid,))
    (start,) = found.starts
    points = np.column_stack([np.linspace(-2, 2, 9), np.zeros(9)])

    def rates(coefficients, parameters):
        values = np.column_stack([points, np.tile(parameters, (9, 1))])
        return coefficients[0] * points[:, 0] + coefficients[1] * sigmoid.term.evaluate(values)

    before = constant + rates([-1.0, -constant], [3.0, 0.2])
    np.testing.assert_allclose(rates(start[0, :2], start[0, 2:]), before, rtol=1e-12)
    other = parametric_term("x/(K + x)", variables)
    assert not [*reflected(terms, CandidateSupport((0,), (other,), (np.ones((1, 3)),)))]
