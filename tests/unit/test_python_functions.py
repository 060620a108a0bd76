import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.discovery.method import with_properties_in
from commonlaw.library import ExpressionLibrary, Variables, parse_library
from commonlaw.library.functions import Function
from tests.refusals import refused

XV = Variables(("x", "v"))
RANDOM = np.random.default_rng(0)
POINTS = np.column_stack([RANDOM.uniform(-2, 2, (100, 2)), np.zeros(100)])


def tanh_v(x, v):
    return np.tanh(x) * v


def drag(v):
    return v * np.abs(v)


def threshold(x):
    return np.where(x > 0.5, x**2, 0.0)


def real_only(x):
    return 10 * x + 0.1 * np.real(x) * x


def of_floats(x):
    return np.arctan2(np.asarray(x, dtype=float), 2.0)


SLOPES = {
    tanh_v: lambda x, v: (v / np.cosh(x) ** 2, np.tanh(x)),
    drag: lambda v: (2 * np.abs(v),),
    threshold: lambda x: (np.where(x > 0.5, 2 * x, 0.0),),
    real_only: lambda x: (10 + 0.2 * x,),
    of_floats: lambda x: (2 / (4 + x**2),),
}


@pytest.mark.parametrize("function", SLOPES, ids=lambda each: each.__name__)
@pytest.mark.parametrize("size", [1e-6, 1.0, 100.0])
def test_derivatives_are_the_analytic_ones(function, size):
    function, slopes = Function.of(function), SLOPES[function]
    values = size * POINTS[:, : len(function.arguments)].T
    for found, expected in zip(function.slopes(*values), slopes(*values), strict=True):
        scale = np.abs(expected).max()
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * scale)


def test_a_kink_and_a_jump_have_finite_slopes():
    (kink,) = Function.of(lambda x: np.abs(x)).slopes(np.array([-1.0, 0.0, 1.0]))
    np.testing.assert_allclose(kink[[0, 2]], [-1, 1])
    assert -1 <= kink[1] <= 1
    (jump,) = Function.of(lambda x: np.where(np.real(x) > 0.5, 1.0, 0.0)).slopes(np.array([0.5, 0.5 + 1e-9, 1.0]))
    assert not jump.any()


def test_terms_with_functions_are_computed_with_their_parts_and_products():
    library = parse_library(["1", "x*tanh_v(x, 2*v)", tanh_v, "poly:1"])
    terms = library.bind(Variables(XV.states, functions=library.functions))
    x, v = POINTS[:, 0], POINTS[:, 1]
    assert terms.names == ("1", "x*tanh_v(x, 2*v)", "tanh_v(x, v)", "x", "v")
    np.testing.assert_allclose(
        terms.evaluate(POINTS), np.column_stack([np.ones(100), 2 * x * tanh_v(x, v), tanh_v(x, v), x, v])
    )
    slopes = terms.jacobian(POINTS)
    np.testing.assert_allclose(slopes[:, 1, 0], 2 * v * (np.tanh(x) + x / np.cosh(x) ** 2), rtol=1e-13)
    np.testing.assert_allclose(slopes[:, 1, 1], 2 * x * np.tanh(x), rtol=1e-13)
    assert terms.terms[2].latex(("x", "v")) == r"\operatorname{tanh\_v}(x, v)"


def test_what_cannot_be_a_function_in_terms_is_refused():
    variables = Variables(XV.states, functions=(Function.of(drag),))
    for code, make in {
        "function-name": lambda: Function.of(np.sin),
        "function-arguments": lambda: Function.of(lambda *x: x),
        "function-name-twice": lambda: ExpressionLibrary(lambda x: x, lambda v: v),
        "function-failed": lambda: Function.of(lambda x: 1.0 if x > 0 else 0.0)(POINTS[:, 0]),
        "function-call": lambda: ExpressionLibrary("drag(v, x)").bind(variables),
        "unknown-name": lambda: ExpressionLibrary("push(v)").bind(variables),
    }.items():
        with refused(code):
            make()
    with refused("function-unavailable"):
        ExpressionLibrary("1/drag(2)").bind(variables)


def test_properties_in_terms_are_inputs_and_others_are_not():
    known = {"a": {"K": 2.0, "mass": 1.0, "make": "old"}, "b": {"K": 3.0, "mass": 2.0, "make": "new"}}
    table = pd.DataFrame({"object": list("aaabbb"), "t": [0.0, 1, 2] * 2, "x": [1.0, 2, 4] * 2})
    trials = cl.Trials.from_frame(table, properties=known)
    for given, expected in {
        "poly:3": (),
        "terms:x,x^2/K": ("K",),
        "poly:1:x,mass * saturating:x": ("mass",),
        "poly:1 + rational:1:1+K*x": ("K",),
    }.items():
        wide = with_properties_in([parse_library(given)], trials)
        assert wide.schema.inputs == expected
        assert [list(each.inputs[0]) for each in wide] == [[known[i][name] for name in expected] for i in "ab"]
    with refused("property-number"):
        with_properties_in([parse_library(["x*make"])], trials)
