"""Coefficients of several terms, and parameters inside terms, in laws with latent states."""

import json
from functools import cache

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import curve_fit, least_squares
from scipy.stats import t as t_distribution

import commonlaw as cl
from commonlaw.cli.main import commonlaw
from commonlaw.inference.fit.structural_identifiability import has_symmetry
from commonlaw.law import from_json, to_json, to_script
from commonlaw.law.parameters import named_parameters
from commonlaw.law.parse import read_equations
from commonlaw.trials import Schema
from tests.refusals import refused
from tests.simulations import drawn

pytestmark = pytest.mark.usefixtures("few_starts")

HOURS = np.array([0.25, 0.5, 0.75, 1, 1.25, 2, 3, 4, 5, 6, 8])
DAYS = np.linspace(0, 40, 21)
SWALLOWED = np.array([0, 0.25, 0.5, 0.75, 1, 1.5, 2, 3, 4, 6, 8, 10, 12.0])
WHITE = {"errors": "white", "huber_threshold": np.inf, "partial_pooling": False}
MICROCONSTANTS = "conc' = -(k10 + k12) conc + k21 tissue; tissue' = k12 conc - k21 tissue"
EPIDEMIC = "S' = -b S I; I' = b S I - g I"
ALL_SHARED = {"a": "all", "k": "all"}
SATURATED = "depot' = -ka depot; conc' = ka depot/V - Vm conc/(Km + conc)"


def injected(values):
    """Concentrations after an injection, in closed form, by the first one, k10, k12, k21."""
    first, k10, k12, k21 = values
    matrix = np.array([[-(k10 + k12), k21], [k12, -k21]])
    return np.array([(expm(matrix * t) @ [first, 0.0])[0] for t in HOURS])


def infected(values):
    first, b, g = values

    def rates(_, z):
        return [-b * z[0] * z[1], b * z[0] * z[1] - g * z[1]]

    return solve_ivp(rates, (0, 40), [990.0, first], t_eval=DAYS, rtol=1e-10, atol=1e-8).y[1]


def saturated(values):
    first, ka, volume, most, half = values

    def rates(_, z):
        return [-ka * z[0], ka * z[0] / volume - most * z[1] / (half + z[1])]

    return solve_ivp(rates, (0, 12), [100.0, first], t_eval=SWALLOWED, rtol=1e-10, atol=1e-10, method="LSODA").y[1]


CASES = {
    "microconstants": (MICROCONSTANTS, injected, (3.3, 1.07, 0.83, 0.53), ("k10", "k12", "k21"), "conc"),
    "epidemic": (EPIDEMIC, infected, (10.0, 5e-4, 0.15), ("b", "g"), "I"),
    "saturated": (SATURATED, saturated, (0.0, 1.5, 20.0, 1.0, 1.5), ("ka", "V", "Vm", "Km"), "conc"),
}
TIMES = {"microconstants": HOURS, "epidemic": DAYS, "saturated": SWALLOWED}
STARTS = {
    "microconstants": {"initial_values": {"tissue": 0.0}, "initial_time": 0.0},
    "epidemic": {"initial_values": {"S": 990.0}},
    "saturated": {"initial_values": {"depot": 100.0}},
}


@cache
def of_persons(case):
    """Return numbers of two persons, noise, what was measured, trials of it, and their law."""
    equations, solution, truth, _, name = CASES[case]
    values, noise, measured = drawn(solution, truth, 2, seed=1)
    trials = cl.Trials.from_arrays([TIMES[case]] * 2, measured, object=["person 0", "person 1"], names=[name])
    return values, noise, measured, trials, cl.fit(equations, trials, **STARTS[case], noise={name: noise}, **WHITE)


@pytest.mark.parametrize("case", CASES)
def test_estimates_and_errors_are_those_of_independent_least_squares(case):
    _, solution, _, parameter_names, _ = CASES[case]
    truth, noise, measured, _, law = of_persons(case)
    parameters = named_parameters(law)
    columns = [parameters.names.index(parameter) for parameter in parameter_names]
    values, errors = (each[:, columns] for each in (parameters.values, parameters.errors))
    for value, error, data, begin in zip(values, errors, measured, truth, strict=True):
        scale = np.abs(begin) + 0.01
        found = least_squares(lambda each, data=data: (solution(each) - data) / noise, begin, x_scale=scale, xtol=1e-12)
        bound = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))
        assert (abs(value - found.x[1:]) < 0.1 * error).all()
        np.testing.assert_allclose(error, bound[1:], rtol=0.06)


def test_the_law_is_written_saved_and_forecast_with_as_it_was_stated():
    *_, trials, law = of_persons("microconstants")
    assert law.structure == tuple(MICROCONSTANTS.split("; "))
    again = from_json(to_json(law))
    assert str(again) == str(law)
    assert "initial_time=0.0" in to_script(law)
    assert ("start", "tissue = 0.0 at t = 0") in [(each.stage, each.choice) for each in law.history]
    forecast = again.predict(trials)
    assert forecast.score() > 0.99
    assert [trajectory.times[0] for trajectory in forecast.trajectories] == [0.0] * 2
    assert again.assess(trials).usable


def test_the_command_line_takes_the_time_of_the_starts(tmp_path):
    times = np.linspace(0.25, 4, 12)
    measured = 10 * (np.exp(-0.5 * times) - np.exp(-times)) + 0.01 * np.random.default_rng(0).standard_normal(12)
    cl.Trials.from_arrays([times], [measured], names=["conc"]).to_csv(tmp_path / "injected.csv")
    options = ["--initial-value", "tissue=5", "--initial-time", "0", "--set", "errors=white"]
    table, saved = str(tmp_path / "injected.csv"), ["--save", str(tmp_path / "law.json")]
    done = CliRunner().invoke(
        commonlaw, ["fit", table, "conc' = k tissue - m conc; tissue' = -k tissue", *saved, *options]
    )
    assert done.exit_code == 0, done.output
    assert cl.Law.load(tmp_path / "law.json").schema.initial_time == 0.0


@pytest.mark.parametrize(
    ("equations", "free"),
    [
        (MICROCONSTANTS, False),
        ("conc' = -a conc + b tissue; tissue' = c conc - d tissue", True),
        ("conc' = -a conc + b tissue; tissue' = conc - d tissue", False),
        ("conc' = -a conc + b tissue; tissue' = c conc - 1 tissue", True),
        ("conc' = -a conc + b tissue; tissue' = k (conc - tissue)", False),
        ("conc' = -a conc - b conc tissue^2; tissue' = c conc - d tissue", True),
        ("conc' = -a conc tissue/(K + tissue); tissue' = c conc - d tissue", True),
    ],
)
def test_whether_a_state_may_be_counted_in_another_unit(equations, free):
    given = read_equations(equations, Schema(("conc", "tissue")))
    found = has_symmetry("scaling", given.terms, given.known, np.array([False, True]), np.full(3, np.nan))
    assert found.tolist() == [False, free]


def test_what_cannot_be_told_is_refused():
    *_, trials, _ = of_persons("microconstants")
    with refused("latent-scale-of-zero", name="tissue"):
        cl.fit("conc' = -a conc + b tissue; tissue' = c conc - 1 tissue", trials, initial_values={"tissue": 0.0})
    with refused("initial-time-late", time=0.25, initial_time=0.5):
        cl.fit(MICROCONSTANTS, trials, initial_values={"tissue": 0.0}, initial_time=0.5)
    with refused("initial-time-without-values"):
        cl.fit("conc' = -k conc", trials, initial_time=0.0)
    with refused("term-twice", term="conc"):
        cl.fit("conc' = -(a + b) conc", trials)


@pytest.mark.slow
def test_rates_that_share_a_factor_are_fitted_as_those_that_do_not():
    random, times, flow = np.random.default_rng(0), np.linspace(0, 6, 15), np.array([[-1.3, 0], [1.3, -1.6]])
    states = np.array([expm(flow * time)[:, 0] for time in times]) + 0.005 * random.standard_normal((15, 2))
    trials = cl.Trials.from_arrays(times, states, names=["x", "y"])
    one, other = (
        dict(zip(found.names, found.values[0], strict=True))
        for equations in ("x' = -f k x; y' = f k x - f y", "x' = -k x; y' = k x - f y")
        for found in [named_parameters(cl.fit(equations, trials, errors="white"))]
    )
    assert (one["f"], one["f"] * one["k"]) == pytest.approx((other["f"], other["k"]), rel=1e-5)


def test_latent_states_that_share_their_only_parameter_are_fitted():
    times, noise = np.linspace(0, 12, 40), 0.003
    chain = np.diag(np.ones(3), -1) - np.eye(4)

    def outflow(times, rate):
        return np.array([expm(rate * time * chain)[-1, 0] for time in times])

    measured = outflow(times, 1.1) + noise * np.random.default_rng(0).standard_normal(40)
    trials = cl.Trials.from_arrays(times, measured, names=["x4"])
    equations = ["x1' = -f x1", *(f"x{i}' = f x{i - 1} - f x{i}" for i in (2, 3, 4))]
    starts = {"x1": 1.0, "x2": 0.0, "x3": 0.0}
    law = cl.fit(equations, trials, initial_values=starts, noise={"x4": noise}, **WHITE)
    (rate,), covariance = curve_fit(outflow, times, measured, [1.0], np.full(40, noise), absolute_sigma=True)
    parameters = named_parameters(law)
    assert parameters.values[0] == pytest.approx([rate], abs=0.05 * np.sqrt(covariance[0, 0]))
    assert parameters.errors[0] == pytest.approx(np.sqrt(covariance[0]), rel=0.05)


def test_parameters_that_enter_as_a_product_alone_are_refused_with_latent_states():
    times = np.linspace(0, 6, 15)
    trials, starts = cl.Trials.from_arrays(times, times**2 / 2 * np.exp(-times), names=["z"]), {"x": 1.0, "y": 0.0}
    with refused("parameters-not-identifiable", names="f, k"):
        cl.fit("x' = -f k x; y' = f k x - f k y; z' = f k y - f k z", trials, initial_values=starts, errors="white")
    law = cl.fit("x' = -f k x; y' = f k x - f k y; z' = f k y - f z", trials, initial_values=starts, errors="white")
    np.testing.assert_allclose(named_parameters(law).values, 1.0, atol=0.01)


@pytest.mark.slow
def test_objects_with_as_many_unknowns_as_samples_share_coefficients_in_one_fit():
    random, times = np.random.default_rng(0), np.array([1.0, 4.0, 6.0])
    first = random.uniform(8, 12, 12)
    values = first[:, np.newaxis] * np.exp(-0.3 * (times - 1)) + 0.1 * random.standard_normal((12, 3))
    owners = [f"subject {i}" for i in range(12)]
    trials = cl.Trials.from_arrays([times] * 12, [own[:, np.newaxis] for own in values], object=owners, names=["c"])

    def residuals(unknown):
        k, m, starts = unknown[0], unknown[1], unknown[2:, np.newaxis]
        return ((starts + m / k) * np.exp(-k * (times - 1)) - m / k - values).ravel()

    found = least_squares(residuals, [0.3, 0.1, *first], xtol=1e-12, ftol=1e-12)
    errors = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)) * 2 * found.cost / (36 - 14))
    row = cl.fit("c' = -k c - m", trials, shared=["k", "m"], errors="white").params.query("object == 'subject 3'")
    np.testing.assert_allclose(row["estimate"], found.x[:2], rtol=1e-4)
    np.testing.assert_allclose(row["standard error"], errors[:2], rtol=0.02)


def test_a_comparison_keeps_shared_parameters():
    """Whichever way they were stated, and of laws that objects do not share: their evidence is that of `cl.fit`."""
    times, random = np.linspace(0, 4, 12), np.random.default_rng(3)
    states = [3 * np.exp(-0.5 * times) + 1 + 0.05 * random.standard_normal(12) for _ in range(3)]
    trials = cl.Trials.from_arrays([times] * 3, states, object=["a", "b", "c"], names=["x"])
    text = "x' = a - k x"
    schemes = "collocation", "shooting"
    pooled, jointly = (cl.fit(text, trials, shared=ALL_SHARED, scheme=scheme, errors="white") for scheme in schemes)
    apart = cl.fit(text, trials, errors="white")
    frames = [cl.compare({"shared": law, "apart": apart}, trials).set_index("law") for law in (pooled, jointly)]
    assert frames[0]["2 log B"].to_dict() == pytest.approx(frames[1]["2 log B"].to_dict(), abs=1e-3)
    # Scatter of two coefficients does not explain the noise: the logarithm of 3 for each
    assert frames[0]["2 log B"]["apart"] == pytest.approx(2 * np.log(3), abs=1)
    assert frames[0]["2 log B"]["shared"] == 0
    with refused("process-noise-with-observation"):
        cl.compare({"shared": pooled}, trials, errors="random-walk")


def three_decays():
    times = np.linspace(0, 4, 12)
    random = np.random.default_rng(5)
    starts = np.array([2.0, 5.0, 9.0])[:, np.newaxis]
    values = starts * np.exp(-0.6 * times) + 0.1 * random.standard_normal((3, 12))
    names = ["a", "b", "c"]
    frame = [(name, t, x) for name, row in zip(names, values, strict=True) for t, x in zip(times, row, strict=True)]
    return times, values, cl.Trials.from_frame(pd.DataFrame(frame, columns=["cup", "t", "x"]), object="cup")


@pytest.mark.parametrize("scheme", ["collocation", "shooting"])
def test_shared_coefficients_are_those_of_least_squares_of_all_objects(scheme):
    times, values, trials = three_decays()
    law = cl.fit("x' = -k x", trials, shared="k", scheme=scheme, errors="white")

    def curves(_, k, *starts):
        return np.concatenate([start * np.exp(-k * times) for start in starts])

    best, covariance = curve_fit(curves, np.arange(values.size), values.ravel(), [0.5, 2, 5, 9])
    row = law.params.iloc[0]
    assert row["estimate"] == pytest.approx(best[0], abs=1e-4 * covariance[0, 0] ** 0.5)
    assert row["standard error"] == pytest.approx(covariance[0, 0] ** 0.5, rel=1e-4)
    reach = t_distribution.ppf(0.975, values.size - 4) * covariance[0, 0] ** 0.5
    assert row["high"] - row["low"] == pytest.approx(2 * reach, rel=1e-3)
    assert ("scheme", scheme) in {(step.stage, step.choice) for step in law.history}
    assert "errors" not in {step.stage for step in law.history}
    if scheme == "shooting":
        chosen = cl.fit("x' = -k x", trials, shared="k", scheme=scheme)
        assert ("errors", "white noise") in {(step.stage, step.choice) for step in chosen.history}


def test_refined_laws_keep_what_their_objects_share():
    _, _, trials = three_decays()
    law = cl.fit("x' = -k x", trials, shared={"k": "all"}, errors="white")
    refined = cl.refine(law, trials, errors="white")
    assert refined.params["estimate"].tolist() == pytest.approx(law.params["estimate"].tolist(), rel=1e-6)
    assert refined.params["estimate"].nunique() == 1


@pytest.mark.parametrize(
    ("more", "reasons"),
    [
        ({"priors": {"k": (0.5, 0.1)}}, ["priors"]),
        ({"shared": {"k": "trial"}}, ["groups of parameters"]),
        ({"equations": "x' = -k x; x < 1: x = 2"}, ["events"]),
        ({"equations": "x' = -k x; x(0) = h"}, ["initial values"]),
    ],
)
def test_collocation_names_what_it_does_not_fit(more, reasons):
    _, _, trials = three_decays()
    with refused("beyond-collocation", reasons=reasons):
        cl.fit(**{"equations": "x' = -k x", "trials": trials, "scheme": "collocation"} | more)


def test_refined_laws_keep_the_bounds_they_were_fitted_with():
    _, _, trials = three_decays()
    law = cl.fit("x' = -k x; k < 0.55", trials, errors="white")
    again = from_json(to_json(law))
    assert again.restrictions.bounds == ("k < 0.55",)
    refined = cl.refine(again, trials, errors="white")
    assert refined.params["estimate"].max() <= 0.55
    assert refined.params["estimate"].tolist() == pytest.approx(law.params["estimate"].tolist(), rel=1e-6)


def test_files_of_version_6_have_shared_parameters_as_those_without_scatter():
    _, _, trials = three_decays()
    law = cl.fit("x' = a - k x", trials, shared="k", errors="white")
    document = json.loads(to_json(law)) | {"version": 6}
    del document["restrictions"]
    assert from_json(json.dumps(document)).restrictions.shared == law.restrictions.shared == {"k": "all"}


def test_a_shared_rate_of_which_a_quotient_alone_is_determined_is_refused():
    times = np.linspace(0, 5.7, 20)
    rates = enumerate((0.5, 0.8, 1.1))
    states = [20 * np.exp(-k * times) + 0.2 * np.random.default_rng(i).standard_normal(20) for i, k in rates]
    trials = cl.Trials.from_arrays([times] * 3, states, object=["a", "b", "c"], names=["x"])
    with refused("parameters-not-identified"):
        cl.fit("x' = -V x/(K + x)", trials, shared="V", scheme="collocation", errors="white")
