"""Equations in texts: what they say, and where the message points if they cannot be read."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.estimation.model import ModelText, read_model
from commonlaw.law import to_latex
from commonlaw.law.parameters import named_parameters
from commonlaw.law.parse import read_equations
from commonlaw.law.text import Addend, written_equations
from commonlaw.library import Variables, parse_term
from tests.refusals import refused

nan = np.nan
X, XYZ = cl.Schema(("x",)), cl.Schema(("x", "y", "z"))


@pytest.mark.parametrize(
    ("text", "order", "terms", "known", "coefficients"),
    [
        ("x' = a + b x", 1, ("1", "x"), [nan, nan], {"a": 1, "b": 1}),
        ("dx/dt = -k (x - 20)", 1, ("x - 20",), [nan], {"k": -1}),
        ("x' = -k(x - 20)", 1, ("x - 20",), [nan], {"k": -1}),
        ("x'' = -9.81 + c*v", 2, ("1", "v"), [-9.81, nan], {"c": 1}),
        ("x'' = -9.81 - c x'", 2, ("1", "v"), [-9.81, nan], {"c": -1}),
        ("d2x/dt2 = - -2 k_1 sin(2 x) v^2", 2, ("v^2 sin(2 x)",), [nan], {"k_1": 2}),
        ("x[k+1] = r x[k] (1 - x[k])", 0, ("x*(1 - x)",), [nan], {"r": 1}),
        ("x' = 2 a x^2/3 - growth x**-1 + 1/2 x", 1, ("x^2", "1/x", "x"), [nan, nan, 0.5], {"a": 2 / 3, "growth": -1}),
        ("x' = -x/3/tau", 1, ("x",), [nan], {"tau": -1 / 3}),
        ("x' = 0", 1, ("1",), [0], {}),
    ],
)
def test_an_equation_is_read_as_people_write_it(text, order, terms, known, coefficients):
    found = read_equations(text, X)
    assert (found.order, found.terms.names) == (order, terms)
    np.testing.assert_allclose(found.known[0], known, rtol=1e-15)
    assert {product.coefficients[0][0]: product.factor for product in found.products} == pytest.approx(coefficients)


def test_a_reciprocal_is_written_as_a_fraction():
    assert written_equations(["x'"], [[Addend(True, "a", "1/x"), Addend(False, "b", "x")]]) == ("x' = -a/x + b x",)


def test_equations_share_terms_and_come_in_the_order_of_the_states():
    lorenz = "y' = r x - y - x z", "x' = s (y - x); z' = x y - 2.667 z"
    found = read_equations(lorenz, XYZ)
    assert found.texts == ("x' = s (y - x)", "y' = r x - y - x z", "z' = x y - 2.667 z")
    x, y, z = (dict(zip(found.terms.names, row, strict=True)) for row in found.known)
    assert {name for name, value in x.items() if value != 0} == {"y - x"}
    assert (y["y"], y["x z"], z["x y"], z["z"]) == (-1, -1, 1, -2.667)
    assert [(coefficient.name, coefficient.equation) for coefficient in found.coefficients] == [("s", 0), ("r", 1)]


def test_names_that_are_no_words_stand_between_backticks():
    schema = cl.Schema(("wind speed",), inputs=("exp",))
    found = read_equations("`wind speed`' = -k `wind speed`^2 + exp", schema)
    assert found.terms.names == ("(wind speed)^2", "exp")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x' = a + b q", "product-of-parameters"),
        ("x' = a x/m", "product-of-parameters"),
        ("x' = a + b x $", Diagnostic("equation-character", {"character": "$"})),
        ("x' = a + b (x", "parenthesis-not-closed"),
        ("x' = a + b x)", "parenthesis-not-opened"),
        ("x' = a +", Diagnostic("operand-missing", {"what": "it ends"})),
        ("x' = a * / x", Diagnostic("operand-missing", {"what": "'/' stands"})),
        ("x' = sine(x)", Diagnostic("unknown-name", {"kind": "function", "name": "sine"})),
        ("x' = sin x", Diagnostic("function-not-called", {"name": "sin"})),
        ("x' = a x'", Diagnostic("rate-unknown", {"name": "x"})),
        ("x' = a x/0", "equation-divides-by-zero"),
        ("x' = a x^x", "exponent-not-a-number"),
        ("x' = " + "(" * 80 + "x" + ")" * 80, Diagnostic("equation-too-long", {"longest": 1000, "deepest": 60})),
        ("x' = a + bx", Diagnostic("term-twice", {"term": "1"})),
        ("x' = a x(t)", Diagnostic("equation-calls-variable", {"name": "x"})),
        ("x' = a x(t - 3)", Diagnostic("equation-with-delay", {"name": "x"})),
        ("x' = where(> 1, a, x)", "condition-syntax"),
        ("x' = max(a, (x", "condition-syntax"),
        ("x' = a x + b x", Diagnostic("term-twice", {"term": "x"})),
        ("x = a", Diagnostic("observation-equation", {"state": "x"})),
        ("x' = -k x; s = c x", Diagnostic("observation-equation", {"text": "s = c x", "state": "s"})),
        ("x''' = a", "equation-syntax"),
        ("", "no-equation"),
        ("x' = a; x' = b", Diagnostic("two-equations", {"state": "x"})),
        ("x' = a; y[k+1] = b", "continuous-and-discrete"),
        ("y' = a", "equation-or-input"),
    ],
)
def test_what_cannot_be_read_is_refused_where_it_stands(text, message):
    with refused(message):
        read_equations(text, X)


@pytest.mark.parametrize(
    "text", ["x' = -nan x", "x' = -k x + Infinity", "x' = -k x; x(0) = nan", "x' = -k x; x(0) = -Inf"]
)
def test_names_of_numbers_that_are_not_finite_are_no_parameters(text):
    series = cl.Trials.from_arrays(np.arange(5.0), np.exp(-np.arange(5.0)), names=["x"])
    with pytest.raises(cl.CommonlawError) as caught:
        cl.fit(text, series)
    assert "number-too-large" in caught.value.codes


def test_switches_have_the_values_of_their_definition_whatever_names_are():
    law = cl.Law.from_text("x' = max(x, `y (>0)`); z' = min(x + 1, z) - (z > `y (>0)`)", inputs=["y (>0)"])
    points = np.array([[1.0, 3.0, 2.0], [4.0, 2.0, 5.0]])  # x, z, y (>0)
    np.testing.assert_array_equal(law.rhs("object", points), [[2.0, 1.0], [5.0, 2.0]])


def test_a_stated_law_has_the_numbers_of_its_text():
    law = cl.Law.from_text("H' = 0.5 H - 0.02 H P; P' = c H P - 0.4 P", {"c": {"north": 0.01, "south": 0.02}})
    assert law.objects == ("north", "south")
    assert law.equations("south") == ("H' = 0.5 H - 0.02 H P", "P' = 0.02 H P - 0.4 P")
    path = law.simulate([0.0, 1.0], [20.0, 25.0])["south"].states
    np.testing.assert_allclose(path, [[20.0, 25.0]] * 2)  # The fixed point


def test_a_coefficient_without_a_value_is_refused():
    with refused("parameter-values-missing", first="a"):
        cl.Law.from_text("x' = a + b x")
    with refused("parameter-value-of-objects", name="a"):
        cl.Law.from_text("x' = a + b x", {"a": {"cup": 1.0}, "b": {"mug": 2.0}})
    with refused("unknown-name", kind="coefficient", name="c"):
        cl.Law.from_text("x' = a + b x", {"c": 1.0})


def test_a_sum_stands_in_parentheses_behind_its_coefficient():
    law = cl.Law.from_text("T' = -k (T - 20)", {"k": 0.1})
    assert law.equations() == ("T' = -0.1 (T - 20)",)
    assert r"-k \left(T - 20\right) \\" in to_latex(law)


def test_a_coefficient_may_divide():
    law = cl.Law.from_text("U' = -U/tau", {"tau": {"one": 5.0, "two": 8.0}}, units={"U": "V", "t": "s"})
    assert law.equations("one") == ("U' = -U/5",)
    parameters = named_parameters(law)
    values, errors = parameters.values, parameters.errors
    np.testing.assert_allclose(values, [[5.0], [8.0]])
    assert np.isnan(errors).all()
    assert parameters.units == ("s",)
    with refused("law-array-not-finite"):
        cl.Law.from_text("U' = -U/tau", {"tau": 0.0})


@pytest.mark.parametrize(("unit", "root"), [("m", "m⁰⋅⁵/s²"), ("m^(1/3)", "m⁰⋅¹⁶⁶⁶⁶⁷/s²"), ("dB/s", "dB⁰⋅⁵/s²⋅⁵")])
def test_units_of_coefficients_may_have_broken_powers(unit, root):
    law = cl.Law.from_text("x'' = -a sqrt(x) - b v", {"a": 1.0, "b": 1.0}, units={"x": unit, "t": "s"})
    assert named_parameters(law).units == (root, "1/s")


@pytest.mark.parametrize(
    ("text", "units", "expected"),
    [
        ("N' = r N (1 - N/K)", {"t": "h"}, {"r": "1/h", "K": None}),
        ("x'' = -g - c v", {"t": "s"}, {"g": None, "c": "1/s"}),
        ("s' = -V s/(K + s)", {"s": "mM"}, {"V": None, "K": "mM"}),
        ("H' = a H - b H P; P' = c H P - d P", {"t": "min"}, {"a": "1/min", "b": None, "c": None, "d": "1/min"}),
        ("T' = -k (T - Ta) + b; Ta' = c T", {"t": "min"}, {"k": "1/min", "b": None, "c": None}),
        ("x' = -k x", {}, {"k": None}),
    ],
)
def test_units_that_are_not_known_cancel_or_hide_that_of_a_coefficient(text, units, expected):
    law = cl.Law.from_text(text, dict.fromkeys(expected, 1.0), units=units)
    parameters = named_parameters(law)
    assert dict(zip(parameters.names, parameters.units, strict=True)) == expected


def test_switches_are_read_as_expressions_of_the_unit_step():
    for text, terms in {
        "x' = a where(x > 1, x, 0)": "x*step(x - 1)",
        "x' = a (2 < x <= 5)": "step(5 - x)*step(x - 2)",
        "x' = a (max(x, 0) >= z)": "step(step(x)*x - z)",
        "x' = -2 a x > z": "step(-2*a*x - z)",
    }.items():
        assert read_equations(text, cl.Schema(("x",), inputs=("z",))).terms.names[0] == terms
    points = np.random.default_rng(0).normal(size=(20, 3))
    law = cl.Law.from_text("x' = max(x, 0.1, z, x + z) - min(x, z, -0.2) + where(x > z > -1, x, -z)", inputs=["z"])
    x, z, _ = points.T
    expected = np.maximum.reduce([x, 0.1 + 0 * x, z, x + z]) - np.minimum.reduce([x, z, -0.2 + 0 * x])
    np.testing.assert_allclose(law.rhs("object", points)[:, 0], expected + np.where((x > z) & (z > -1), x, -z))
    assert law.structure == ("x' = max(x, 0.1, z, x + z) - min(x, z, -0.2) + where(x > z > -1, x, -z)",)


def test_names_of_switches_that_are_not_called_are_parameters():
    assert [each.name for each in read_equations("x' = max - min x", X).coefficients] == ["max", "min"]


def test_switches_stand_in_terms_and_observation_equations_too():
    assert parse_term("max(x, 0)", Variables(("x",))) == parse_term("x*step(x)", Variables(("x",)))
    model = read_model(ModelText.of("x' = -k x", {"y": "max(x, 0.2)"}), cl.Schema(("y",)), ())
    points = np.array([[-1.0, 0.0, 0.5], [0.7, 0.0, 0.5]])  # x, t, k
    np.testing.assert_allclose(model.outputs.evaluate(points)[:, 0], [0.2, 0.7])
