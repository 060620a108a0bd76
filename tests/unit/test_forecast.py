"""Forecasts: their errors, scores and tables, and the smooth curves between their samples."""

import numpy as np
import pytest

from commonlaw.forecast import Forecast
from commonlaw.forecast.forecast import squared_errors
from commonlaw.integration import Trajectory, VectorField, integrate
from commonlaw.law import Law, Uncertainty
from commonlaw.library import PolynomialLibrary, Variables, parse_library
from commonlaw.plots import plot_forecast
from commonlaw.trials import Schema, Trial, Trials


@pytest.fixture
def forecast():
    times = np.arange(4.0)
    trials = Trials((Trial("a", "1", times, times), Trial("b", "1", times, 2 * times)), Schema(("x",), object="ball"))
    good = Trajectory(times, np.array([[0.0], [1.0], [2.0], [3.5]]))
    return Forecast(trials, (good, Trajectory(times, 2 * times[:, np.newaxis])))


def test_errors_of_each_trial(forecast):
    errors = forecast.errors()
    assert errors["ball"].tolist() == ["a", "b"]
    assert errors["rms error"].tolist() == [0.25, 0.0]
    assert errors["largest error"].tolist() == errors["last error"].tolist() == [0.5, 0.0]
    assert errors["diverged after"].isna().all()


def test_the_score_is_the_share_of_variation_that_is_forecast(forecast):
    assert forecast.score() == pytest.approx(1 - 0.25 / (5 + 20))


def test_the_table_holds_measured_and_forecast_states(forecast):
    frame = forecast.to_frame()
    assert list(frame.columns) == ["ball", "trial", "t", "x", "x forecast", "x error"]
    assert frame["x error"].tolist() == [0, 0, 0, 0.5, 0, 0, 0, 0]


def test_a_diverged_forecast_has_infinite_error_and_score(forecast):
    terms = PolynomialLibrary(2).bind(Variables(("x",)))
    lost = integrate(VectorField(terms, np.array([[0.0, 0.0, 1.0]])), np.array([1.0]), np.array([0.0, 0.9, 2.0, 3.0]))
    bad = Forecast(forecast.trials, (forecast.trajectories[0], lost))
    assert bad.score() == -np.inf
    assert bad.bounded_score() == pytest.approx((1 - 0.25 / 5 - 1) / 2)
    assert bad.errors()["diverged after"].tolist()[1] == 1.0
    assert bad.errors()["last error"].tolist() == [0.5, np.inf]
    assert bad.outcomes == (lost.outcome,)


TIMES = np.array([0.0, 1.0, 2.0, 2.001, 2.002, 6.0])


def spring(order=2, **known):
    """x'' = -4 x, whose x goes round twice in the longest gap; or x[k+1] = -4 x[k]."""
    terms = parse_library("terms:x").bind(Variables(("x", "v") if order == 2 else ("x",)))
    return Law(terms, Schema(("x",)), order, ("tank",), np.array([[[-4.0]]]), uncertainty=Uncertainty(**known))


def trials_of(law, *times):
    return Trials(tuple(Trial("tank", str(i), time, np.cos(2 * time)) for i, time in enumerate(times)), law.schema)


def test_times_are_added_where_samples_are_far_apart_and_nothing_else_changes():
    law = spring(covariance=[[[0.01]]], noise=[0.1])
    forecast = law.predict(trials_of(law, TIMES, np.linspace(0, 3, 500)), return_std=True, start=5)
    smooth = forecast.smooth(200)
    sparse, dense = smooth.trials
    assert np.diff(sparse.times).max() <= 6 / 200 + 1e-9
    assert len(sparse) < 200 + len(TIMES)
    np.testing.assert_array_equal(dense.times, forecast.trials[1].times)
    for own, trial, before, after in zip(
        smooth.trials, forecast.trials, forecast.trajectories, smooth.trajectories, strict=True
    ):
        kept = np.isin(own.times, trial.times)
        np.testing.assert_allclose(after.states[kept], before.states, rtol=1e-6, atol=1e-6)
        np.testing.assert_array_equal(np.isfinite(own.states[:, 0]), kept)
    for own, before, after in zip(smooth.trials, forecast.std, smooth.std, strict=True):
        np.testing.assert_allclose(after[np.isin(own.times, TIMES)][0], before[0], rtol=1e-5)
    start = smooth.trajectories[0].states[0]
    exact = start[0] * np.cos(2 * sparse.times) + start[1] / 2 * np.sin(2 * sparse.times)
    np.testing.assert_allclose(smooth.trajectories[0].states[:, 0], exact, atol=1e-5)


def test_a_forecast_that_has_nothing_between_samples_stays_as_it_is():
    steps = spring(0)
    forecast = steps.predict(trials_of(steps, np.arange(4.0)))
    assert forecast.smooth() is forecast
    law = spring()
    found = law.predict(trials_of(law, np.linspace(0, 1, 400)), start=1)
    assert found.smooth() is found
    bare = Forecast(found.trials, found.trajectories)
    assert bare.smooth(1000) is bare
    lone = law.predict(trials_of(law, np.array([1.0])), start=1)
    assert lone.smooth() is lone


@pytest.mark.parametrize("objects", [None, ["tub"]])
def test_figures_of_all_and_of_some_objects_are_smooth_and_begin_where_the_forecast_does(objects):
    terms = parse_library("terms:x").bind(Variables(("x",)))
    known = Uncertainty(1e-4 * np.ones((2, 1, 1)), noise=[0.01])
    law = Law(terms, Schema(("x",)), 1, ("tank", "tub"), -np.ones((2, 1, 1)), uncertainty=known)
    times = np.arange(9.0)
    trials = Trials(tuple(Trial(name, "1", times, np.exp(-times)) for name in law.objects), law.schema)
    figure = plot_forecast(law.predict(trials, from_time=3.5, return_std=True), objects)
    assert len(figure.axes) == 2 * len(objects or law.objects)
    for panel in figure.axes[::2]:
        points, line = panel.get_lines()
        np.testing.assert_array_equal(points.get_xdata(), times)
        assert len(line.get_xdata()) > 150
        assert 3.5 <= line.get_xdata()[0] < 3.6
        np.testing.assert_allclose(line.get_ydata(), np.exp(-line.get_xdata()), rtol=1e-4)
    for panel in figure.axes[1::2]:
        np.testing.assert_array_equal(panel.get_lines()[1].get_xdata(), times[4:])


def test_zeros_of_absent_states_do_not_lower_rms_errors():
    """The second trial is a monoculture of x; a law that makes y there has errors."""
    times, curve = np.arange(4.0), np.array([3.0, 2.0, 1.5, 1.2])
    mixture, alone = np.column_stack([curve, curve]), np.column_stack([curve, np.zeros(4)])
    trials = Trials(
        tuple(Trial("a", name, times, states) for name, states in (("1", mixture), ("2", alone))), Schema(("x", "y"))
    )
    kept = Forecast(trials, (Trajectory(times, mixture + 0.1), Trajectory(times, alone + np.array([0.1, 0.0]))))
    assert squared_errors(kept).mean().to_dict() == pytest.approx({"x": 0.01, "y": 0.01})
    made = Forecast(trials, (Trajectory(times, mixture + 0.1), Trajectory(times, alone + 0.3)))
    assert squared_errors(made)["y"].mean() == pytest.approx(0.05)
