"""Fitted curves are solutions of the law through all samples, by independent least squares."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

import commonlaw as cl
from commonlaw.forecast import fitted
from commonlaw.likelihood import ErrorModel

TIMES = np.linspace(0.0, 10.0, 41)
LAW = cl.Law.from_text("w' = 0.8 w - 0.8 w^2")


def grown(start):
    return 1 / (1 + (1 / start - 1) * np.exp(-0.8 * TIMES))


def law_with(errors, noise):
    return replace(LAW, uncertainty=cl.law.Uncertainty(noise=np.array([noise]), error_model=errors))


@pytest.mark.parametrize("kind", ["proportional", "autocorrelated"])
def test_samples_weigh_what_the_errors_of_the_law_say(kind):
    additive, share = 0.0005, 0.1
    level = np.array([share])
    errors = ErrorModel({"proportional": level}) if kind == "proportional" else ErrorModel({}, level, memory=0.5)
    clean = grown(0.002)
    scale = np.hypot(additive, share * clean) if kind == "proportional" else np.full(41, np.hypot(additive, share))
    states = clean + 0.3 * scale * np.random.default_rng(2).standard_normal(41)
    fit = fitted(law_with(errors, additive), cl.Trials.from_arrays(TIMES, states, names=["w"]))
    (begin,) = least_squares(lambda start: (grown(start[0]) - states) / scale, [0.002], x_scale=1e-4).x
    np.testing.assert_allclose(fit.trajectories[0].states[:, 0], grown(begin), rtol=2e-3)
    assert fit.title == "fit"


def test_process_noise_does_not_make_a_curve_follow_what_the_law_does_not_say():
    walk = np.cumsum(np.random.default_rng(0).standard_normal(60))
    trials = cl.Trials.from_arrays(np.arange(60.0), walk)
    still = cl.Law.from_text("x' = 0")
    errors = ErrorModel(walk=np.array([1.0]))
    fit = fitted(replace(still, uncertainty=cl.law.Uncertainty(noise=np.array([0.1]), error_model=errors)), trials)
    assert np.ptp(fit.trajectories[0].states) < 1e-9
    assert fit.score() < 0.05
    assert fit.std is None


def test_what_curves_are_is_said():
    trials = cl.Trials.from_arrays([TIMES] * 2, [grown(0.1), grown(0.2)], names=["w"], units={"t": "h"})
    law = law_with(ErrorModel(), 0.01)
    assert fitted(law, trials).is_fit
    first, some, later = law.predict(trials), law.predict(trials, start=7), law.predict(trials, from_time=5.0)
    assert not any(each.is_fit for each in (first, some, later))
    assert first.title == "forecast from the first sample"
    assert some.title == "forecast from the first 7 samples"
    assert later.title == "forecast from t = 5 h"
    assert repr(some) == "<Forecast from the first 7 samples of 2 trials>"
