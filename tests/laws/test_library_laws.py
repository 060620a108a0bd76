"""What holds for every term and every library."""

import numpy as np
import pytest
import sympy
from hypothesis import assume, given, settings, strategies as st

from commonlaw.errors import CommonlawError
from commonlaw.library import (
    ConstantLibrary,
    ExpressionLibrary,
    FourierLibrary,
    PolynomialLibrary,
    RationalLibrary,
    Terms,
    Variables,
    parse_term,
)
from commonlaw.library.grammar import FUNCTIONS, OPERATIONS, SHORT_NAMES

VARIABLES = Variables(("x", "v"), ("u",))
SYMBOLS = sympy.symbols("x v u t", real=True)
VALUES = np.random.default_rng(7).uniform(0.3, 1.7, (40, 4)) * np.array([1, -1, 1, 1])
LIBRARIES = (
    ConstantLibrary(),
    PolynomialLibrary(3),
    FourierLibrary(2, ("x", "t")),
    RationalLibrary(2, "1 + x^2", ("x", "v")),
    ExpressionLibrary("v*abs(v)", "tanh(x)", "x", "1/v"),
)

SMOOTH = sorted(set(FUNCTIONS) - {"sign", "floor", "ceil", "arctan2"})
"""Functions of one argument whose derivative SymPy finds."""
SYMPY = {name: getattr(sympy, name, None) for name in FUNCTIONS} | {
    **{name: getattr(sympy, short) for short, name in SHORT_NAMES.items()},
    "abs": sympy.Abs,
    "step": sympy.Heaviside,
    "log10": lambda x: sympy.log(x, 10),
    "log2": lambda x: sympy.log(x, 2),
    "ceil": sympy.ceiling,
}

leaves = st.sampled_from(["x", "v", "u", "t", "1", "2", "0.5", "sin(x)", "cos(3*v)", "abs(v)"])


def _joined(inner):
    binary = st.builds("({} {} {})".format, inner, st.sampled_from(["+", "-", "*", "/"]), inner)
    power = st.builds("({})**{}".format, inner, st.sampled_from(["2", "3", "-1", "0.5", "(1/3)"]))
    call = st.builds("{}({})".format, st.sampled_from(SMOOTH), inner)
    return binary | power | call | st.builds("(-{})".format, inner)


expressions = st.recursive(leaves, _joined, max_leaves=6)


def _read(text):
    """Return the term, or give the example up if the text is refused (numeric factors, parameters that overflow)."""
    try:
        return parse_term(text, VARIABLES)
    except CommonlawError:
        assume(False)


def _numbers(form):
    function = sympy.lambdify(SYMBOLS, form, [{"DiracDelta": np.zeros_like}, "scipy", "numpy"])
    with np.errstate(all="ignore"):
        return np.broadcast_to(function(*VALUES.T), len(VALUES))


def _tame(array):
    return np.isrealobj(array) and bool(np.all(np.isfinite(array)) and np.all(np.abs(array) < 1e6))


@settings(max_examples=100, derandomize=True)
@given(expressions)
def test_values_agree_with_python_and_numpy(text):
    term = _read(text)
    functions = {name: lambda x, name=name: OPERATIONS[name](np.float64(x)) for name in FUNCTIONS}
    with np.errstate(all="ignore"):
        # The texts are this module's own, so Python may run them.
        expected = eval(text, functions, dict(zip(VARIABLES.names, VALUES.T, strict=True)))
    assume(_tame(expected))
    np.testing.assert_allclose(term.evaluate(VALUES), np.broadcast_to(expected, len(VALUES)), rtol=1e-9, atol=1e-9)


@settings(max_examples=100, derandomize=True)
@given(expressions)
def test_gradient_agrees_with_sympy(text):
    term = _read(text)
    form = sympy.parse_expr(text, local_dict={**SYMPY, **dict(zip(VARIABLES.names, SYMBOLS, strict=True))})
    # SymPy and the term differ in what they cancel where nothing is defined, as in (x - x)**0.5.
    assume(not form.has(sympy.nan, sympy.zoo) and _tame(term.gradient(VALUES)))
    slopes = np.column_stack([_numbers(sympy.diff(form, symbol)) for symbol in SYMBOLS])
    assume(_tame(slopes))
    np.testing.assert_allclose(term.gradient(VALUES), slopes, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("function", SMOOTH)
@pytest.mark.parametrize("argument", ["x", "0.3*x + v**2/(1 + u)", "x**1.5", "2 - v/3"])
def test_every_function_has_the_derivative_that_sympy_finds(function, argument):
    term = parse_term(f"{function}({argument})", VARIABLES)
    form = term.sympy(SYMBOLS)
    slopes = np.column_stack([_numbers(sympy.diff(form, symbol)) for symbol in SYMBOLS])
    np.testing.assert_allclose(term.evaluate(VALUES), _numbers(form), rtol=1e-12)
    np.testing.assert_allclose(term.gradient(VALUES), slopes, rtol=1e-10, atol=1e-12)


@settings(max_examples=100)
@given(expressions)
def test_reading_what_a_term_writes_gives_the_term(text):
    term = _read(text)
    assert parse_term(term.expression(VARIABLES.names), VARIABLES) == term


@given(st.text(alphabet="xvut()+-*/^. 129e,_`'sinabq\n\t", max_size=40) | st.text(max_size=40))
def test_any_text_is_read_or_refused_and_nothing_else(text):
    try:
        term = parse_term(text, VARIABLES)
    except CommonlawError:
        return
    assert term.evaluate(VALUES).shape == (len(VALUES),)


@pytest.mark.parametrize("library", LIBRARIES)
def test_terms_evaluated_together_equal_each_alone(library):
    terms = library.bind(VARIABLES)
    matrix, jacobian = terms.evaluate(VALUES), terms.jacobian(VALUES)
    assert matrix.shape == (len(VALUES), len(terms))
    assert jacobian.shape == (len(VALUES), len(terms), 4)
    for i, term in enumerate(terms.terms):
        assert np.array_equal(matrix[:, i], term.evaluate(VALUES))
        np.testing.assert_allclose(jacobian[:, i], term.gradient(VALUES), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("library", LIBRARIES)
def test_values_do_not_depend_on_the_other_terms_nor_on_the_other_rows(library):
    terms = library.bind(VARIABLES)
    matrix = terms.evaluate(VALUES)
    some = list(range(len(terms)))[::-2]
    assert np.array_equal(terms.take(some).evaluate(VALUES), matrix[:, some])
    np.testing.assert_allclose(terms.evaluate(VALUES[5:6]), matrix[5:6], rtol=1e-14)


@pytest.mark.parametrize("library", LIBRARIES)
def test_jacobian_agrees_with_sympy_and_with_central_differences(library):
    terms = library.bind(VARIABLES)
    jacobian = terms.jacobian(VALUES)
    for i, term in enumerate(terms.terms):
        exact = [_numbers(sympy.diff(term.sympy(SYMBOLS), symbol)) for symbol in SYMBOLS]
        np.testing.assert_allclose(jacobian[:, i], np.column_stack(exact), rtol=1e-10, atol=1e-12)
    step = 1e-6
    for j in range(4):
        ahead, behind = VALUES.copy(), VALUES.copy()
        ahead[:, j] += step
        behind[:, j] -= step
        slopes = (terms.evaluate(ahead) - terms.evaluate(behind)) / (2 * step)
        np.testing.assert_allclose(jacobian[:, :, j], slopes, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("library", LIBRARIES)
def test_terms_are_reloaded_from_their_expressions(library):
    terms = library.bind(VARIABLES)
    read = tuple(parse_term(term.expression(VARIABLES.names), VARIABLES) for term in terms.terms)
    assert Terms(VARIABLES, read) == terms
    assert len(set(terms.names)) == len(terms)


@pytest.mark.parametrize("a", LIBRARIES)
@pytest.mark.parametrize("b", LIBRARIES)
def test_sums_and_products_do_as_in_algebra(a, b):
    def terms(library):
        return set(library.bind(VARIABLES).terms)

    c = ExpressionLibrary("1", "v", "abs(v)", "1/x")
    assert terms(a + b) == terms(b + a) == terms(a) | terms(b)
    assert terms(a * b) == terms(b * a)
    assert terms((a + b) * c) == terms(a * c + b * c)
    assert terms(a * ConstantLibrary()) == terms(a)
    assert (a + a).bind(VARIABLES) == a.bind(VARIABLES)


@pytest.mark.parametrize("a", LIBRARIES)
@pytest.mark.parametrize("b", LIBRARIES)
def test_a_product_of_libraries_is_the_product_of_their_values(a, b):
    product = (a * b).bind(VARIABLES)
    left, right = a.bind(VARIABLES).evaluate(VALUES), b.bind(VARIABLES).evaluate(VALUES)
    pairs = (left[:, :, np.newaxis] * right[:, np.newaxis, :]).reshape(len(VALUES), -1)
    for column in product.evaluate(VALUES).T:
        assert np.isclose(pairs, column[:, np.newaxis], rtol=1e-12).all(axis=0).any()


@pytest.mark.parametrize("library", LIBRARIES[1:])
def test_select_and_without_share_the_terms_out(library):
    names = library.bind(VARIABLES).names
    some = names[::2]
    kept, left = library.select(*some).bind(VARIABLES), library.without(*some).bind(VARIABLES)
    assert kept.names == some
    assert left.names == names[1::2]
