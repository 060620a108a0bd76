"""Models of textbooks by name: what is listed of them, and which columns their variables are."""

import re

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law import to_script
from commonlaw.law.models import model_named
from tests.refusals import refused

TIMES = np.linspace(0.0, 6.0, 30)


def trials(*names, inputs=0, properties=None):
    """Return trials with columns of these names, the last of them inputs; all decay."""
    values = np.exp(-TIMES)[:, np.newaxis] * np.arange(1.0, 1.0 + len(names))
    states = len(names) - inputs
    given = {"inputs": values[:, states:]} if inputs else {}
    return cl.Trials.from_arrays(TIMES, values[:, :states], **given, names=names, properties=properties)


def over(text, *names, inputs=0, properties=()):
    """Return the equations that a name stands for with these columns."""
    model, given = model_named(text)
    return model.over_columns(trials(*names, inputs=inputs).schema, properties, given).equations.partition(";")[0]


def test_symbols_of_models_are_those_of_their_equations():
    for model in cl.named_models.values():
        names = {*re.findall(r"[A-Za-z]\w*", model.equations)} - {"t", "abs", "sin", "cos", "log"}
        assert names == {*model.variables, *model.parameters}, model.name
        assert {*model.states} == {*re.findall(r"(\w+)'+ =", model.equations)}
        assert {*model.doses} <= {*model.inputs}
        assert model.source
        assert model.title


def test_variables_are_the_columns_that_are_clear():
    assert over("logistic", "x") == "x' = r x (1 - x/K)"
    assert over("logistic", "weight") == "weight' = r weight (1 - weight/K)"
    assert over("sir", "s", "i") == "s' = -b s i"
    assert over("sir", "S", "cases") == "S' = -b S cases"
    assert over("first-order-lag", "speed", "voltage", inputs=1) == "speed' = (G voltage - speed)/T"
    assert over("one-compartment-with-absorption", "plasma", properties=["dose"]) == "depot' = -a depot"
    assert over("exponential-decay:x=dry weight", "dry weight", "t2") == "`dry weight`' = -k `dry weight`"
    assert over("exponential-decay:x=e", "e") == "`e`' = -k `e`"
    assert over("logistic:x=K:K=capacity", "K", "y") == "K' = r K (1 - K/capacity)"


def test_unclear_names_are_refused():
    with refused("named-model-columns"):
        over("sir", "a", "c")
    with refused("named-model-columns"):
        over("one-compartment", "x")
    with refused("named-model-name-twice"):
        over("logistic", "K")
    with refused("unknown-name"):
        over("logistic:y=weight", "weight")
    with refused("named-model-syntax"):
        model_named("logistic:weight")
    with refused("unknown-name"):
        model_named("logistik")


@pytest.mark.parametrize("text", ["x' = a x", "x[k+1] = a x", "sat", ["logistic"]])
def test_equations_are_no_names(text):
    assert model_named(text) is None


def test_a_name_stands_for_its_equations():
    decay = trials("x")
    by_name, written = cl.fit("exponential-decay", decay), cl.fit("x' = -k x; k > 0", decay)
    assert by_name.structure == written.structure == ("x' = -k x",)
    assert by_name.coefficients == pytest.approx(written.coefficients)
    assert "exponential-decay" not in to_script(by_name)


def test_doses_of_a_model_are_doses_of_the_fit():
    """Two doses of 6 into a volume of 2, eliminated at a rate of 0.5, against the closed form."""
    dose = np.where(np.isin(TIMES, TIMES[[5, 15]]), 6.0, 0.0)
    concentration = sum(3.0 * np.exp(-0.5 * (TIMES - at)) * (at < TIMES) for at in TIMES[[5, 15]])
    given = cl.Trials.from_arrays(TIMES, concentration, inputs=dose, names=["c", "dose"])
    estimates = cl.fit("one-compartment-with-doses", given).params.set_index("parameter")["estimate"]
    assert estimates["k"] == pytest.approx(0.5, rel=1e-2)
    assert estimates["V"] == pytest.approx(2.0, rel=1e-2)


def test_formulas_are_latex():
    assert r"\ddot{\theta} &= -a \sin(\theta) - c \theta'" in cl.named_models["pendulum"].to_latex()
    assert "G u(t - d) - x" in cl.named_models["first-order-lag-with-dead-time"].to_latex()
    assert r"c(0) &= \frac{\mathrm{dose}}{V}" in cl.named_models["one-compartment"].to_latex()
