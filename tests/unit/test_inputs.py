"""Inputs between samples, and forecasts that they drive, against independent integrations from sample to sample."""

from importlib.util import find_spec
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from commonlaw.integration import Inputs, problem, simulation
from commonlaw.law import Law, Uncertainty
from commonlaw.library import Variables, parse_library
from commonlaw.trials import Schema, Trial, Trials
from tests.refusals import refused

METHODS = ["scipy"] + (["heyoka"] if find_spec("heyoka") else [])
TIMES = np.cumsum(np.random.default_rng(0).uniform(0.2, 1.5, 25)) + 100
VALUES = np.random.default_rng(1).uniform(0, 2, (25, 2))


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


def reference(law, start, how):
    """States and sensitivities at the samples, by the variational equations written out by hand."""
    order, (a, b, c, d) = law.order, law.coefficients[0, 0]

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


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("how", ["held", "linear", "cubic"])
@pytest.mark.parametrize("order", [1, 2])
def test_driven_forecasts_and_their_bands_are_those_of_another_integrator(method, how, order):
    law = driven_law(order)
    heights = 0.7 + 0.1 * (TIMES - TIMES[0])
    trials = Trials((Trial("tank", "1", TIMES, heights, VALUES),), law.schema)
    options = {"start": 1, "input_interpolation": how, "method": method, "tolerance": 1e-10, "return_std": True}
    forecast = law.predict(trials, **options)
    (found,) = forecast.trajectories
    states, sensitivities = reference(law, found.states[0], how)
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
    law = Law(
        parse_library("terms:u").bind(Variables(("x",), ("u",))),
        Schema(("x",), ("u",)),
        1,
        ("tank",),
        np.array([[[1.0]]]),
        uncertainty=Uncertainty(noise=[0.1]),
    )
    exact = np.concatenate([[3.0], 3 + np.cumsum(steps[:-1])])
    trials = Trials((Trial("tank", "1", times, exact, steps),), law.schema)
    off = {
        how: law.predict(trials, start=10, input_interpolation=how).errors()["rms error"][0]
        for how in ("held", "linear")
    }
    assert off["held"] < 0.3 * off["linear"]
