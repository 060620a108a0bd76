"""Functions that equations and terms take besides the elementary ones, by the names of calculators, NumPy and SciPy."""

import mpmath
import numpy as np
import pytest

import commonlaw as cl
from commonlaw.estimation.model import ModelText
from commonlaw.library import Terms, Variables, parse_term, term_unit, units_of_parameters
from commonlaw.library.grammar import FUNCTION_NAMES
from commonlaw.trials.headers import parse_unit
from tests.refusals import refused

INSIDE = np.array([-0.9, -0.41, 0.07, 0.38, 0.83])
ABOVE = np.array([1.02, 1.7, 2.3, 5.1, 40.0])
ANY = np.array([-3.7, -1.2, 0.31, 2.4, 9.6])
REFERENCE = {
    "cot": (mpmath.cot, ANY),
    "sec": (mpmath.sec, ANY),
    "csc": (mpmath.csc, ANY),
    "coth": (mpmath.coth, ANY),
    "sech": (mpmath.sech, ANY),
    "csch": (mpmath.csch, ANY),
    "asin": (mpmath.asin, INSIDE),
    "arccos": (mpmath.acos, INSIDE),
    "atan": (mpmath.atan, ANY),
    "asinh": (mpmath.asinh, ANY),
    "arccosh": (mpmath.acosh, ABOVE),
    "atanh": (mpmath.atanh, INSIDE),
    "ln": (mpmath.log, ABOVE),
    "log10": (mpmath.log10, ABOVE),
    "log2": (lambda x: mpmath.log(x, 2), ABOVE),
    "cbrt": (lambda x: mpmath.sign(x) * mpmath.cbrt(abs(x)), ANY),
    "erf": (mpmath.erf, ANY),
    "erfc": (mpmath.erfc, ANY),
    "floor": (mpmath.floor, ANY),
    "ceil": (mpmath.ceil, ANY),
    "heaviside": (lambda x: mpmath.mpf(x > 0), ANY),
}
X = Variables(("x", "v"))


@pytest.mark.parametrize("name", REFERENCE)
def test_values_and_derivatives_are_those_of_mpmath(name):
    function, points = REFERENCE[name]
    term, values = parse_term(f"{name}(x)", X), np.column_stack([points, points, points])
    expected = [float(function(mpmath.mpf(x))) for x in points]
    slopes = [float(mpmath.diff(function, mpmath.mpf(x))) for x in points]
    np.testing.assert_allclose(term.evaluate(values), expected, rtol=1e-13)
    np.testing.assert_allclose(term.gradient(values)[:, 0], slopes, rtol=1e-12, atol=1e-14)


def test_functions_of_two_arguments_have_the_values_and_derivatives_of_numpy():
    v, x = np.array([[1.0, 0.3], [-2.0, 0.7], [-1.5, -0.4], [0.2, -3.0], [5.0, 7.3]]).T
    values = np.column_stack([x, v, v])
    angle, rest = parse_term("atan2(v, x)", X), parse_term("mod(x, 0.7)", X)
    np.testing.assert_allclose(angle.evaluate(values), np.arctan2(v, x), rtol=1e-15)
    np.testing.assert_allclose(angle.gradient(values)[:, :2], np.column_stack([-v, x]) / (x**2 + v**2)[:, None])
    np.testing.assert_allclose(rest.evaluate(values), np.mod(x, 0.7), atol=1e-15)
    np.testing.assert_array_equal(rest.gradient(values)[:, 0], 1.0)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("arctan2(x)", "function-arity"),
        ("sin(x, v)", "function-arity"),
        ("mod(x)", "function-arity"),
        ("cot(0)*x", "division-by-zero"),
        ("(x, v)", "character-unknown"),
        ("mod(" * 40 + "x" + ", 2)" * 40, "function-too-long"),
    ],
)
def test_calls_that_mean_nothing_are_refused(text, code):
    with refused(code):
        parse_term(text, X)


def test_steps_of_parameters_are_refused_in_every_equation():
    for text in ("x' = -k floor(x/c)", "x' = a mod(t, P)", "x' = -k x; y = ceil(b x)"):
        with refused("stairs-of-parameter"):
            cl.fit(text, cl.Trials.from_arrays(np.arange(5.0), np.ones((5, 1)), names=["y" if "y" in text else "x"]))


def test_steps_of_states_are_refused_and_those_of_time_are_located():
    t, k, a = np.linspace(0, 5, 26), 0.7, 0.5
    after = np.maximum(t[:, np.newaxis] - 0.73 * np.arange(1, 7), 0)
    exact = 1.3 * np.exp(-k * t[:, np.newaxis]) + (a / k * (1 - np.exp(-k * after))).sum(axis=1, keepdims=True)
    trials = cl.Trials.from_arrays(t, exact + 1e-3 * np.random.default_rng(0).normal(size=exact.shape), names=["x"])
    with refused("stairs-of-state"):
        cl.fit("x' = -k floor(x)", trials)
    fitted = cl.fit("x' = -k x + a floor(t/0.73)", trials).params
    off = (fitted["estimate"] - [0.7, 0.5]) / fitted["standard error"]
    assert np.abs(off).max() < 2.5
    np.testing.assert_array_less(fitted["standard error"], 0.0012)


def test_commas_stand_between_arguments_alone():
    for text in ("x' = a, b", "x' = (a, b) x", "x' = , a"):
        with refused("equation-character"):
            cl.Law.from_text(text, {"a": 1.0, "b": 1.0})


def test_an_equation_is_fitted_saved_and_opened_with_its_words(tmp_path):
    text = "x' = -k asinh(x) + a mod(t, 2) sech(x)"
    law = cl.Law.from_text(text, {"k": 0.8, "a": 0.3})
    times = np.linspace(0, 6, 25)
    curve = law.simulate(times, [1.5])["object"].states
    fitted = cl.fit(text, cl.Trials.from_arrays(times, curve, names=["x"]))
    np.testing.assert_allclose(fitted.params["estimate"], [0.8, 0.3], rtol=1e-3)
    fitted.save(tmp_path / "law.json")
    opened = cl.Law.load(tmp_path / "law.json")
    assert opened.provenance.equations == (text,)
    assert opened.structure == fitted.structure
    assert "asinh" in opened.structure[0]
    np.testing.assert_array_equal(
        opened.simulate(times, [1.5])["object"].states, fitted.simulate(times, [1.5])["object"].states
    )


def test_every_name_of_a_function_is_a_word_of_equations():
    for name in FUNCTION_NAMES:
        jumps = name in ("step", "heaviside", "floor", "ceil", "mod")
        assert ModelText.of(f"x' = a {name}(x - 0.5)").beyond_equations == ["jumps or delays"] * jumps
        with refused("function-not-called"):
            cl.Law.from_text(f"x' = -k {name}", {"k": 1.0})


def test_units_follow_from_arguments():
    units = {"x": "m", "v": "m/s"}
    for text, unit in (
        ("atan2(x, 2*x)", "radian"),
        ("floor(x/x*v/v)", ""),
        ("erf(v/v)", ""),
        ("floor(x)", None),
        ("erf(x)", None),
    ):
        found = term_unit(parse_term(text, X), X, units)
        assert found == (None if unit is None else parse_unit(unit)), text
    inside = Variables(("x", "v"), parameters=("c",))
    terms = Terms(inside, (parse_term("arctan2(x, c + x)", inside),))
    assert units_of_parameters(terms, {"x": parse_unit("m"), "v": parse_unit("m/s")}) == {"c": parse_unit("m")}
