"""The part of the study on the error of prediction, beside the numbers recomputed with NumPy and SciPy alone."""

from importlib import import_module

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import savgol_filter

import commonlaw as cl
from studies.falling_balls.inquiry import Inquiry
from studies.falling_balls.method import single_law
from studies.falling_balls.model_error import model_error
from studies.falling_balls.report import Section
from studies.falling_balls.settings import LONG_MODELS, LONG_STARTS

OTHER = {"1": "2", "2": "1"}
POWERS = {"1": [0], "2": [0, 1], "3": [0, 1, 2]}


@pytest.fixture(scope="module")
def section(drops) -> Section:
    return model_error(Inquiry(drops, "", 100))


def derivative(t, x):
    """Centred differences; at the ends four points, third order."""
    ends = np.array([-11 / 6, 3, -3 / 2, 1 / 3])
    first, last = ends @ x[:4] / (t[1] - t[0]), -ends @ x[:-5:-1] / (t[-1] - t[-2])
    return np.concatenate([[first], (x[2:] - x[:-2]) / (t[2:] - t[:-2]), [last]])


def speed(trial):
    return derivative(trial.times, savgol_filter(trial.states[:, 0], 35, 3))


def error(drops, ball, drop, powers):
    """Fit ``x'' = sum c_k v^k`` to one drop, forecast the other, and compare at the 42nd sample."""
    (learned,), (tested,) = drops.select(object=ball, trial=drop), drops.select(object=ball, trial=OTHER[drop])
    v = speed(learned)
    rows = np.stack([v**k for k in powers], axis=1)
    c = np.linalg.lstsq(rows, derivative(learned.times, savgol_filter(v, 35, 3)))[0]
    span = tested.times[[0, 41]]

    def rates(_, y):
        return [y[1], sum(a * y[1] ** k for a, k in zip(c, powers, strict=True))]

    end = solve_ivp(rates, span, [tested.states[0, 0], speed(tested)[0]], "DOP853", rtol=1e-10, atol=1e-10).y[0, -1]
    return abs(end - tested.states[41, 0])


def test_forecasts_start_from_the_first_height_and_the_rate_at_the_first_sample(drops):
    law = cl.discover(
        drops,
        order=2,
        library="terms:1,v",
        method=cl.DerivativeRegression(differentiation="savgol:35:3", solver="stlsq:0.01"),
    )
    for trial, trajectory in zip(drops, law.predict(drops).trajectories, strict=True):
        assert trajectory.states[0].tolist() == pytest.approx([trial.states[0, 0], speed(trial)[0]], abs=1e-11)


@pytest.mark.parametrize("model", ["1", "2", "3"])
def test_the_errors_of_the_templates_are_those_of_a_fit_of_just_their_terms(drops, section, model):
    for drop, by_ball in section.results["prediction_error"][model].items():
        assert list(by_ball) == list(drops.objects)
        expected = {ball: error(drops, ball, drop, POWERS[model]) for ball in drops.objects}
        assert by_ball == pytest.approx(expected, abs=1e-5)


def test_there_are_eighty_finite_errors_and_their_medians(section):
    errors = section.results["prediction_error"]
    values = {model: {drop: list(by_ball.values()) for drop, by_ball in each.items()} for model, each in errors.items()}
    assert np.isfinite([v for value in values.values() for drop in value.values() for v in drop]).sum() == 80
    for model, value in values.items():
        expected = {"1": np.median(value["1"]), "2": np.median(value["2"]), "both": np.median(value["1"] + value["2"])}
        assert section.results["prediction_error_medians"][model] == pytest.approx(expected)


def test_the_median_errors_over_both_drops_to_a_centimetre(section):
    medians = {model: round(each["both"], 2) for model, each in section.results["prediction_error_medians"].items()}
    assert medians == {"1": 3.30, "2": 1.24, "3": 1.25, "4": 1.72}


def test_model_4_is_computed_for_each_ball(section):
    for by_ball in section.results["prediction_error"]["4"].values():
        assert len(set(by_ball.values())) == 10


def test_the_models_of_raised_drops_give_the_same_long_forecasts(drops, section):
    for ball, height in LONG_STARTS.items():
        (trial,) = drops.select(object=ball, trial="2")
        raised = cl.Trial(ball, "2", trial.times, trial.states + height - trial.states[0])
        for model, setting in LONG_MODELS.items():
            found = section.results["long_forecasts"][ball][model]
            law = single_law(drops.with_trials([raised]), setting["threshold"], setting["library"])
            far = law.simulate([0, 15], [height, speed(trial)[0]])[ball]
            if found["diverged_after"] is None:
                assert far.states[-1, 0] == pytest.approx(found["height_at_15_s"], abs=0.01)
            else:
                assert (ball, model, found["height_at_15_s"]) == ("Golf Ball", "4", None)
                assert far.ended == pytest.approx(found["diverged_after"], abs=1e-3)


def test_constant_acceleration_falls_as_galileo_says(drops, section):
    for ball, height in LONG_STARTS.items():
        (trial,) = drops.select(object=ball, trial="2")
        v = speed(trial)
        acceleration = derivative(trial.times, savgol_filter(v, 35, 3)).mean()
        expected = height + v[0] * 15 + acceleration * 15**2 / 2
        assert section.results["long_forecasts"][ball]["1"]["height_at_15_s"] == pytest.approx(expected, abs=1e-3)


def test_the_verdicts_hold(section):
    assert [verdict.kind for verdict in section.verdicts] == [
        "reproduced",
        "reproduced with correction",
        "reproduced with correction",
    ]
    assert "diverges after 7.07 s" in section.verdicts[2].text
    assert "−0.00067" in section.verdicts[2].text


@pytest.mark.slow
def test_the_verdicts_follow_the_numbers(drops, monkeypatch):
    room = "studies.falling_balls"
    monkeypatch.setattr(import_module(f"{room}.model_error"), "SIMILAR", 0.01)
    monkeypatch.setattr(import_module(f"{room}.long_forecasts"), "UNBOUNDED_AFTER", (7.1, 8.0))
    kinds = [verdict.kind for verdict in model_error(Inquiry(drops, "", 100)).verdicts]
    assert kinds == ["differs", "reproduced with correction", "differs"]


def test_other_terms_than_the_templates_are_named(drops):
    three = drops.select(object=["Green Basketball", "Golf Ball", "Whiffle Ball 2"])
    verdict = model_error(Inquiry(three, "", 100)).verdicts[0]
    assert verdict.kind == "differs"
    assert "But model " in verdict.text
