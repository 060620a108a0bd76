"""Standard deviations of forecasts are as wide as forecasts with other noise and other coefficients differ."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.stats import norm

from commonlaw import datasets
from commonlaw.differentiation import MedianFilter, SmoothedDifference, WienerFilter, parse_differentiation
from commonlaw.forecast import Forecast
from commonlaw.forecast.collocation import Collocation, trajectory_std
from commonlaw.forecast.scheme import Extended, ForecastOptions
from commonlaw.integration import InitialValueProblem, Inputs, Trajectory, simulate
from commonlaw.law import Law, Provenance, Uncertainty, select_objects
from commonlaw.law.law import object_index
from commonlaw.law.parameters import vector_field
from commonlaw.library import Variables, parse_library
from commonlaw.trials import Schema, Trial, Trials
from tests.refusals import refused

DRAWS = 400
TOLERANCE = 0.12
"""Relative error of a standard deviation of so many draws, three and a half times its standard error."""


def unsure(law, relative, noise, seed=0):
    """The law with coefficients of this relative standard error, correlated, and this noise."""
    size = int(law.support.sum())
    mixed = np.random.default_rng(seed).standard_normal((len(law.objects), size, 2 * size)) / np.sqrt(2 * size)
    mixed *= relative * law.coefficients[:, law.support][:, :, np.newaxis]
    known = Uncertainty(mixed @ mixed.transpose(0, 2, 1), noise=np.full(len(law.schema.states), noise))
    return replace(law, uncertainty=known)


def law_of(texts, order, coefficients, variances, noise, method=None):
    """The law of x with these terms, of objects a, b, ... by their coefficients, and variances of those in the law."""
    terms = parse_library(f"terms:{texts}").bind(Variables(("x", "v")[: max(order, 1)]))
    values, objects = np.array(coefficients)[:, np.newaxis], tuple("ab"[: len(np.array(coefficients))])
    known = Uncertainty([np.diag(each) for each in np.array(variances)], noise=[noise])
    return Law(terms, Schema(("x",)), order, objects, values, known, Provenance(method))


def with_rates(law, trials):
    """Return the standard deviations of states and rates of each trial, from its first sample."""
    deviations = []
    extended = [Extended(trial, trial, Inputs.of(trial.times, trial.inputs)) for trial in trials]
    for started in Collocation(law).begin(trials, extended, ForecastOptions(start=1)).started:
        field = replace(vector_field(law, started.trial.object), free=law.support)
        (path,) = simulate([InitialValueProblem(field, started.start.initial, started.ahead.times)], sensitivities=True)
        carried, initial = started.start.propagated(path)
        covariance = law.uncertainty.covariance[object_index(law, started.trial.object)]
        deviations.append(trajectory_std(carried, covariance, initial))
    return deviations


def test_standard_deviations_of_falling_balls_are_those_of_drawn_coefficients_and_drawn_noise():
    drops = datasets.linear_drag(drag=[-0.3, -0.5], noise=0.0, trials=1)
    rule = parse_differentiation("savgol:11:3")
    law = unsure(datasets.linear_drag.truth(drag=[-0.3, -0.5]), 0.03, 0.05)
    law = replace(law, provenance=Provenance(rule))
    forecast, deviations = law.predict(drops, start=1, return_std=True), with_rates(law, drops)
    rng = np.random.default_rng(1)
    for i, trial in enumerate(drops):
        noisy = trial.states + 0.05 * rng.standard_normal((len(trial), DRAWS))
        starts = np.array([noisy[0], rule.differentiate(trial.times, noisy, 1).derivatives[0][0]])
        own = rng.multivariate_normal(law.coefficients[i, law.support], law.uncertainty.covariance[i], DRAWS).T
        times = trial.times[:, np.newaxis] - trial.times[0]
        growth, limit = np.exp(own[1] * times), -own[0] / own[1]
        rates = limit + (starts[1] - limit) * growth
        heights = starts[0] + limit * times + (starts[1] - limit) * (growth - 1) / own[1]
        np.testing.assert_allclose(forecast.std[i][:, 0], heights.std(axis=1), rtol=TOLERANCE)
        np.testing.assert_allclose(deviations[i][:, 1], rates.std(axis=1), rtol=TOLERANCE)


@pytest.mark.parametrize("method", ["scipy", "auto"])
def test_standard_deviations_of_populations_are_those_of_drawn_coefficients_and_drawn_initial_states(method):
    trials = datasets.lotka_volterra(noise=0.0)[[0, 3]]
    trials = trials.with_trials([trial.cut(80) for trial in trials])
    law = select_objects(unsure(datasets.lotka_volterra.truth(), 0.005, 0.05), trials.objects)
    forecast = law.predict(trials, return_std=True, method=method)
    rng = np.random.default_rng(1)
    for i, trial in enumerate(trials):
        own = rng.multivariate_normal(law.coefficients[i, law.support], law.uncertainty.covariance[i], DRAWS).T
        a, b, c, d = own
        starts = trial.states[0][:, np.newaxis] + 0.05 * rng.standard_normal((2, DRAWS))

        def rates(_, flat, a=a, b=b, c=c, d=d):
            x, y = flat.reshape(2, -1)
            return np.concatenate([a * x + b * x * y, c * y + d * x * y])

        span = (trial.times[0], trial.times[-1])
        found = solve_ivp(rates, span, starts.ravel(), "DOP853", trial.times, rtol=1e-8).y.reshape(2, DRAWS, -1)
        np.testing.assert_allclose(forecast.std[i], found.std(axis=1).T, rtol=TOLERANCE)


@pytest.mark.parametrize("rule", ["forward", "centered", "finite:6", "savgol:15:3", "savgol:5:2:finite:4", "spectral"])
def test_the_standard_deviation_of_an_initial_rate_is_exact_for_linear_differentiators(rule):
    """Var(w x) = noise^2 w w', and the initial height is one of the samples that the rate is made from."""
    times = np.linspace(0, 2, 40)
    trial = Trial("a", "1", times, 20 - 4.9 * times**2)
    method = parse_differentiation(rule)
    law = law_of("1,v", 2, [[-9.8, 0.0]], [[0.0]], 0.2, method)
    weights = method.differentiate(times, np.eye(40), 1).derivatives[0][0]
    trials = Trials((trial,), law.schema)
    ((std,), (wide,)) = law.predict(trials, start=1, return_std=True).std, with_rates(law, trials)
    np.testing.assert_allclose(wide[:, 1], 0.2 * np.linalg.norm(weights), rtol=1e-6)
    by_sample = np.eye(40)[0] + (times - times[0])[:, np.newaxis] * weights
    np.testing.assert_allclose(std[:, 0], 0.2 * np.linalg.norm(by_sample, axis=1), rtol=1e-6)


@pytest.mark.parametrize(
    ("method", "excess"), [(SmoothedDifference(WienerFilter(15)), 0.1), (SmoothedDifference(MedianFilter(5)), 0.3)]
)
def test_the_standard_deviation_of_an_initial_rate_is_not_too_small_for_other_differentiators(method, excess):
    times, rng = np.linspace(0, 2, 40), np.random.default_rng(3)
    noisy = (20 - 4.9 * times**2)[:, np.newaxis] + 0.2 * rng.standard_normal((40, 2000))
    expected = method.differentiate(times, noisy, 1).derivatives[0][0].std()
    law = law_of("1", 2, [[-9.8]], [[0.0]], 0.2, method)
    trials = Trials(tuple(Trial("a", f"{i}", times, noisy[:, i]) for i in range(20)), law.schema)
    found = [deviations[0, 1] for deviations in with_rates(law, trials)]
    assert 0.93 < np.sqrt(np.mean(np.square(found))) / expected < 1 + excess


def test_discrete_laws_have_standard_deviations():
    k, law = np.arange(5.0), law_of("x", 0, [[0.9]], [[1e-4]], 0.1)
    trials = Trials((Trial("a", "1", k, 0.9**k),), law.schema)
    expected = np.hypot(0.1 * 0.9**k, 0.01 * k * 0.9 ** (k - 1))
    np.testing.assert_allclose(law.predict(trials, return_std=True).std[0][:, 0], expected)


@pytest.fixture(scope="module")
def law():
    """The law of one pair, with uncertain coefficients."""
    return select_objects(unsure(datasets.lotka_volterra.truth(), 0.01, 0.05), ["Pair 1"])


@pytest.fixture(scope="module")
def forecast(law):
    trials = datasets.lotka_volterra(samples=60)
    return law.predict(trials.select(object="Pair 1"), return_std=True)


def test_intervals_are_tables_of_normal_quantiles(forecast):
    frame = forecast.interval(0.8)
    schema = forecast.trials.schema
    assert list(frame.columns) == [schema.object, schema.trial, schema.time, "state", "forecast", "low", "high"]
    assert len(frame) == 2 * sum(len(trial) for trial in forecast.trials)
    first = frame[: len(forecast.trials[0])]
    assert set(first["state"]) == {"x"}
    np.testing.assert_array_equal(first["forecast"], forecast.trajectories[0].states[:, 0])
    half = norm.ppf(0.9) * forecast.std[0][:, 0]
    np.testing.assert_allclose(first["high"] - first["forecast"], half)
    np.testing.assert_allclose(first["forecast"] - first["low"], half)
    noisy = forecast.interval(0.8, measured=True)[: len(first)]
    np.testing.assert_allclose(noisy["high"] - noisy["forecast"], norm.ppf(0.9) * np.hypot(forecast.std[0][:, 0], 0.05))


def test_the_table_of_a_forecast_with_standard_deviations_has_the_ends_of_its_intervals(forecast):
    frame, intervals = forecast.to_frame(), forecast.interval()
    assert list(frame.columns)[3:8] == ["x", "x forecast", "x error", "x low", "x high"]
    for state in ("x", "y"):
        own = intervals[intervals["state"] == state]
        np.testing.assert_allclose(frame[f"{state} low"], own["low"])
        np.testing.assert_allclose(frame[f"{state} high"], own["high"])
        noisy = forecast.interval(measured=True)
        for end in ("low", "high"):
            np.testing.assert_allclose(frame[f"{state} measured {end}"], noisy[noisy["state"] == state][end])


def test_forecasts_with_and_without_standard_deviations_are_the_same(law, forecast):
    plain = law.predict(forecast.trials)
    assert plain.std is None
    for trajectory, other in zip(plain.trajectories, forecast.trajectories, strict=True):
        np.testing.assert_allclose(trajectory.states, other.states, rtol=1e-5)
    assert "x low" not in plain.to_frame()


def test_a_diverged_forecast_has_no_standard_deviation_after_its_end():
    times, law = np.array([0.0, 0.5, 0.9, 1.5, 2.0]), law_of("x**2", 1, [[1.0]], [[1e-6]], 0.01)
    trials = Trials((Trial("a", "1", times, np.ones(5)),), law.schema)
    (std,) = law.predict(trials, return_std=True).std
    assert np.isfinite(std[:3]).all()
    assert np.isnan(std[3:]).all()


def test_what_is_missing_for_intervals_is_named(law, forecast):
    trials = forecast.trials
    assert law.uncertainty.has_std
    for missing, message in (
        ({"covariance": None}, "uncertainty-unknown"),
        ({"noise": None}, "noise-unknown-at-start"),
    ):
        poorer = replace(law, uncertainty=replace(law.uncertainty, **missing))
        assert not poorer.uncertainty.has_std
        with refused(message):
            poorer.predict(trials, return_std=True)
    with refused("forecast-without-deviations"):
        law.predict(trials).interval()
    with refused("level-range", level=95):
        forecast.interval(95)
    with refused("forecast-without-noise"):
        Forecast(trials, forecast.trajectories, forecast.std).interval(measured=True)
    with refused("sensitivities-missing"):
        trajectory_std(Trajectory(np.arange(2.0), np.zeros((2, 1))), np.eye(1), np.eye(1))
