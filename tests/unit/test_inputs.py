"""Inputs between samples, forecasts that they drive, and doses, against independent integrations."""

from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from itertools import pairwise, product

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw.cli.main import commonlaw
from commonlaw.integration import Inputs, problem, simulation
from commonlaw.law import Law, Uncertainty, from_json, to_json, to_script
from commonlaw.law.parameters import named_parameters
from commonlaw.library import Variables, parse_library
from commonlaw.trials import Schema, Trial, Trials
from commonlaw.trials.transformations import with_doses
from tests.refusals import refused
from tests.simulations import drawn

pytestmark = pytest.mark.usefixtures("few_starts")

METHODS = ["scipy"] + (["heyoka"] if find_spec("heyoka") else [])
TIMES = np.cumsum(np.random.default_rng(0).uniform(0.2, 1.5, 13)) + 100
VALUES = np.random.default_rng(1).uniform(0, 2, (13, 2))


def between(how, t, piece):
    """The inputs at a time in the given piece, computed anew."""
    if how == "held":
        return VALUES[piece]
    if how == "linear":
        return np.array([np.interp(t, TIMES, column) for column in VALUES.T])
    return CubicSpline(TIMES, VALUES)(t)


@pytest.mark.parametrize("how", ["held", "linear", "cubic"])
def test_inputs_between_samples(how):
    inputs = Inputs.of(TIMES, VALUES, how)
    fine = np.linspace(TIMES[0], TIMES[-1], 300)[1:-1]
    expected = [between(how, t, np.searchsorted(TIMES, t) - 1) for t in fine]
    np.testing.assert_allclose(inputs.at(fine), expected, atol=1e-12)
    np.testing.assert_allclose(inputs.at(TIMES), VALUES, atol=1e-12)
    np.testing.assert_array_equal(inputs.at(np.array([0.0, 1e3])), VALUES[[0, -1]])


def test_an_input_that_stays_as_it_is_has_no_knot():
    assert Inputs.of(np.arange(6.0), np.array([[1.0], [1], [1], [2], [2], [2]]), "held").knots.tolist() == [0, 3]
    assert Inputs.of(np.arange(6.0), np.ones((6, 1)), "linear").knots.tolist() == [0]


def test_an_unknown_interpolation_of_inputs_is_refused():
    with refused("unknown-name", kind="interpolation of inputs between samples", name="lineer"):
        Inputs.of(TIMES, VALUES, "lineer")


def driven_law(order):
    """x' or x'' = -0.6 x - 0.2 x v (or x^2) + 0.8 u + 0.3 w x, whose coefficients are uncertain."""
    second, rates = ("x v", ("v",)) if order == 2 else ("x^2", ())
    terms = parse_library(f"terms:x,{second.replace(' ', '*')},u,w*x").bind(Variables(("x", *rates), ("u", "w")))
    known = Uncertainty([np.diag([0.01, 0.02, 0.03, 0.01]) ** 2], noise=[0.05])
    values = np.array([[[-0.6, -0.2, 0.8, 0.3]]])
    return Law(terms, Schema(("x",), ("u", "w")), order, ("tank",), values, uncertainty=known)


@cache
def reference(order, start, how):
    """States and sensitivities at the samples, by the variational equations written out by hand."""
    a, b, c, d = driven_law(order).coefficients[0, 0]

    def rates(t, y, piece):
        z, s = y[:order], y[order:].reshape(order, -1)
        u, w = between(how, t, piece)
        partner = z[-1]
        highest = a * z[0] + b * z[0] * partner + c * u + d * w * z[0]
        by_state = np.array([[a + 2 * b * z[0] + d * w]])
        if order == 2:
            by_state = np.array([[0, 1], [a + b * z[1] + d * w, b * z[0]]])
        change = by_state @ s
        change[-1, :4] += [z[0], z[0] * partner, u, w * z[0]]
        return np.concatenate([z[1:], [highest], change.ravel()])

    rows = [np.concatenate([start, np.eye(order, 4 + order, 4).ravel()])]
    for piece, span in enumerate(pairwise(TIMES)):
        found = solve_ivp(rates, span, rows[-1], "DOP853", args=(piece,), rtol=1e-12, atol=1e-12)
        rows.append(found.y[:, -1])
    whole = np.array(rows)
    return whole[:, :order], whole[:, order:].reshape(len(TIMES), order, -1)


@pytest.mark.parametrize(
    ("order", "how", "method"),
    [
        pytest.param(*case, marks=[pytest.mark.slow] * (i % 2 == (case[2] == "heyoka")))
        for i, pair in enumerate(product([1, 2], ["held", "linear", "cubic"]))
        for case in ((*pair, method) for method in METHODS)
    ],
)
def test_driven_forecasts_and_their_bands_are_those_of_another_integrator(method, how, order):
    law = driven_law(order)
    heights = 0.7 + 0.1 * (TIMES - TIMES[0])
    trials = Trials((Trial("tank", "1", TIMES, heights, VALUES),), law.schema)
    options = {"start": 1, "input_interpolation": how, "method": method, "tolerance": 1e-10, "return_std": True}
    forecast = law.predict(trials, **options)
    (found,) = forecast.trajectories
    states, sensitivities = reference(order, tuple(found.states[0]), how)
    np.testing.assert_allclose(found.states, states, rtol=1e-7, atol=1e-8)
    by_coefficients = np.einsum(
        "nip,pq,niq->ni", sensitivities[..., :4], law.uncertainty.covariance[0], sensitivities[..., :4]
    )
    if order == 1:
        expected = np.sqrt(by_coefficients + sensitivities[..., 4] ** 2 * 0.05**2)
        np.testing.assert_allclose(forecast.std[0], expected, rtol=1e-5)
    else:
        assert (forecast.std[0] ** 2 >= by_coefficients - 1e-9).all()
        assert found.method == method


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("how", ["held", "linear"])
def test_a_short_pulse_is_not_stepped_over(method, how):
    law = driven_law(1)
    times = np.arange(2000.0)
    pulse = np.zeros((2000, 2))
    pulse[1500, 0] = 1.0
    trials = Trials((Trial("tank", "1", times, np.zeros(2000), pulse),), law.schema)
    states = law.predict(trials, start=1, method=method, input_interpolation=how).trajectories[0].states[:, 0]
    assert np.abs(states[:1500]).max() < 1e-6
    assert states[1501] > 0.1


@pytest.mark.parametrize("method", METHODS)
def test_many_samples_of_an_input_are_worth_many_steps(method, monkeypatch):
    monkeypatch.setattr(problem, "MAX_STEPS", 20)
    law, times = driven_law(1), np.arange(60.0)
    for values, far in ((np.sin([times, 2 * times]).T, True), (np.ones((60, 2)), False)):
        trials = Trials((Trial("tank", "1", times, np.ones(60), values),), law.schema)
        assert (law.predict(trials, start=1, method=method).outcomes == ()) is far


@pytest.mark.parametrize("method", METHODS)
def test_a_driven_forecast_that_runs_away_says_when(method):
    """x' = x^2 + u x from x = 1 reaches infinity at t = ln 2 with u = 1."""
    terms = parse_library("terms:x^2,u*x").bind(Variables(("x",), ("u",)))
    law = Law(terms, Schema(("x",), ("u",)), 1, ("tank",), np.array([[[1.0, 1.0]]]))
    times = np.linspace(0, 2, 41)
    trials = Trials((Trial("tank", "1", times, np.ones(41), 1 + 1e-9 * times),), law.schema)
    (found,) = law.predict(trials, start=1, method=method).trajectories
    assert found.outcome.kind == "diverged"
    assert found.ended == pytest.approx(np.log(2), abs=1e-5)
    reached = times < np.log(2)
    growth = np.exp(times[reached])
    np.testing.assert_allclose(found.states[reached, 0], growth / (2 - growth), rtol=1e-4)
    assert np.isnan(found.states[~reached]).all()


def test_inputs_that_change_often_are_worth_compiling_the_law(monkeypatch):
    if "heyoka" in METHODS:
        monkeypatch.setattr(simulation, "_FEW_POINTS", 5000)
        law, times = driven_law(1), np.arange(600.0)
        for values, method in ((np.ones((600, 2)), "scipy"), (np.sin([times, 2 * times]).T, "heyoka")):
            trials = Trials((Trial("tank", "1", times, np.ones(600), values),), law.schema)
            assert law.predict(trials, start=1).trajectories[0].method == method


def test_a_fitted_start_takes_the_inputs_as_they_are_said_to_be():
    """x' = u with an input that is held: the straight lines between samples would put the start elsewhere."""
    times, steps = np.arange(20.0), np.tile([0.0, 4.0], 10)
    terms = parse_library("terms:u").bind(Variables(("x",), ("u",)))
    law = Law(terms, Schema(("x",), ("u",)), 1, ("tank",), np.array([[[1.0]]]), Uncertainty(noise=[0.1]))
    exact = np.concatenate([[3.0], 3 + np.cumsum(steps[:-1])])
    trials = Trials((Trial("tank", "1", times, exact, steps),), law.schema)
    held, linear = (
        law.predict(trials, start=10, input_interpolation=how).errors()["rms error"][0] for how in ("held", "linear")
    )
    assert held < 0.3 * linear


WHITE = {"errors": "white", "huber_threshold": np.inf, "partial_pooling": False}
HOURS = np.arange(0, 12.1, 0.75)
DOSES = {3.0: 60.0, 6.75: 80.0}
SWALLOWED = "depot' = -ka depot + dose; conc' = ka depot/V - k conc"
INJECTED = "conc' = -k conc + dose/V"
CASES = {
    SWALLOWED: ((1.5, 20.0, 0.3), ("ka", "V", "k"), 0.0, {"initial_values": {"depot": 100.0}}),
    INJECTED: ((20.0, 0.3), ("V", "k"), 5.0, {}),
}


def concentrations(values, first):
    """Concentrations at the hours, integrated from dose to dose, measured before each."""
    *rate, volume, k = values
    ka = rate[0] if rate else 0.0
    state, found = np.array([100.0 if rate else 0.0, first]), [first]

    def rates(_, z):
        return [-ka * z[0], ka * z[0] / volume - k * z[1]]

    for begin, end in pairwise(HOURS):
        state = state + DOSES.get(begin, 0.0) * np.array([1.0, 0.0] if rate else [0.0, 1 / volume])
        state = solve_ivp(rates, (begin, end), state, rtol=1e-9, atol=1e-11).y[:, -1]
        found.append(state[1])
    return np.array(found)


def dosed(equations, count=2):
    typical, _, first, _ = CASES[equations]
    values, noise, measured = drawn(lambda numbers: concentrations(numbers, first), typical, count)
    given = np.array([[DOSES.get(hour, 0.0)] for hour in HOURS])
    trials = cl.Trials.from_arrays(
        [HOURS] * count, measured, inputs=[given] * count, object=list("ab")[:count], names=["conc", "dose"]
    )
    return values, noise, measured, trials


@pytest.fixture(scope="module")
def injected():
    """True parameters, and the law that was fitted to trials with doses."""
    values, *_, trials = dosed(INJECTED)
    return values, trials, cl.fit(INJECTED, trials, doses="dose")


@pytest.fixture(scope="module")
def cleared():
    """Few samples of c' = -c/2 after two doses each."""
    times = np.array([0, 1, 2, 3, 5, 8, 12, 13, 15.0])
    generator, measured, given = np.random.default_rng(0), [], []
    for amount in (2.0, 4.0, 3.0):
        doses = np.where(times == 1, amount, np.where(times == 12, amount / 2, 0.0))
        left = np.where(times > times[:, np.newaxis], np.exp(-0.5 * (times - times[:, np.newaxis])), 0.0)
        measured.append(doses @ left + 0.02 * generator.standard_normal(len(times)))
        given.append(doses[:, np.newaxis])
    return cl.Trials.from_arrays([times] * 3, measured, inputs=given, object=["a", "a", "b"], names=["c", "dose"])


def test_a_rate_is_found_from_few_samples_with_several_doses(cleared):
    """Rates that were smoothed say nothing of the jumps, and the fit begins with coefficients by these rates."""
    parameters = named_parameters(cl.fit("c' = -k c + dose", cleared, doses="dose"))
    assert (np.abs(parameters.values - 0.5) < 3 * parameters.errors).all()
    assert (parameters.errors < 0.1).all()


def test_verdicts_and_residuals_know_doses_where_nothing_was_measured(cleared):
    alone = [replace(each, states=np.where(each.times[:, np.newaxis] == 12, np.nan, each.states)) for each in cleared]
    for trials in (cleared, cleared.with_trials(alone)):
        law = cl.fit("c' = -k c + dose", trials, doses="dose", noise={"c": 0.02})
        assert law.assess(trials).usable
        assert np.nanmax(np.abs(np.concatenate(law.residuals(trials).standardized))) < 4


@pytest.mark.parametrize("equations", CASES)
def test_estimates_and_errors_are_those_of_least_squares_with_integration_from_dose_to_dose(equations):
    _, names, first, options = CASES[equations]
    truth, noise, measured, trials = dosed(equations)
    law = cl.fit(equations, trials, doses="dose", noise={"conc": noise}, **options, **WHITE)
    parameters = named_parameters(law)
    columns = [parameters.names.index(name) for name in names]
    values, errors = (each[:, columns] for each in (parameters.values, parameters.errors))
    for value, error, data, begin in zip(values, errors, measured, truth, strict=True):
        begin = np.append(begin, first)
        found = least_squares(
            lambda each, data=data: (concentrations(each[:-1], each[-1]) - data) / noise,
            begin,
            x_scale=np.abs(begin) + 0.1,
        )
        bound = np.sqrt(np.diag(np.linalg.inv(found.jac.T @ found.jac)))[:-1]
        assert (abs(value - found.x[:-1]) < 0.1 * error).all()
        np.testing.assert_allclose(error, bound, rtol=0.03)


def test_a_saved_law_forecasts_tables_with_other_doses(injected):
    values, _, law = injected
    law = from_json(to_json(law))
    assert law.schema.doses == ("dose",)
    given = np.where(HOURS == 1.5, 30.0, 0.0)[:, np.newaxis]
    start = np.full((len(HOURS), 1), np.nan)
    start[0] = 4.0
    new = cl.Trials.from_arrays(HOURS, start, inputs=given, object="a", names=["conc", "dose"])
    (found,) = law.predict(new, start=1).trajectories
    volume, k = values[0]
    times = found.times
    expected = 4 * np.exp(-k * times) + np.where(times > 1.501, 30 / volume * np.exp(-k * (times - 1.5)), 0.0)
    settled = abs(times - 1.5) > 0.01
    np.testing.assert_allclose(found.states[settled, 0], expected[settled], rtol=0.02)
    assert "doses=('dose',)" in to_script(law)


def test_a_law_is_simulated_with_doses(injected):
    law = injected[2]
    times = np.linspace(0, 6, 13)
    found = law.simulate(times, [4.0], doses={"dose": {1.5: 30.0}})["a"].states[:, 0]
    parameters = named_parameters(law)
    volume, k = (parameters.values[0, parameters.names.index(each)] for each in ("V", "k"))
    expected = 4 * np.exp(-k * times) + np.where(times > 1.5, 30 / volume * np.exp(-k * (times - 1.5)), 0.0)
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    np.testing.assert_allclose(law.simulate(times, [4.0])["a"].states[:, 0], 4 * np.exp(-k * times), rtol=1e-6)
    with refused("unknown-name", kind="dose", name="dos"):
        law.simulate(times, [4.0], doses={"dos": {1.0: 1.0}})


def test_the_command_line_takes_doses(tmp_path, injected):
    injected[1].to_frame().to_csv(tmp_path / "doses.csv", index=False)
    path, saved, question = str(tmp_path / "doses.csv"), str(tmp_path / "law.json"), "if it holds amounts"
    done = CliRunner().invoke(commonlaw, ["fit", path, INJECTED, "--dose", "dose", "--save", saved])
    assert done.exit_code == 0, done.output
    assert "conc' = -k conc + dose/V" in done.output
    assert question not in done.output
    assert question in CliRunner().invoke(commonlaw, ["data", "check", path]).output
    assert question not in CliRunner().invoke(commonlaw, ["check", path, saved]).output


def test_a_forecast_from_a_later_time_begins_after_the_doses_before_it(injected):
    _, trials, law = injected
    for begins in (4.5, 9.0):
        later, first = (law.predict(trials, **how).trajectories for how in ({"from_time": begins}, {"start": "all"}))
        for own, each in zip(later, first, strict=True):
            expected = np.interp(own.times, each.times, each.states[:, 0])
            np.testing.assert_allclose(own.states[:, 0], expected, atol=0.02 * np.ptp(expected))


def test_a_dose_is_the_integral_of_its_input(injected):
    trials = injected[1]
    (trial, _) = with_doses(trials, ["dose"])
    assert np.trapezoid(trial.inputs[:, 0], trial.times) == pytest.approx(sum(DOSES.values()))
    again = with_doses(with_doses(trials, ["dose"]), ["dose"])
    assert len(again.trials[0]) == len(trial) == len(HOURS) + 2 * len(DOSES)


def test_what_is_no_dose_is_refused(injected):
    trials = injected[1]
    with refused("unknown-name", kind="input", name="dos"):
        cl.fit(INJECTED, trials, doses="dos")
    frame = trials.to_frame().assign(heat=1.0)
    others = cl.Trials.from_frame(
        frame, object="object", trial="trial", time="t", states="conc", inputs=["dose", "heat"]
    )
    with refused("doses-with-inputs"):
        cl.fit("conc' = -k conc + dose/V + b heat", others, doses="dose")


def dosed_before_measured():
    """A dose of 100 at the start, of which the first measurement is an hour later, and one of 50 at hour 5.

    Return a table of these, and times and values of the measurements.
    """
    times, k = np.array([1.0, 2.0, 3.5, 5.0, 6.0, 8.0]), 0.3
    conc = 10 * np.exp(-k * times) + np.where(times > 5, 5 * np.exp(-k * (times - 5)), 0)
    conc += 0.05 * np.random.default_rng(0).standard_normal(len(times))
    given = {"t": [0.0, *times], "conc": [np.nan, *conc], "dose": [100.0, *(50.0 * (times == 5))]}
    return pd.DataFrame(given), times, conc


def test_a_trial_begins_at_a_dose_before_its_first_measurement():
    frame, times, conc = dosed_before_measured()
    of_table = cl.Trials.from_frame(frame, time="t", states=["conc"], inputs=["dose"])
    of_arrays = cl.Trials.from_arrays(
        frame.t.to_numpy(), frame.conc.to_numpy(), inputs=frame.dose.to_numpy(), names=["conc", "dose"]
    )

    def residuals(p):
        k, volume = p
        later = np.where(times > 5, 50 / volume * np.exp(-k * np.maximum(times - 5, 0)), 0)
        return 100 / volume * np.exp(-k * times) + later - conc

    k, volume = least_squares(residuals, [0.3, 10.0], xtol=1e-12, ftol=1e-12).x
    for trials in (of_table, of_arrays):
        law = cl.fit(INJECTED, trials, doses="dose")
        values = dict(zip(named_parameters(law).names, named_parameters(law).values[0], strict=True))
        assert values["V"] == pytest.approx(volume, rel=1e-3)
        assert values["k"] == pytest.approx(k, rel=1e-3)
        assert law.trial_estimates == ()
        forecast = law.predict(trials, start="all")
        assert (forecast.trials[0].times[0], forecast.trajectories[0].states[0, 0]) == (0, 0)
    assert len(of_table[0].rows(slice(1, None)).earlier) == 0


def test_an_object_without_a_dose_is_refused_and_no_parameter_is_infinite():
    _, times, conc = dosed_before_measured()
    trials = cl.Trials.from_arrays(
        [times, times], [conc, conc], inputs=[50.0 * (times == 5), 0 * times], object=["a", "b"], names=["conc", "dose"]
    )
    with refused("doses-after-end", object="b"):
        cl.fit(INJECTED, trials, doses="dose", **WHITE)


def test_an_object_without_a_dose_and_with_zeros_alone_is_left_out_with_a_note():
    _, times, conc = dosed_before_measured()
    dose = 50.0 * (times == 5)
    names = {"object": ["a", "b"], "names": ["conc", "dose"]}
    trials = cl.Trials.from_arrays([times, times], [conc, 0 * conc], inputs=[dose, 0 * dose], **names)
    law = cl.fit(INJECTED, trials, doses="dose", **WHITE)
    alone = cl.fit(INJECTED, trials.select(object="a"), doses="dose", **WHITE)
    assert law.objects == ("a",)
    assert "objects-without-dose" in {outcome.code for outcome in law.diagnostics}
    np.testing.assert_array_equal(law.coefficients, alone.coefficients)
    assert {trial.object for trial in law.predict(trials).trials} == {"a"}


@pytest.mark.parametrize(("shared", "objects"), [(["k", "b"], ("a", "b", "blank")), (["b"], ("a", "b"))])
def test_an_object_at_rest_has_parameters_that_all_objects_share_and_is_else_left_out(shared, objects):
    times, random = np.arange(0.0, 8.0, 0.5), np.random.default_rng(1)
    inputs = [np.full(len(times), level) for level in (1.0, 0.5, 0.0)]
    states = [2 * u * (1 - np.exp(-0.5 * times)) + 0.01 * (u > 0) * random.normal(size=len(times)) for u in inputs]
    trials = cl.Trials.from_arrays([times] * 3, states, inputs=inputs, object=["a", "b", "blank"], names=["x", "u"])
    law = cl.fit("x' = -k x + b u", trials, shared=shared)
    assert law.objects == objects
    assert law.params["estimate"].to_numpy() == pytest.approx(np.tile([0.5, 1.0], len(objects)), rel=0.05)
    assert ("objects-at-rest" in {outcome.code for outcome in law.diagnostics}) == (len(objects) == 2)


def test_all_states_are_zero_before_a_first_dose_but_those_that_are_measured_there():
    """A depot without a column, and a blood level that is zero, or that a row measures."""
    times, (ka, volume, k) = np.array([0.0, 0.5, 1.0, 2.0, 4.0, 7.0, 11.0, 16.0]), (1.1, 9.0, 0.2)
    absorbed = 100 / volume * ka / (ka - k) * (np.exp(-k * times) - np.exp(-ka * times))
    noise = 0.02 * np.random.default_rng(2).standard_normal(len(times))
    dose = 100.0 * (times == 0)
    for before in (0.0, 3.0):
        conc = absorbed + before * np.exp(-k * times) + noise
        conc[0] = conc[0] if before else np.nan
        trials = cl.Trials.from_arrays(times, conc, inputs=dose, names=["conc", "dose"])
        law = cl.fit(SWALLOWED, trials, doses="dose")
        parameters = named_parameters(law)
        assert (np.abs(parameters.values[0] - [ka, volume, k]) < 3 * parameters.errors[0]).all()
        assert [estimate.name for estimate in law.trial_estimates] == ["conc(0)"] * bool(before)
        assert all(estimate.value == pytest.approx(before, abs=0.1) for estimate in law.trial_estimates)
        again = from_json(to_json(law)).predict(trials)
        assert again.trajectories[0].states[0, 0] == pytest.approx(before, abs=0.1)
    with refused("free-start-with-dose", state="depot"):
        cl.fit(SWALLOWED, trials, doses="dose", initial_values={"depot": "free"})


def test_a_law_of_measured_starts_forecasts_a_trial_that_begins_with_a_dose_from_zero(injected):
    values, _, law = injected
    (volume, k), (frame, times, _) = values[0], dosed_before_measured()
    new = cl.Trials.from_frame(frame.assign(object="a"), object="object", time="t", states=["conc"], inputs=["dose"])
    (trajectory,) = law.predict(new).trajectories
    first = times[times < 5]
    found = np.interp(first, trajectory.times, trajectory.states[:, 0])
    np.testing.assert_allclose(found, 100 / volume * np.exp(-k * first), rtol=0.05)


def test_a_dose_may_have_a_row_of_its_own_at_the_time_of_a_measurement():
    """As tables of clinics have it: the dose and the measurement before it, in either order."""
    frame, *_ = dosed_before_measured()
    rows = frame[1:].assign(dose=0.0).to_dict("records")
    dose = {"t": 5.0, "conc": np.nan, "dose": 50.0}
    found = []
    for own in (
        [*rows[:3], dose, *rows[3:]],
        [*rows[:4], dose, *rows[4:]],
        [{**row, "dose": 50.0 * (row["t"] == 5)} for row in rows],
    ):
        trials = cl.Trials.from_frame(pd.DataFrame(own), time="t", states=["conc"], inputs=["dose"])
        np.testing.assert_array_equal(trials[0].inputs[:, 0], [0, 0, 0, 50, 0, 0])
        found.append(cl.fit(INJECTED, trials, doses="dose", **WHITE).coefficients)
    np.testing.assert_array_equal(found[0], found[2])
    np.testing.assert_array_equal(found[1], found[2])
    two = pd.DataFrame([*rows[:4], dose, {**dose, "dose": 20.0}, *rows[4:]])
    with refused("inputs-differ", time=5.0):
        cl.Trials.from_frame(two, time="t", states=["conc"], inputs=["dose"])


def test_tables_that_are_written_keep_doses_before_the_first_measurement(tmp_path):
    frame, *_ = dosed_before_measured()
    trials = cl.Trials.from_frame(frame, time="t", states=["conc"], inputs=["dose"])
    trials.to_csv(tmp_path / "doses.csv")
    again = cl.Trials.read(
        tmp_path / "doses.csv", object="object", trial="trial", time="t", states=["conc"], inputs=["dose"]
    )
    np.testing.assert_array_equal(again[0].earlier, [[0.0, 100.0]])
    np.testing.assert_array_equal(again[0].states, trials[0].states)


def test_trials_that_are_zero_until_their_dose_are_forecast_from_there():
    random, times = np.random.default_rng(3), np.array([0.0, 1.0, 6.0])
    states, inputs = [], [np.array([100.0, 0.0, 0.0])] * 8
    for _ in inputs:
        k, volume = random.uniform(0.2, 0.4), random.uniform(9, 12)
        states.append(np.array([0.0, *(100 / volume * np.exp(-k * times[1:]) + 0.05 * random.standard_normal(2))]))
    subjects = cl.Trials.from_arrays([times] * 8, states, inputs=inputs, object=list("abcdefgh"), names=["conc", "amt"])
    verdict = cl.fit("conc' = -k conc + amt/V", subjects, doses="amt", noise={"conc": 0.05}).assess(subjects)
    assert (verdict.segments, verdict.diverged) == (8, 0)
    assert verdict.r_squared > 0.95


def test_an_input_at_levels_next_to_a_smooth_one_is_noted_until_its_steps_have_rows():
    times = np.arange(0.0, 40.0)
    rows = np.append(times, [14.99, 24.99])  # Before each step, without a measurement
    rows = np.sort(rows)
    heater, sky = np.where(rows < 15, 0.0, np.where(rows < 25, 4.0, 2.0)), np.sin(rows / 7)
    fine = np.linspace(0, 39, 39001)
    steps = np.where(fine < 15, 0.0, np.where(fine < 25, 4.0, 2.0))
    driven = 0.5 * steps + 0.3 * np.sin(fine / 7)
    x = np.exp(-0.2 * fine) * np.cumsum(np.exp(0.2 * fine) * driven) * 1e-3
    x = np.where(np.isin(rows, times), np.interp(rows, fine, x), np.nan) + 0.005 * np.cos(9 * rows)
    frame = pd.DataFrame({"t": rows, "x": x, "heater": heater, "sky": sky})
    for table, is_noted in ((frame, False), (frame[np.isfinite(x)], True)):
        trials = cl.Trials.from_frame(table, time="t", states=["x"], inputs=["heater", "sky"])
        law = cl.fit("x' = -a x + b heater + c sky; x(0) = h", trials, input_interpolation="linear")
        codes = [outcome.code for outcome in law.diagnostics]
        assert ("inputs-interpolated-together" in codes) == is_noted
        assert "inputs-interpolated-together-in-collocation" not in codes
        a = law.params.set_index("parameter")["estimate"]["a"]
        assert (abs(a - 0.2) > 0.005) == is_noted
