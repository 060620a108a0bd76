"""What a report says at its top where the law is not in the library, or forecasts are no better than parameters."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.likelihood import ERRORS
from commonlaw.report import law_report
from commonlaw.report.document import Text
from commonlaw.verdict import find


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(drag=(-0.5, -0.9), trials=1, noise=0.02)


def test_a_law_that_the_library_lacks_is_said_to_be_a_summary_with_what_it_leaves(drops):
    law = cl.discover(drops, order=2, library="terms:x")
    report = law_report(find(law, drops))
    text = "\n\n".join([report.summary, *(block.text for block in report.blocks if isinstance(block, Text))])
    top = re.sub(r"\\(.)", r"\1", re.sub(r"\$\$.*?\$\$", "", text))  # Without its formula and marks
    assert law.uncertainty.error_model.of_law
    assert "Lack of fit: no law in the library fits the data within the noise; the bands include process noise." in top
    deviation = law.uncertainty.misfit.deviation[0]
    assert f"beyond the law: {ERRORS[law.uncertainty.error_model.kind].description.partition('{')[0]}" in top
    assert f"by {deviation:.2g} m in x" in top
    # Of the solutions nearest to all samples, which leave less than forecasts of whole trials do
    noise = law.uncertainty.noise[0]
    errors = find(law, drops).fit.to_frame()["x error"]
    assert deviation == pytest.approx(np.sqrt(np.mean(errors**2) - noise**2), rel=0.15)
    # Forecasts of whole trials from their first fifth, each by itself
    forecasts = [
        law.predict(drops.with_trials([drop]), from_time=drop.times[10], return_std=True, tolerance=1e-6).to_frame()
        for drop in drops
    ]
    frame = pd.concat(forecasts)
    error = np.sqrt(np.mean(frame["x error"] ** 2))
    held = np.mean((frame["x measured low"] <= frame["x"]) & (frame["x"] <= frame["x measured high"]))
    assert f"{len(frame)} measurements" in top
    assert f"RMS forecast error: {error:.3g} m in x" in top
    assert f"{100 * held:.0f} % of the measurements lie within the 95 % bands (about 95 % expected)" in top
    assert noise == pytest.approx(0.02, rel=0.2)
    assert error > 10 * noise
    assert "Suggestions: add terms" not in top  # What would distinguish these is said with the law
    whole = law.predict(drops, start=10).to_frame()["x error"]
    (by_state,) = [block for block in report.named_blocks() if block.name == "forecast-by-state"]
    assert by_state.frame["RMS error"].item() == pytest.approx(np.sqrt(np.mean(whole**2)))
    assert np.sqrt(np.mean(whole**2)) > 10 * noise
    intro = next(section for section in report.sections if section.name == "forecasts").blocks[0].text
    assert "from the first 10 samples" in intro


def test_a_law_that_was_given_and_is_wrong_is_said_to_be_inexact_too(drops):
    verdict = cl.fit("x'' = a x", drops).assess(drops)
    assert not verdict.exact
    assert verdict.process_noise
    assert verdict.sentences[1].startswith("Lack of fit: this law does not fit the data within the noise")


def test_a_state_of_noise_leaves_the_horizon_of_the_others():
    times, random = np.linspace(0, 4, 21), np.random.default_rng(0)
    decays = [start * np.exp(-0.5 * times) + 0.01 * random.standard_normal(21) for start in (1, 2, 3)]
    states = [np.column_stack([decay, random.standard_normal(21)]) for decay in decays]
    trials = cl.Trials.from_arrays([times] * 3, states, object="o", trial=["p", "q", "r"], names=["x", "y"])
    law = cl.fit("x' = -k x; y' = -c y", trials)
    verdict = law.assess(trials)
    assert (verdict.usable, verdict.horizon, verdict.unpredicted) == (True, 4.0, ("y",))
    forecast = law.predict(trials, from_time=times[1]).to_frame()
    assert verdict.r_squared > 0.99 > 0.5 > 1 - np.mean(forecast["y error"] ** 2) / np.var(forecast["y"])


def test_of_several_states_those_that_are_forecast_no_better_are_named():
    times = np.arange(40.0)
    trials = cl.Trials.from_arrays(times, np.column_stack([times, 2 * times]), names=["x", "y"])
    verdict = cl.Law.from_text("x' = 1; y' = 1.99").assess(trials)
    x, y = verdict.state_errors
    assert verdict.usable
    assert "no better" not in str(verdict)
    worse = replace(verdict, state_errors=(x, y._replace(persistence=y.law)))
    assert "For y the law is no better than a constant forecast." in worse.sentences
