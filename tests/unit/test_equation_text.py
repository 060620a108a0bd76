"""Equations in texts: what they say, and where the message points if they cannot be read."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.errors import CommonlawError
from commonlaw.law.from_text import read_equations

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
    assert {each.coefficients[0][0]: each.factor for each in found.products} == pytest.approx(coefficients)


def test_equations_share_terms_and_come_in_the_order_of_the_states():
    lorenz = "y' = r x - y - x z", "x' = s (y - x); z' = x y - 2.667 z"
    found = read_equations(lorenz, XYZ)
    assert found.texts == ("x' = s (y - x)", "y' = r x - y - x z", "z' = x y - 2.667 z")
    x, y, z = (dict(zip(found.terms.names, row, strict=True)) for row in found.known)
    assert {name for name, value in x.items() if value != 0} == {"y - x"}
    assert (y["y"], y["x z"], z["x y"], z["z"]) == (-1, -1, 1, -2.667)
    assert [(each.name, each.equation) for each in found.coefficients] == [("s", 0), ("r", 1)]


def test_names_that_are_no_words_stand_between_backticks():
    schema = cl.Schema(("wind speed",), inputs=("exp",))
    found = read_equations("`wind speed`' = -k `wind speed`^2 + exp", schema)
    assert found.terms.names == ("(wind speed)^2", "exp")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x' = a + b q", "character 12, 'q': b and q are both no variables.* correct the name; variables: x, t"),
        ("x' = a x/m", "character 10, 'm': a and m are both no variables.* write one letter for them"),
        ("x' = a + b x $", r"character 14, '\$': the character '\$' has no place in an equation; variables: x, t"),
        ("x' = a + b (x", r"character 12, '\(': this parenthesis is not closed"),
        ("x' = a + b x)", r"character 13, '\)': a parenthesis closes that was not opened"),
        ("x' = a +", "character 9: it ends where a number, a name or a parenthesis is expected"),
        ("x' = a * / x", "character 10, '/': '/' stands where a number"),
        ("x' = sine(x)", "character 6, 'sine': unknown function 'sine': did you mean 'sin'"),
        ("x' = sin x", r"character 6, 'sin': sin is a function: write sin\(...\)"),
        ("x' = a x'", "character 8, 'x': x' is no rate"),
        ("x' = a x/0", "character 10, '0': this divides by zero"),
        ("x' = a x^x", "character 6, 'a': .*an exponent must be a number"),
        ("x' = " + "(" * 80 + "x" + ")" * 80, "at most 1000 characters and 60 parentheses"),
        ("x' = a + bx", "has the term 1 twice: write it once, and products with '\\*' or a space"),
        ("x' = a x(t)", "character 8, 'x': x is a variable, not a function"),
        ("x' = a x + b x", "has the term x twice: write it once"),
        ("x = a", 'equations of measurement are not available; every equation begins with a rate such as "x\' ="'),
        ("x' = -k x; s = c x", "'s = c x' says what is measured"),
        ("x''' = a", "an equation begins with"),
        ("", "there is no equation"),
        ("x' = a; x' = b", "x has two equations"),
        ("x' = a; y[k+1] = b", "are in continuous and in discrete time"),
        ("y' = a", "the equations are of y, the states are x"),
    ],
)
def test_what_cannot_be_read_is_refused_where_it_stands(text, message):
    with pytest.raises(CommonlawError, match=message):
        read_equations(text, X)


def test_a_stated_law_has_the_numbers_of_its_text():
    law = cl.Law.from_text("H' = 0.5 H - 0.02 H P; P' = c H P - 0.4 P", {"c": {"north": 0.01, "south": 0.02}})
    assert law.objects == ("north", "south")
    assert law.equations("south") == ("H' = 0.5 H - 0.02 H P", "P' = 0.02 H P - 0.4 P")
    path = law.simulate([0.0, 1.0], [20.0, 25.0])["south"].states
    np.testing.assert_allclose(path, [[20.0, 25.0]] * 2)  # The fixed point


def test_a_coefficient_without_a_value_is_refused():
    with pytest.raises(CommonlawError, match=r"coefficients a, b have no value: give values=\{'a': ...\}"):
        cl.Law.from_text("x' = a + b x")
    with pytest.raises(CommonlawError, match="coefficient a has no value for mug"):
        cl.Law.from_text("x' = a + b x", {"a": {"cup": 1.0}, "b": {"mug": 2.0}})
    with pytest.raises(CommonlawError, match="unknown coefficient 'c'"):
        cl.Law.from_text("x' = a + b x", {"c": 1.0})


def test_a_sum_stands_in_parentheses_behind_its_coefficient():
    law = cl.Law.from_text("T' = -k (T - 20)", {"k": 0.1})
    assert law.equations() == ("T' = -0.1 (T - 20)",)
    assert r"-k \left(T - 20\right) \\" in law.to_latex()


def test_a_coefficient_may_divide():
    law = cl.Law.from_text("U' = -U/tau", {"tau": {"one": 5.0, "two": 8.0}}, units={"U": "V", "t": "s"})
    assert law.equations("one") == ("U' = -U/5",)
    values, errors = law.letter_values()
    np.testing.assert_allclose(values, [[5.0], [8.0]])
    assert np.isnan(errors).all()
    assert law.letter_units() == ("s",)
    with pytest.raises(CommonlawError, match="a value that is not finite"):
        cl.Law.from_text("U' = -U/tau", {"tau": 0.0})


@pytest.mark.parametrize(("unit", "root"), [("m", "m⁰⋅⁵/s²"), ("m^(1/3)", "m⁰⋅¹⁶⁶⁶⁶⁷/s²"), ("dB/s", "dB⁰⋅⁵/s²⋅⁵")])
def test_units_of_coefficients_may_have_broken_powers(unit, root):
    law = cl.Law.from_text("x'' = -a sqrt(x) - b v", {"a": 1.0, "b": 1.0}, units={"x": unit, "t": "s"})
    assert law.letter_units() == (root, "1/s")


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
    assert dict(zip(law.letters, law.letter_units(), strict=True)) == expected
