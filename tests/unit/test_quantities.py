"""What is quoted of laws of known forms, and models by their names."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import brentq

import commonlaw as cl
from commonlaw.diagnostics import note
from commonlaw.forecast import fitted
from commonlaw.law import to_script
from commonlaw.law.models import model_named
from commonlaw.law.observation import Observation
from commonlaw.law.parse import read_equations
from commonlaw.law.quantiles import propagated
from commonlaw.law.quantities import forms
from commonlaw.law.tables import quantities_by_object
from commonlaw.library.equation import split_equations
from commonlaw.trials import Schema
from tests.refusals import refused

Z = 1.959963984540054


def law_of(text, covariance=None, inputs=(), units=None, **values):
    """Return the law of equations with these values, and a covariance of its coefficients."""
    law = cl.Law.from_text(text, values, inputs=inputs, units=units or {})
    if covariance is None:
        return law
    whole = np.tile(covariance, (len(law.objects), 1, 1))
    return replace(law, uncertainty=replace(law.uncertainty, covariance=whole))


def found(law, **how):
    """Return the estimates of a law by symbol."""
    return law.quantities(**how).set_index("symbol")["estimate"].to_dict()


def variants():
    for form in forms():
        for text in form.equations:
            yield pytest.param(form, text, id=text)


@pytest.mark.parametrize(("form", "text"), [*variants()])
def test_every_form_is_recognised_with_all_its_quantities(form, text):
    """Of what depends on an initial value only the names are known here."""
    states = [each.state for each in split_equations(text)]
    inputs = tuple(name for name in form.inputs if f"{name} " in text or f"{name}/" in text)
    names = [coefficient.name for coefficient in read_equations(text, Schema(tuple(states), inputs)).coefficients]
    law = cl.Law.from_text(text, {name: 0.3 + 0.2 * i for i, name in enumerate(names)}, inputs=inputs)
    if form.doses:
        law = replace(law, schema=replace(law.schema, doses=inputs, input_interpolation="linear"))
    if form.bolus:
        return
    table = law.quantities(initial=dict.fromkeys(states, 0.01))
    own = table[table["form"] == form.title]
    unconditional = {row[0] for row in form.quantities if len(row) == 4 and "input" not in row[2] and "n" not in row[2]}
    assert unconditional - {*own["quantity"]} - {"damping ratio at small amplitude"} == set()


def test_logistic_growth_by_any_name_and_in_any_spelling():
    expected = {"r": 0.8, "K": 2.0, "T2": np.log(2) / 0.8, "r K/4": 0.4}
    for text, values in (
        ("x' = r x (1 - x/K)", {"r": 0.8, "K": 2.0}),
        ("weight' = a weight + b weight^2", {"a": 0.8, "b": -0.4}),
        ("N' = q N (M - N)", {"q": 0.4, "M": 2.0}),
    ):
        quantities = found(law_of(text, **values))
        assert {name: quantities[name] for name in expected} == pytest.approx(expected)


@pytest.mark.parametrize(
    ("text", "values", "symbol", "expected"),
    [
        ("x'' = -w^2 x - 2 z w v", {"w": 2.0, "z": 0.1}, "ζ", 0.1),
        ("T' = -(T - 20)/tau", {"tau": 3.0}, "τ", 3.0),
        ("x'' = m (1 - x^2) v - k x", {"m": 0.5, "k": 4.0}, "A", 2.0),
        ("c' = -(k + f) c + b p; p' = f c - b p", {"k": 0.5, "f": 0.4, "b": 0.3}, "τ", None),
    ],
)
def test_parameters_may_stand_in_several_terms(text, values, symbol, expected):
    if expected is None:  # Without a volume the form is not pharmacokinetic
        rates = np.linalg.eigvals([[-0.9, 0.3], [0.4, -0.3]])
        table = law_of(text, **values).quantities()
        assert sorted(table[table["symbol"] == symbol]["estimate"]) == pytest.approx(sorted(-1 / rates))
    else:
        assert found(law_of(text, **values))[symbol] == pytest.approx(expected)


def test_lag_is_where_the_tangent_of_the_inflection_meets_zero():
    """Against the closed form of the logistic curve, x = K/(1 + (K/x0 - 1) exp(-r t))."""
    r, K, x0 = 0.8, 2.0, 0.05
    at = brentq(lambda t: K / (1 + (K / x0 - 1) * np.exp(-r * t)) - K / 2, 0.0, 50.0)
    quantities = found(law_of("x' = r x (1 - x/K)", r=r, K=K), initial={"x": x0})
    assert quantities["t_i"] == pytest.approx(at)
    assert quantities["λ"] == pytest.approx(at - (K / 2) / (r * K / 4))
    assert "λ" not in found(law_of("x' = r x (1 - x/K)", r=r, K=K))


def test_damping_decides_what_is_quoted_of_each_object():
    law = law_of("x'' = -k x - c v", k={"light": 4.0, "heavy": 4.0}, c={"light": 1.0, "heavy": 5.0})
    light, heavy = (
        group.set_index("symbol")["estimate"] for _, group in law.quantities().groupby("object", sort=False)
    )
    assert light["ζ"] == pytest.approx(0.25)
    assert light["T"] == pytest.approx(2 * np.pi / np.sqrt(4 - 0.25))
    assert heavy["ζ"] == pytest.approx(1.25)
    roots = np.roots([1.0, 5.0, 4.0])
    assert sorted(heavy[["τ_1", "τ_2"]]) == pytest.approx(sorted(-1 / roots))
    assert "T" not in heavy
    assert "τ_1" not in light


def test_inputs_have_gains_and_forces_are_ignored():
    law = law_of("x'' = a - k x - c v + b u + f w", inputs=("u", "w"), a=1.0, k=4.0, c=1.0, b=2.0, f=-1.0)
    table = law.quantities().set_index("quantity")["estimate"]
    assert table["static gain of u"] == pytest.approx(0.5)
    assert table["static gain of w"] == pytest.approx(-0.25)
    assert table["damping ratio"] == pytest.approx(0.25)


def test_units_follow_from_those_of_the_variables():
    law = law_of("s' = -V s/(K + s)", units={"s": "mmol/L", "t": "min"}, V=2.0, K=0.5)
    assert law.quantities().set_index("symbol")["unit"].to_dict() == {
        "V_max": "mmol/l/min",
        "K_m": "mmol/l",
        "V/K": "1/min",
    }
    unknown = law_of("s' = -V s/(K + s)", units={"t": "min"}, V=2.0, K=0.5)
    assert [*unknown.quantities()["unit"]] == ["", "", "1/min"]


@pytest.mark.parametrize(
    ("text", "symbol", "fitting", "unfitting"),
    [
        ("v' = g - c v^2", "v_t", {"v": "cm/s"}, {"v": "mg/dL"}),
        ("d' = -a d; c' = p d - k c", "CL", {"d": "mg", "c": "ug/L"}, {"d": "mg/L", "c": "mg/L"}),
    ],
)
def test_a_form_has_the_dimensions_of_its_quantities_or_unknown_units(text, symbol, fitting, unfitting):
    values = {"g": 0.9, "c": 0.1} if "g" in text else {"a": 0.4, "p": 0.5, "k": 0.2}
    quoted = [symbol in found(law_of(text, units=units, **values)) for units in (fitting, {}, unfitting)]
    assert quoted == [True, True, False]


def test_parts_of_the_equations_have_forms_of_their_own():
    table = law_of("S' = -b S I; I' = b S I - g I; R' = g I", b=0.6, g=0.2).quantities()
    assert {*table["form"]} == {"SIR epidemic of S, I"}
    table = law_of("a' = -k a; b' = r b", k=0.5, r=2.0).quantities()
    assert {"First-order relaxation of a", "Exponential growth of b"} <= {*table["form"]}
    assert "First-order relaxation of a" not in {*law_of("a' = -k a + b; b' = r b", k=0.5, r=2.0).quantities()["form"]}


@pytest.mark.parametrize("text", ["x' = r x (1 - x/K)", "x' = r x - s x^3", "x' = r x - s x^2 + c t", "x' = r x u"])
def test_other_equations_and_signs_have_no_form(text):
    inputs = ("u",) if "u" in text else ()
    names = {"r": -0.8, "K": 2.0, "s": 0.3, "c": 0.1}
    law = law_of(text, inputs=inputs, **{name: value for name, value in names.items() if name in text})
    assert {*law.quantities()["form"]} <= {"Equilibria"}


def test_discrete_time_has_no_quantities():
    assert len(law_of("x[k+1] = r x", r=0.5).quantities()) == 0


def test_a_ratio_of_rates_is_a_reproduction_number_of_fractions_alone():
    law = law_of("S' = -b S I; I' = b S I - g I", b=0.002, g=0.5)
    domain = replace(law.provenance.domain, visited={"S": (20.0, 763.0), "I": (1.0, 300.0)})
    counts = replace(law, provenance=replace(law.provenance, domain=domain))
    assert {*found(law)} - {*found(counts)} == {"R0"}


@pytest.mark.parametrize("terms", ["p a + q a u", "p a + q a u^2", "p a + q a t", "p a + q b u"])
def test_rates_that_depend_on_inputs_or_time_have_no_modes(terms):
    law = law_of(f"a' = {terms}; b' = s a + w b", inputs=("u",), p=-10.0, q=0.03, s=1.0, w=-0.2)
    assert len(law.quantities()) == 0


def test_linear_systems_have_modes():
    values = {"p": -0.9, "q": -0.8, "r": 0.1, "s": 0.9, "u": -0.5, "w": 0.2, "z": -0.7}
    matrix = np.array([[-0.9, -0.8, 0.1], [0.9, -0.5, 0.0], [0.0, 0.2, -0.7]])
    table = law_of("a' = p a + q b + r c; b' = s a + u b; c' = w b + z c", **values).quantities().set_index("symbol")
    (real, _, mode) = sorted(np.linalg.eigvals(matrix), key=lambda value: value.imag**2)
    expected = [-1 / real.real, 2 * np.pi / abs(mode.imag), -mode.real / abs(mode)]
    assert table.loc[["τ", "T", "ζ"], "estimate"].tolist() == pytest.approx(expected)


def test_equilibria_have_values_errors_and_kinds():
    """Those of x' = r x - s x^3 are 0 and -+ sqrt(r/s)."""
    covariance = np.array([[0.01, 0.002], [0.002, 0.03]])
    law = law_of("x' = r x - s x^3", covariance, r=2.0, s=1.0)
    table = law.quantities()
    assert [*table["quantity"]] == ["equilibrium 1, stable", "equilibrium 2, unstable", "equilibrium 3, stable"]
    root = np.sqrt(2.0)
    assert table["estimate"].tolist() == pytest.approx([-root, 0.0, root], abs=1e-9)
    gradient = np.array([1 / (2 * root), root / 2])  # By r and by the coefficient of x^3, which is -s
    error = np.sqrt(gradient @ covariance @ gradient)
    assert table["standard error"].tolist() == pytest.approx([error, 0.0, error], rel=1e-5, abs=1e-12)
    assert [*law_of("x' = a x - b x y; y' = c x y - d y", a=1.0, b=1.0, c=1.0, d=1.0).quantities()["quantity"]][-1] == (
        "equilibrium 2, centre of its linearization"
    )


def test_stability_that_estimates_do_not_decide_is_uncertain():
    law = law_of("x'' = c v - k x - b x^3", np.diag([0.04, 0.01, 0.01]), c=0.1, k=1.0, b=1.0)
    (kind,) = law_of("x'' = f + c v - k x", np.diag([0.01, 0.04, 0.01]), f=1.0, c=0.1, k=1.0).quantities()["quantity"][
        -1:
    ]
    assert kind == "equilibrium, stability uncertain"
    assert "Equilibria" not in {*law.quantities()["form"]}


def fieller(a, b, covariance, z):
    """Return the ends of Fieller's interval of a/b, from its quadratic equation."""
    (vaa, vab), (_, vbb) = covariance
    roots = np.roots([b**2 - z**2 * vbb, -2 * (a * b - z**2 * vab), a**2 - z**2 * vaa])
    return sorted(roots.real)


def test_intervals_of_ratios_are_those_of_fieller():
    covariance = np.array([[0.09, -0.01], [-0.01, 0.0025]])
    law = law_of("x'' = -g - c v", covariance, g=9.8, c=0.3)
    row = law.quantities().iloc[0]
    slopes = np.array([1 / 0.3, -9.8 / 0.09])
    assert row["standard error"] == pytest.approx(np.sqrt(slopes @ covariance @ slopes), rel=1e-4)
    assert [row["low"], row["high"]] == pytest.approx(fieller(9.8, 0.3, covariance, Z), rel=1e-4)


def test_a_quantity_that_is_a_parameter_has_the_interval_of_this():
    """Of the volume in dose/V, that of V and not of 1/V."""
    times = np.linspace(1, 8, 8)
    measured = 100 / 12 * np.exp(-0.3 * times) * (1 + 0.1 * np.random.default_rng(0).standard_normal(8))
    trials = cl.Trials.from_arrays([times], [measured], names=["C"])
    law = cl.fit("C' = -k C; C(0) = 100/V", trials, errors="white")
    named, quantities = law.params.set_index("parameter"), law.quantities().set_index("symbol")
    columns = ["estimate", "standard error", "low", "high"]
    for name in {*named.index} & {*quantities.index}:
        assert quantities.loc[name, columns].tolist() == pytest.approx(named.loc[name, columns].tolist(), rel=1e-9)
    assert {"k"} <= {*named.index} & {*quantities.index}


def test_an_interval_is_unbounded_where_the_denominator_may_be_zero():
    law = law_of("x'' = -g - c v", np.diag([0.01, 0.0025]), g=9.8, c=0.06)
    row = law.quantities().iloc[0]
    assert row["high"] == np.inf
    assert row["low"] == pytest.approx(max(fieller(9.8, 0.06, np.diag([0.01, 0.0025]), Z)), rel=1e-3)
    narrow = law.quantities(level=0.5).iloc[0]
    assert row["low"] < narrow["low"] < narrow["high"] < np.inf


def test_an_interval_ends_where_its_function_ends():
    """At critical damping the slow time constant 2/(c - sqrt(c^2 - 4 k)) ends at 2/c, and a period is infinite."""
    law = law_of("x'' = -k x - c v", np.diag([0.04, 0.0]) + 1e-18 * np.eye(2), k=1.0, c=2.05)
    table = law.quantities().set_index("symbol")
    assert table.loc["τ_1", "low"] == pytest.approx(2 / 2.05, rel=1e-3)
    law = law_of("x'' = -k x - c v", np.diag([0.04, 0.0]) + 1e-18 * np.eye(2), k=1.0, c=1.95)
    assert law.quantities().set_index("symbol").loc["T", "high"] == np.inf


def test_a_fit_that_did_not_converge_has_no_quantities():
    law = cl.Law.from_text("x' = -k x", {"k": 0.3})
    assert len(law.quantities()) > 0
    stopped = replace(law, provenance=replace(law.provenance, outcomes=(note("fit-not-converged-from-guesses"),)))
    assert stopped.quantities().empty
    assert list(stopped.quantities()) == list(law.quantities())
    assert quantities_by_object(stopped).empty
    assert law.summary().count("half-life") == 1 + stopped.summary().count("half-life")


def test_a_fit_whose_solution_diverges_has_no_quantities():
    """On a linear scale small values have no weight: the first is fitted below zero, where growth runs away."""
    times = np.arange(13.0)
    sizes = 9e8 / (1 + 1e8 * np.exp(-1.85 * times)) * np.exp(0.12 * np.random.default_rng(9).standard_normal(13))
    trials = cl.Trials.from_frame(pd.DataFrame({"t": times, "n": sizes}))
    law = cl.fit("n' = r n (1 - n/K)", trials, errors="white")
    assert fitted(law, trials).outcomes
    assert "fit-diverges" in [outcome.code for outcome in law.diagnostics]
    assert law.quantities().empty


def test_without_covariance_there_are_values_alone():
    row = law_of("x' = -k x", k=0.5).quantities().iloc[1]
    assert row["estimate"] == pytest.approx(np.log(2) / 0.5)
    assert np.isnan(row[["standard error", "low", "high"]].astype(float)).all()


FUNCTIONS = {
    "ratio": (lambda rows: rows[:, 0] / rows[:, 1], [9.8, 0.3], [[0.09, -0.01], [-0.01, 0.004]]),
    "half-life": (lambda rows: np.log(2) / rows[:, 0], [0.5], [[0.02]]),
    "period": (
        lambda rows: 2 * np.pi / np.sqrt(rows[:, 0] - rows[:, 1] ** 2 / 4),
        [4.0, 0.5],
        [[0.2, 0.01], [0.01, 0.04]],
    ),
    "exponential": (lambda rows: np.exp(rows[:, 0] / rows[:, 1]), [1.0, 2.0], [[0.05, 0.0], [0.0, 0.05]]),
}


@pytest.mark.parametrize(
    "name", ["ratio", "period", *(pytest.param(name, marks=pytest.mark.slow) for name in ("half-life", "exponential"))]
)
def test_intervals_cover_the_truth_as_often_as_they_say(name):
    function, center, matrix = FUNCTIONS[name]
    truth, covariance = np.array(center), np.array(matrix)
    value = function(truth[np.newaxis])[0]
    draws = np.random.default_rng(0).multivariate_normal(truth, covariance, 200)
    covered = [each.low <= value <= each.high for each in (propagated(function, draw, covariance, Z) for draw in draws)]
    assert np.mean(covered) == pytest.approx(0.95, abs=0.025)


def test_initial_values_of_other_states_are_refused():
    with refused("unknown-name"):
        law_of("x' = -k x", k=0.5).quantities(initial={"y": 1.0})


def test_doses_and_boluses_have_volumes_and_clearances():
    times = np.linspace(0.0, 8.0, 40)
    trials = cl.Trials.from_arrays(
        times,
        4.0 * np.exp(-0.3 * times) * (1 + 1e-3 * np.random.default_rng(0).standard_normal(40)),
        names=["c"],
        units={"c": "mg/L", "t": "h", "dose": "mg"},
        properties={"object": {"dose": 8.0}},
    )
    table = cl.fit("one-compartment", trials).quantities().set_index("symbol")
    assert table.loc[["V", "CL", "t½"], "estimate"].tolist() == pytest.approx([2.0, 0.6, np.log(2) / 0.3], rel=0.01)
    assert table.loc[["V", "CL", "t½"], "unit"].tolist() == ["l", "l/h", "h"]


def dosed(text, *doses, measured=(), **values):
    """Return a law with doses of which these quantities were measured, by observation equations or as states."""
    law = law_of(text, inputs=doses, **values)
    law = replace(law, schema=replace(law.schema, doses=doses))
    observed = {name: right for name, right in measured if right}
    schema = Schema(tuple(name for name, _ in measured))
    return replace(law, observation=Observation(schema, observed, initial_time=0.0), scheme="shooting")


def test_volumes_are_those_of_measured_concentrations():
    """An absorbed fraction of 0.6 is no volume of 1/0.6, and an absorption rate constant none of elimination."""
    chain = dosed(
        "D' = -ka D + F A; C' = ka D - k C + B", "A", "B", measured=[("DV", "C/V")], ka=0.8, F=0.6, k=0.1
    ).quantities()
    assert not {*chain["symbol"]} & {"V", "CL", "k"}
    by_name = chain.set_index("quantity")["estimate"]
    assert by_name["rate constant of D"] == pytest.approx(0.8)
    assert by_name["half-life of D"] == pytest.approx(np.log(2) / 0.8)
    assert found(dosed("c' = -k c + A/V", "A", measured=[("c", "")], k=0.3, V=4.0))["CL"] == pytest.approx(1.2)
    assert "V" not in found(dosed("C' = -k C + A/V", "A", measured=[("y", "2 C")], k=0.3, V=4.0))


def test_symbols_of_parameters_of_other_values_are_left_out():
    table = law_of("x' = r x - K x^2", r=0.8, K=0.4).quantities().set_index("quantity")
    assert table.loc["carrying capacity", ["symbol", "estimate"]].tolist() == ["", pytest.approx(2.0)]
    assert table.loc["growth rate", "symbol"] == "r"


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
        names = {*re.findall(r"[A-Za-z]\w*", model.equations)} - {"t", "abs", "sin", "cos", "log", "sqrt"}
        assert names == {*model.variables, *model.parameters}, model.name
        assert {*model.states} == {*re.findall(r"(\w+)'+ =", model.equations)}
        assert {*model.doses} <= {*model.inputs}
        assert {*model.units} <= {*model.variables}
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


def test_quantities_of_several_equations_of_one_form_stand_apart_in_tables():
    frame = quantities_by_object(cl.Law.from_text("x' = -2 x; y' = -3 y"))
    assert [name for name in frame if "rate constant" in name] == ["rate constant of x k", "rate constant of y k"]
    assert len([name for name in quantities_by_object(cl.Law.from_text("x' = -2 x")) if name == "rate constant k"]) == 1
