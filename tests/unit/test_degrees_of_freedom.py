"""Intervals where noise is estimated from few measurements: the same for equations with and without a written start."""

import numpy as np
import pytest
from scipy.stats import norm, t as student

import commonlaw as cl
from commonlaw.estimation import likelihood_profile
from commonlaw.estimation.beginning import begin
from commonlaw.estimation.fitting import fit_model
from commonlaw.estimation.model import ModelText

RATE = 0.5


def decays(random, samples, fewer=0):
    """Return samples of two decays, of the second with some left out at the end."""
    times = np.linspace(0, 4, samples)
    states = np.exp(np.outer(times, [-RATE, -2 * RATE])) * [2, 3] + 0.1 * random.standard_normal((samples, 2))
    states[samples - fewer :, 1] = np.nan
    return cl.Trials.from_arrays(times, states, names=["x", "y"])


def single(random, samples=8):
    times = np.linspace(0, 4, samples)
    states = 2 * np.exp(-RATE * times) + 0.1 * random.standard_normal(samples)
    return cl.Trials.from_arrays(times, states[:, np.newaxis], names=["x"])


def shot(text, trials, **options):
    """Return the law of equations with written starts, from one first value of each unknown."""
    return fit_model(begin(ModelText.of(text), trials, {}, **options), 0, lambda _: None, draws=1).law(())


DECAY = "x' = -k x; x(0) = h"


def ends(law, names, level=0.95):
    return law.conf_int(level).set_index("parameter").loc[names, ["low", "high"]].to_numpy()


def test_a_written_start_leaves_intervals_as_they_are():
    trials = decays(np.random.default_rng(1), 9, fewer=4)
    plain = cl.fit("x' = -k x; y' = -q y", trials)
    written = shot("x' = -k x; x(0) = h; y' = -q y; y(0) = b", trials)
    assert plain.uncertainty.degrees_of_freedom == pytest.approx([7, 3], abs=1e-4)
    assert written.uncertainty.degrees_of_freedom == pytest.approx([7, 3], abs=1e-4)
    errors = written.params.set_index("parameter").loc[["k", "q"], ["standard error"]].to_numpy()
    for level in (0.5, 0.95, 0.99):
        difference = ends(plain, ["k", "q"], level) - ends(written, ["k", "q"], level)
        assert np.abs(difference / errors).max() < 1e-3
    forecasts = [law.predict(trials, start="all", return_std=True) for law in (plain, written)]
    (low, high), (low_written, high_written) = (forecast.bands(measured=True)[0] for forecast in forecasts)
    assert low_written == pytest.approx(low, abs=1e-4)
    assert high_written == pytest.approx(high, abs=1e-4)


@pytest.mark.parametrize(("samples", "draws"), [(6, 30), pytest.param(8, 500, marks=pytest.mark.slow)])
def test_intervals_hold_the_truth_as_often_as_stated(samples, draws):
    random = np.random.default_rng(5)
    rows = [shot(DECAY, single(random, samples)).params.iloc[0] for _ in range(draws)]
    held = np.mean([row["low"] <= RATE <= row["high"] for row in rows])
    by_normal = np.mean([abs(row["estimate"] - RATE) < norm.ppf(0.975) * row["standard error"] for row in rows])
    deviation = np.sqrt(0.95 * 0.05 / draws)
    assert abs(held - 0.95) < 2 * deviation
    assert by_normal < held - deviation


def test_known_noise_has_normal_intervals():
    law = shot(DECAY, single(np.random.default_rng(3)), noise={"x": 0.1})
    assert law.uncertainty.degrees_of_freedom is None
    row = law.params.iloc[0]
    assert (row["high"] - row["estimate"]) / row["standard error"] == pytest.approx(norm.ppf(0.975))


@pytest.mark.parametrize("std", [1e-5, 1e5])
def test_a_prior_is_not_widened_by_the_noise(std):
    law = shot(DECAY, single(np.random.default_rng(3)), priors={"k": (RATE, std)})
    row = law.params.iloc[0]
    reach = (row["high"] - row["estimate"]) / row["standard error"]
    assert reach == pytest.approx(norm.ppf(0.975) if std < 1 else student.ppf(0.975, 6), rel=1e-4)
    # A parameter that the prior fixes spends no measurement
    assert law.uncertainty.degrees_of_freedom == pytest.approx(7 if std < 1 else 6, rel=1e-4)


def test_every_interval_takes_the_degrees_of_freedom(tmp_path):
    trials, reach = single(np.random.default_rng(3)), student.ppf(0.975, 6)
    law = shot(DECAY, trials)
    profile = likelihood_profile(law, trials, "k")
    assert profile.quantile == pytest.approx(reach**2)
    low, high = profile.interval
    assert (high - low) / 2 == pytest.approx(reach * profile.error, rel=0.05)
    (bound,) = cl.bounds(law, trials, ["1"]).bounds
    assert (bound.high - bound.low) / 2 == pytest.approx(student.ppf(0.975, 5) * bound.error)
    forecast = law.predict(trials, return_std=True)
    assert forecast.margins()[0] == pytest.approx(reach * forecast.std[0])
    law.save(tmp_path / "law.json")
    again = cl.Law.load(tmp_path / "law.json")
    assert ends(again, ["k", "h"]) == pytest.approx(ends(law, ["k", "h"]))
    assert again.predict(trials, return_std=True).margins()[0] == pytest.approx(forecast.margins()[0])
    updated = law.update(single(np.random.default_rng(9)))
    row = updated.params.iloc[0]
    assert (row["high"] - row["estimate"]) / row["standard error"] == pytest.approx(reach)
