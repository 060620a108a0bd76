"""Forecasts that begin at a time within the trials."""

from dataclasses import replace

import numpy as np
import pytest

from commonlaw.law import Law, Uncertainty
from commonlaw.library import Variables, parse_library
from commonlaw.likelihood import ErrorModel
from commonlaw.trials import Schema, Trial, Trials
from tests.refusals import refused

TIMES = np.cumsum(np.random.default_rng(0).uniform(0.1, 0.4, 30))
NOISE = 0.1


def decay(order=1, noise=(NOISE,)):
    """x' = -x, x'' = -x or x[k+1] = 0.9 x[k]."""
    terms = parse_library("terms:x").bind(Variables(("x", "v") if order == 2 else ("x",)))
    value = np.array([[[0.9 if order == 0 else -1.0]]])
    return Law(terms, Schema(("x",)), order, ("tank",), value, uncertainty=Uncertainty([[[0.0]]], noise=noise))


def trials_of(law, *states, times=TIMES):
    return Trials(
        tuple(Trial("tank", str(i), times[: len(state)], state) for i, state in enumerate(states)), law.schema
    )


STATES = 5 * np.exp(-TIMES) + NOISE * np.random.default_rng(1).standard_normal(30)


@pytest.mark.parametrize("start", [None, 4])
def test_the_samples_before_tell_the_start_and_those_after_do_not(start):
    law, count = decay(), 12
    states = STATES.copy()
    states[count:] = 77.0
    forecast = law.predict(trials_of(law, states), from_time=TIMES[count], start=start, return_std=True)
    used = slice(0 if start is None else count - start, count)
    weights = np.exp(-TIMES[used])
    size = weights @ STATES[used] / (weights @ weights)
    frame = forecast.to_frame()
    np.testing.assert_array_equal(frame["t"], TIMES[count:])
    np.testing.assert_allclose(frame["x forecast"], size * np.exp(-TIMES[count:]), rtol=1e-6)
    spread = NOISE * np.exp(-TIMES[count:]) / np.linalg.norm(weights)
    np.testing.assert_allclose((frame["x high"] - frame["x forecast"]) / 1.959964, spread, rtol=1e-5)
    np.testing.assert_array_equal(forecast.interval()["t"], TIMES[count:])


def test_errors_and_score_are_those_of_what_is_forecast():
    law = decay()
    states = STATES.copy()
    states[3] = 50.0
    forecast = law.predict(trials_of(law, states), from_time=2.0)
    ahead = TIMES >= 2.0
    missed = forecast.trajectories[0].states[-ahead.sum() :, 0] - STATES[ahead]
    assert forecast.errors()["rms error"][0] == pytest.approx(np.sqrt(np.mean(missed**2)))
    assert forecast.errors()["largest error"][0] < 1
    assert forecast.score() == pytest.approx(1 - np.mean(missed**2) / np.var(STATES[ahead]))


def test_rows_without_states_and_other_times_are_forecast_too():
    law = decay()
    open_ended = np.where(TIMES < 3, STATES, np.nan)
    given = law.predict(trials_of(law, open_ended), from_time=3.5)
    assert given.to_frame()["x forecast"].notna().all()
    short = trials_of(law, STATES[:10])
    later = law.predict(short, from_time=20.0, times=[19.0, 20.0, 21.0])
    assert later.to_frame()["t"].tolist() == [20.0, 21.0]
    assert later.errors()["rms error"].isna().all()


def test_trials_that_do_not_reach_so_far_are_left_out_and_named():
    law = decay()
    trials = trials_of(law, STATES, STATES[:6])
    forecast = law.predict(trials, from_time=4.0)
    assert [trial.name for trial in forecast.trials] == ["0"]
    (note,) = forecast.trials.notes
    ends = f"1 (tank, trial 1, t = {TIMES[0]:g} to {TIMES[5]:g})"
    assert note == f"trials not forecast (no samples before or from `from_time=4.0` on: {ends})"
    assert trials.notes == ()
    for nowhere in (TIMES[0], 100.0):
        with refused("forecast-no-trial") as raised:
            law.predict(trials, from_time=nowhere)
        assert f"from_time={nowhere}" in str(raised.value)
    with refused("forecast-from-time"):
        law.predict(trials, from_time=np.nan)


def test_laws_without_noise_begin_at_the_last_sample_before():
    first, states = decay(noise=None), STATES
    found = replace(first, uncertainty=Uncertainty()).predict(trials_of(first, states), from_time=TIMES[9])
    expected = states[8] * np.exp(TIMES[8] - TIMES[9:])
    np.testing.assert_allclose(found.to_frame()["x forecast"], expected, rtol=1e-6)
    steps = replace(decay(0), uncertainty=Uncertainty())
    states = 0.9 ** np.arange(30.0)
    found = steps.predict(trials_of(steps, states, times=np.arange(30.0)), from_time=20)
    np.testing.assert_allclose(found.to_frame()["x error"], 0, atol=1e-12)
    second, times = replace(decay(2), uncertainty=Uncertainty()), np.linspace(0, 6, 200)
    found = second.predict(trials_of(second, np.cos(times), times=times), from_time=3.0)
    assert found.to_frame()["t"].min() >= 3.0
    assert found.errors()["largest error"][0] < 0.02


@pytest.mark.parametrize("errors", [ErrorModel(), ErrorModel(walk=np.array([0.01]))])
def test_long_trials_are_forecast_from_their_last_samples(errors):
    """The forecast is longer than a mesh of discovery."""
    times = np.arange(9000) * 0.01
    law = replace(decay(), uncertainty=replace(decay().uncertainty, error_model=errors))
    states = np.where(times < 42.995, 77.0, 5 * np.exp(43 - times))
    forecast = law.predict(trials_of(law, states, times=times), from_time=47.995, return_std=True)
    assert len(forecast.trials[0]) == 4700
    frame = forecast.to_frame()
    assert len(frame) == 4200
    assert frame["x error"].abs().max() < 1e-3
    assert np.isfinite(frame["x high"]).all()
