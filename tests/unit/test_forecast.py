import numpy as np
import pytest

from commonlaw.forecast import Forecast
from commonlaw.integration import Trajectory, VectorField, integrate
from commonlaw.library import PolynomialLibrary, Variables
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
