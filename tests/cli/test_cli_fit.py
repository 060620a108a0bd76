"""Equations fitted on the command line, with orders by state, positive states, or no option at all."""

import json
import re

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law.parameters import named_parameters
from tests.ordinary_tables import ORDINARY

pytestmark = pytest.mark.usefixtures("few_starts")


@pytest.fixture
def cups(tmp_path):
    """Two cups of tea that cool in rooms of 20 degrees, by a table with a column of no use."""
    noise, frame = np.random.default_rng(3), pd.DataFrame({"min": np.tile(np.arange(0.0, 30.0, 2.5), 2)})
    frame["cup"], rates = np.repeat(["thin", "thick"], 12), np.repeat([0.1, 0.05], 12)
    frame["T"] = 20 + 60 * np.exp(-rates * frame["min"]) + noise.normal(0, 0.2, len(frame))
    frame["light"] = noise.normal(size=len(frame))
    frame.to_csv(tmp_path / "cups.csv", index=False)


ROLES = ("--object", "cup", "--time", "min")


@pytest.mark.usefixtures("cups")
def test_fit_finds_the_coefficients_of_an_equation_by_their_names(run, tmp_path):
    code, out, err = run("fit", "cups.csv", "dT/dt = -k (T - 20)", *ROLES, "--save", "law.json", "--save", "law.svg")
    assert (code, err) == (0, "Note: columns left out: light\n")
    assert "dT/dt = -k (T - 20)" in out
    law = cl.Law.load(tmp_path / "law.json")
    assert law.schema.states == ("T",)
    assert named_parameters(law).values.ravel() == pytest.approx([0.1, 0.05], rel=0.02)
    assert (tmp_path / "law.svg").stat().st_size > 0


@pytest.mark.usefixtures("cups")
def test_columns_that_occur_on_the_right_are_inputs(run, tmp_path):
    code, *_ = run("fit", "cups.csv", "T' = a + b T + c light", *ROLES, "--save", "law.json")
    assert code == 0
    assert cl.Law.load(tmp_path / "law.json").schema.inputs == ("light",)


def test_a_letter_that_is_a_varying_column_is_an_input_with_a_note(run, tmp_path):
    times = np.linspace(0, 5, 30)
    driven = pd.DataFrame({"t": times, "x": 1 - np.exp(-times), "c": 1 + np.sin(times) ** 2})
    driven.to_csv(tmp_path / "driven.csv", index=False)
    equation = ("fit", "driven.csv", "x' = -k x + c b", "--set", "errors=white", "--save", "law.json")
    for more, is_noted in ((), True), (("--input", "c"), False):
        code, _, err = run(*equation, *more)
        assert (code, ": c; " in err) == (0, is_noted)
        assert cl.Law.load(tmp_path / "law.json").schema.inputs == ("c",)


def test_constants_inside_of_terms_are_fitted_saved_and_forecast_with(run, done, tmp_path):
    times, enzymes = np.linspace(0, 6, 40), cl.Law.from_text("s' = -V s/(K + s)", {"V": 1.0, "K": 0.5})
    exact = enzymes.simulate(times, [3.0])["object"].states[:, 0]
    noise = np.random.default_rng(0).normal(0, 0.02, len(times))
    pd.DataFrame({"min": times, "s": exact + noise}).to_csv(tmp_path / "s.csv", index=False)
    code, out, err = run("fit", "s.csv", "s' = -V s/(K + s)", "--time", "min", "--save", "law.json")
    assert (code, err) == (0, "")
    assert "s' = -V s/(K + s)" in out
    law = cl.Law.load(tmp_path / "law.json")
    parameters = named_parameters(law)
    values, errors = parameters.values, parameters.errors
    assert (np.abs(values - [1.0, 0.5]) < 3 * errors).all()
    for command in (("show", "law.json", "--latex"), ("predict", "s.csv", "law.json"), ("check", "s.csv", "law.json")):
        done(*command)
    code, out, _ = run("compare", "s.csv", "--time", "min", "s' = -V s/(K + s)", "s' = -k s")
    assert (code, out.index("V s") < out.index("k s")) == (0, True)


@pytest.mark.usefixtures("cups")
@pytest.mark.parametrize(
    ("equation", "message"),
    [
        ("T' = a + b (T", "at character 12, '(': this parenthesis is not closed: add ')'; variables: T, min"),
        ("Q' = a", "unknown column 'Q'"),
        ("T' = -k T + b sin(q)", "b, q are not identifiable"),
        ("T[k+1] = a T", "do not support noise"),
    ],
)
def test_what_cannot_be_fitted_is_one_line_on_stderr(run, equation, message):
    code, out, err = run("fit", "cups.csv", equation, *ROLES, "--noise", "T=0.2")
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert message in err


def test_noise_may_be_that_of_each_value_of_a_property(run, done, tmp_path):
    times, rng = np.linspace(0, 5, 60), np.random.default_rng(0)
    frames = [
        pd.DataFrame({"cell": f"{lab}{k}", "lab": lab, "time": times, "s": 2 * np.exp(-times / 2)}).assign(
            s=lambda frame, std=std: frame["s"] + std * rng.standard_normal(60)
        )
        for lab, std in {"A": 0.01, "B": 0.1}.items()
        for k in (1, 2)
    ]
    pd.concat(frames).to_csv(tmp_path / "cells.csv", index=False)
    text = ("fit", "cells.csv", "x' = -k x; s = c x; x(0) = 1", "--noise", "s=lab", "--save", "l.json")
    done(*text)
    law = cl.Law.load(tmp_path / "l.json")
    assert [law.uncertainty.noise_of["s"][cell] for cell in ("A1", "B1")] == pytest.approx([0.01, 0.1], rel=0.25)
    assert run("discover", "cells.csv", "--noise", "s=lab")[0] == 2


def test_a_state_without_a_column_starts_at_a_dose(done, tmp_path):
    times, rates, doses = np.arange(0.0, 12.0, 0.75), (1.5, 0.3), {"a": 80.0, "b": 120.0}
    decay = np.exp(-np.outer(rates, times))
    rows = [
        (name, dose, t, dose / 20 * rates[0] / (rates[0] - rates[1]) * (slow - fast))
        for name, dose in doses.items()
        for t, fast, slow in zip(times, *decay, strict=True)
    ]
    table = pd.DataFrame(rows, columns=["person", "dose", "h", "conc"])
    table["conc"] += np.random.default_rng(0).normal(0, 0.02, len(table))
    table.to_csv(tmp_path / "doses.csv", index=False)
    roles = ("--object", "person", "--time", "h")
    equations = "depot' = -ka depot; conc' = ka depot/V - k conc"
    assert "RMS residual of conc" in done(
        "fit", "doses.csv", equations, *roles, "--initial-value", "depot=dose", "--save", "law.json"
    )
    values = named_parameters(cl.Law.load(tmp_path / "law.json")).values
    assert values == pytest.approx(np.tile([1.5, 20.0, 0.3], (2, 1)), rel=0.1)
    assert "conc" in done("predict", "doses.csv", "law.json")


def test_rows_of_doses_are_no_samples(done, tmp_path):
    """Eight concentrations after two doses in rows of their own."""
    times = np.array([1.0, 2.0, 4.0, 7.0, 9.0, 10.0, 12.0, 15.0])
    course = sum(5 * np.exp(-0.3 * (times - at)) * (times > at) for at in (0.0, 8.0))
    noisy = course + np.random.default_rng(0).normal(0, 0.05, 8)
    rows = [*((t, c, "") for t, c in zip(times, noisy, strict=True)), (0.0, "", 100.0), (8.0, "", 100.0)]
    pd.DataFrame(sorted(rows), columns=["h", "conc", "AMT"]).to_csv(tmp_path / "doses.csv", index=False)
    out = done("fit", "doses.csv", "conc' = -k conc + AMT/V", "--dose", "AMT")
    assert re.findall(r"(\d+) samples", out.splitlines()[0]) == ["8"]


@pytest.mark.usefixtures("cups")
def test_fit_prints_each_parameter_of_each_object_with_its_interval(done, tmp_path):
    done("data", "check", "cups.csv", *ROLES, "--state", "T", "--unit", "min=min", "--save", "schema.toml")
    out = done("fit", "cups.csv", "T' = -k (T - a)", "--schema", "schema.toml", "--save", "law.json")
    law = cl.Law.load(tmp_path / "law.json").conf_int()
    lines = out.splitlines()
    head = next(
        i for i, line in enumerate(lines) if line.split() == ["cup", "k", "(1/min)", "a", "RMS", "residual", "of", "T"]
    )
    for name, rows in law.groupby("object", sort=False):
        at = next(i for i, line in enumerate(lines) if i > head and line.split()[:1] == [name])
        # Estimate and standard error, and on the line below the ends of the interval
        pairs = [
            re.findall(rf"(\S+) {word} (\S+)", line) for line, word in zip(lines[at : at + 2], ("±", "to"), strict=True)
        ]
        for k, row in enumerate(rows.itertuples(index=False)):
            numbers = [float(number) for numbers in pairs for number in numbers[k]]
            assert numbers == pytest.approx(list(row[4:8]), rel=0.02, abs=0.06 * row[5])


@pytest.mark.usefixtures("cups")
@pytest.mark.parametrize(
    ("given", "order"),
    [
        (("fit", "cups.csv", "cups.csv"), "fit TABLE EQUATIONS"),
        (("fit", "T' = -k T", "cups.csv"), "fit TABLE EQUATIONS"),
        (("fit", "logistic", "dataset:linear-drag"), "fit TABLE EQUATIONS"),
        (("fit", "T' = -k T"), "fit TABLE EQUATIONS"),
        (("compare", "T' = -k T", "T' = -0.1 T", "cups.csv"), "compare TABLE LAW LAW..."),
        (("predict", "cups.csv", "cups.csv"), "predict TABLE LAW.json"),
        (("predict", "law.json", "cups.csv"), "predict TABLE LAW.json"),
        (("predict", "law.parquet", "dataset:linear-drag"), "predict TABLE LAW.json"),
        (("predict", "law.parquet", "runs/*.parquet"), "predict TABLE LAW.json"),
        (("predict", "law.json"), "predict TABLE LAW.json"),
        (("discover", "law.json"), "discover TABLE [MORE TABLES]..."),
        (("show", "cups.csv"), "show LAW.json"),
    ],
)
def test_what_is_in_the_place_of_another_is_refused_with_the_order(run, tmp_path, given, order):
    cl.Law.from_text("T' = -k T", {"k": 0.1}).save(tmp_path / "law.json")
    code, _, err = run(*given)
    assert (code, err.rstrip().endswith(f": write commonlaw {order}")) == (2, True)


@pytest.mark.usefixtures("cups")
def test_models_of_textbooks_are_fitted_by_name(run, done):
    by_name = run("fit", "cups.csv", "newton-cooling", *ROLES, "--json")
    written = run("fit", "cups.csv", "T' = -k (T - a); k > 0", *ROLES, "--json")
    assert by_name[0] == written[0] == 0
    laws = [json.loads(out)["law"]["coefficients"] for _, out, _ in (by_name, written)]
    assert laws[0] == laws[1]
    out = done("compare", "cups.csv", "newton-cooling", "exponential-decay:x=T", *ROLES)
    assert out.startswith("newton-cooling is the most probable of these laws.")


def test_models_are_listed_and_described(done, fails):
    out = done("models")
    assert [name for name in cl.named_models if f"  {name} " not in out] == []
    assert "  b: transmission rate" in done("models", "sir")
    assert "did you mean 'sir'?" in fails("models", "sri")


@pytest.mark.usefixtures("cups")
def test_a_law_is_saved_as_a_program_by_its_ending(done, tmp_path):
    assert "Wrote law.c\nWrote law.mo" in done(
        "fit", "cups.csv", "T' = -k (T - a)", *ROLES, "--save", "law.c", "--save", "law.mo"
    )
    assert "void derivatives(" in (tmp_path / "law.c").read_text()


EQUATIONS = "theta'' = -a sin(theta) - b theta' + k i; i' = -r i - m theta'"
OPTIONS = ["--library", "poly:1 + terms:sin(theta)"]


@pytest.fixture
def motor(tmp_path):
    """A table of a pendulum on a motor, written as motor.csv."""
    true = {"a": 4.0, "b": 0.3, "k": 1.5, "r": 1.2, "m": 0.4}
    swing = cl.Law.from_text(EQUATIONS, true).simulate(np.linspace(0, 6, 90), [1.2, 1.0, 0.5])["object"]
    values = swing.states[:, :2] + 0.01 * np.random.default_rng(1).standard_normal((90, 2))
    frame = pd.DataFrame({"t": swing.times, "theta": values[:, 0], "i": values[:, 1]})
    frame.to_csv(tmp_path / "motor.csv", index=False)


@pytest.mark.usefixtures("motor")
def test_orders_are_given_by_state(run, done):
    code, out, err = run("discover", "motor.csv", "--order", "theta=2,i=1", *OPTIONS, "--save", "law.json")
    assert (code, err.count("\n")) == (0, 1)
    assert "state: theta, i. To correct them, use --time ..." in err
    assert "theta'' = " in out
    assert "i' = " in out
    assert cl.Law.load("law.json").order == (2, 1)
    done("predict", "motor.csv", "law.json", "--save", "forecast.csv")
    assert "theta forecast" in pd.read_csv("forecast.csv")
    out = run("compare", "motor.csv", EQUATIONS, "law.json")[1]
    assert "2 log B" in out


@pytest.mark.parametrize(
    ("order", "message"),
    [
        ("theta=3,i=1", "3 is not in the range"),
        ("theta=2,theta=1", "gives theta twice"),
        ("theta=2", "no order is given for i: give 1 or 2 for each state"),
        ("theta=0,i=1", "order 0 of theta is not supported"),
    ],
)
@pytest.mark.usefixtures("motor")
def test_orders_that_do_not_fit_are_refused(run, order, message):
    code, _, err = run("discover", "motor.csv", "--order", order, *OPTIONS)
    assert code != 0
    assert message in err


def test_a_table_of_generations_hints_at_the_option_for_discrete_time(run, tmp_path):
    sizes = [0.3]
    for _ in range(60):
        sizes.append(3.9 * sizes[-1] * (1 - sizes[-1]))
    noise = 0.01 * np.random.default_rng(3).standard_normal(61)
    frame = pd.DataFrame({"generation": range(61), "size": sizes + noise})
    frame.to_csv(tmp_path / "flies.csv", index=False)
    code, _, err = run("discover", "flies.csv", "--time", "generation")
    assert code == 0
    assert "discover a law in discrete time: --order 0" in err
    code, out, err = run("discover", "flies.csv", "--time", "generation", "--order", "0")
    assert code == 0
    assert "size[k+1] = " in out
    assert "discrete time" not in err


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind != "growth in rows")) for kind in ORDINARY]
)
def test_a_table_alone_gives_its_law(done, tmp_path, kind):
    (tmp_path / "table.csv").write_text(ORDINARY[kind].table())
    out = done("discover", "table.csv", "--save", "law.json")
    law = cl.Law.load(tmp_path / "law.json")
    ORDINARY[kind].check(law)
    assert str(law).splitlines()[0] in out
