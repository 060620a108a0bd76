"""What is said where a law hangs on the zero of a scale, or trials start where it can never start."""

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.diagnostics import OutcomeKind
from commonlaw.inference.diagnose.scale_origin import with_origin_outcomes

TIMES = np.linspace(0, 10, 41)


def course(state, unit=None, inputs=None):
    columns = {"t": TIMES, "x": state, **({} if inputs is None else {"u": inputs})}
    units = {} if unit is None else {"x": unit, "t": "s"}
    names = {"inputs": ["u"]} if inputs is not None else {}
    return cl.Trials.from_frame(pd.DataFrame(columns), time="t", states=["x"], units=units, **names)


def said(law, kind):
    return [str(diagnostic) for diagnostic in law.diagnostics if diagnostic.kind is kind]


def fitted(equation, trials):
    return cl.fit(equation, trials, errors="white", noise={"x": 0.1})


COOLING = 20 + 60 * np.exp(-0.3 * TIMES)


@pytest.mark.parametrize(
    ("equation", "unit", "named"),
    [
        ("x' = a + b x^3", "degC", "x^3"),
        ("x' = a + b x^3", "degF", "x^3"),
        ("x' = a + b x^3", "K", None),
        ("x' = a + b x^3", None, None),
        ("x' = a + b x", "degC", None),
        ("x' = a + b x + c x^2", "degC", None),
    ],
)
def test_a_power_on_a_scale_whose_zero_was_agreed_upon_is_said_unless_lower_powers_make_up_for_it(
    equation, unit, named
):
    found = said(fitted(equation, course(COOLING, unit)), OutcomeKind.SCALE)
    if named is None:
        assert found == []
    else:
        assert found[0].startswith(
            f"scale (x'): {named} depends on the origin of the scale of x ({unit}); give x in kelvin"
        )


@pytest.mark.parametrize(
    ("equation", "values", "named"),
    [
        ("x' = -V x/(K + x)", {"V": 5.0, "K": 20.0}, "x/(K + x) depends on the origin of the scale of x (degC)"),
        ("x' = a + b/(K + x)", {"a": -1.0, "b": 5.0, "K": 20.0}, None),
        ("x' = a - b exp(x/U)", {"a": 1.0, "b": 0.1, "U": 20.0}, None),
    ],
)
def test_a_constant_inside_of_a_term_may_make_up_for_the_zero(equation, values, named):
    law = cl.Law.from_text(equation, values, units={"x": "degC", "t": "s"})
    found = [str(each) for each in with_origin_outcomes((), law, course(COOLING, "degC"))]
    assert found == [] if named is None else named in found[0]


def test_a_product_with_an_input_on_such_a_scale_is_said():
    trials = course(COOLING, "degC", np.sin(TIMES) + 2)
    assert "x u depends" in said(fitted("x' = a + b x + c x u", trials), OutcomeKind.SCALE)[0]
    assert said(fitted("x' = a + b x + c x u + d u", trials), OutcomeKind.SCALE) == []


RISING = 5 * (1 - np.exp(-0.5 * TIMES))


@pytest.mark.parametrize(
    ("equation", "state", "inputs"),
    [
        ("x' = a x + b u", RISING, np.ones_like(TIMES)),
        ("x' = a x + b", RISING, None),
        ("x' = a x + b x^2", RISING + 1, None),
    ],
)
def test_a_law_that_leaves_zero_or_never_was_there_is_not(equation, state, inputs):
    assert said(fitted(equation, course(state, inputs=inputs)), OutcomeKind.START) == []


def test_growth_from_below_the_noise_leaves_zero_by_its_law():
    grown = 5 / (1 + 5000 * np.exp(-1.5 * TIMES)) + 0.1 * np.random.default_rng(0).standard_normal(len(TIMES))
    assert said(fitted("x' = a x + b x^2", course(grown)), OutcomeKind.START) == []


def test_a_start_at_zero_that_the_law_has_to_miss_is_said():
    rising = RISING + 0.02 * np.random.default_rng(2).standard_normal(len(TIMES))
    rising[0] = 0.0
    (text,) = said(fitted("x' = a x + b x^2", course(rising)), OutcomeKind.START)
    assert "1 trial" in text
