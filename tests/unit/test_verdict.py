"""What a law is good for, in numbers and in words."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw import datasets


@pytest.fixture(scope="module")
def drops():
    return datasets.linear_drag(noise=0.05)


@pytest.fixture(scope="module")
def line():
    """A state that grows by 1 in each unit of time until t = 30, and by 3 from then on."""
    times = np.arange(41.0)
    return cl.Trials.from_arrays(times, times + 2 * np.maximum(times - 30, 0), units={"t": "s", "x": "m"})


def rms(values):
    return np.sqrt(np.mean(np.square(values)))


def test_a_true_law_forecasts_held_out_trials_and_its_bands_hold(drops):
    learned = drops.select(trial=1)
    verdict = cl.fit("x'' = -g - c v", learned).verdict(drops, learned)
    assert verdict.usable
    assert (verdict.segments, verdict.in_sample) == (5, False)
    assert verdict.horizon == verdict.longest > 1.5
    assert verdict.error < 0.02 * verdict.persistence
    assert verdict.coverage > 0.85
    assert verdict.sentences[0].startswith(f"This law can be used for forecasts up to {verdict.horizon:.3g} s ahead")
    assert "trials that were held out" in verdict.sentences[1]
    assert not verdict.poorly_known


def test_what_was_learned_from_is_judged_where_nothing_was_held_out_and_that_is_said(drops):
    law = cl.fit("x'' = -g - c v", drops)
    for verdict in (law.verdict(drops), law.verdict(drops, drops)):
        assert verdict.usable
        assert verdict.in_sample
        assert verdict.measurements == sum(len(each) - int(np.ceil(0.65 * len(each))) for each in drops)
        assert str(verdict).startswith("By samples that it was learned from")
        assert "the last 35 % of trials" in str(verdict)


def test_errors_are_those_of_forecasts_from_the_samples_before(line):
    early = line.until(25.0)
    verdict = cl.Law.from_text("x' = 1").verdict(line, early)
    leads, later = np.arange(1.0, 16.0), line[0].states[26:, 0]
    errors, last = 25 + leads - later, 25 - later
    spread = np.std(line[0].states)
    # Parts of three samples, of which the errors of 14 to 18, 20 to 24 and so on are within half the spread or not
    parts = np.split(np.arange(15), 5)
    good = [rms(errors[part]) <= spread / 2 for part in parts]
    end = leads[parts[good.index(False) - 1][-1]]
    near = leads <= end
    assert (verdict.horizon, verdict.longest) == (end, 15.0)
    assert verdict.error == pytest.approx(rms(errors[near]) / spread, rel=1e-4)
    assert verdict.state_errors[0].persistence == pytest.approx(rms(last[near]))
    assert verdict.persistence == pytest.approx(rms(last[near]) / spread)
    assert "s ahead, beyond which it is off by more than half of the states' spread" in verdict.sentences[0]


def test_forecasts_no_better_than_the_last_value_are_not_to_be_used(line):
    verdict = cl.Law.from_text("x' = 1e-12").verdict(line, line.until(25.0))
    assert verdict.error == pytest.approx(verdict.persistence)
    assert verdict.usable is False
    assert "no better than persistence" in verdict.sentences[0]


@pytest.mark.parametrize("seed", range(3))
def test_random_walks_and_noise_cannot_be_forecast(seed):
    draws = np.random.default_rng(seed).normal(size=(2, 6, 60))
    for states in (np.cumsum(draws[0], axis=1), draws[1]):
        trials = cl.Trials.from_arrays([np.arange(60.0)] * 6, list(states))
        for learned in (trials.until(40.0), trials):
            verdict = cl.fit("x' = a + b x", learned).verdict(trials, learned)
            assert verdict.usable is False
            assert verdict.sentences[0].startswith("Do not use this law for forecasts: ")


def test_a_law_that_runs_away_is_not_to_be_used(line):
    verdict = cl.Law.from_text("x' = x^2").verdict(line)
    assert (verdict.diverged, verdict.usable) == (1, False)
    assert verdict.sentences[0] == "Do not use this law for forecasts: its forecasts run away in 1 of 1 segment."


def test_forecasts_that_are_worse_than_the_mean_are_not_to_be_used_however_good_the_nearest_are():
    times = np.linspace(0, 40, 401)
    swinging = cl.Trials.from_arrays(times, np.sin(times))
    law = cl.Law.from_text("x'' = -k x", {"k": 1.2})
    verdict = law.verdict(swinging, swinging.until(10.0))
    errors = verdict.state_errors[0].law
    assert verdict.horizon > 0
    assert errors < 0.5 * np.std(swinging[0].states)
    assert verdict.r_squared < 0
    assert verdict.usable is False
    assert f"R^2 is {verdict.r_squared:.3g}" in verdict.sentences[0]


def test_bands_that_fail_are_told(drops):
    law = cl.fit("x'' = -g - c v", drops)
    certain = replace(law.uncertainty, noise=law.noise / 50, covariance=law.covariance / 2500)
    verdict = replace(law, uncertainty=certain).verdict(drops)
    assert verdict.coverage < 0.5
    assert verdict.usable is False
    assert "bands held only" in verdict.sentences[0]


def test_missing_values_are_not_compared(drops):
    trial = drops[0]
    states, times = trial.states.copy(), trial.times
    states[[5, -3, -7], 0] = np.nan
    one = drops.with_trials([replace(trial, states=states)])
    law = cl.fit("x'' = -g - c v", one)
    verdict = law.verdict(one, one.until(times[29]))
    assert verdict.measurements == len(times) - 30 - 2
    assert verdict.usable


def test_several_states_are_named_with_their_units():
    trials = datasets.lotka_volterra(noise=0.1, trials=1, samples=60)
    early = trials.until(3.0)
    verdict = cl.fit("x' = a x - b x y; y' = -c y + d x y", early).verdict(trials, early)
    assert verdict.usable
    assert "forecasts of x and y are off by" in str(verdict)
    assert "later samples that were held out" in str(verdict)


def test_an_unknown_object_is_forecast_with_the_mean_of_the_others(drops):
    learned = drops.select(object=drops.objects[1:])
    verdict = cl.fit("x'' = -g - c v", learned).verdict(drops, learned)
    assert verdict.unknown_objects == drops.objects[:1]
    assert verdict.segments == len(drops.of_object(drops.objects[0]))
    assert verdict.coverage > 0.85  # The scatter of the others' coefficients is in the bands
    assert "knows the other objects' mean coefficients only" in str(verdict)


def test_what_is_too_short_is_not_judged():
    trials = cl.Trials.from_arrays([[0.0, 1.0], [0.0]], [[1.0, 2.0], [1.0]])
    verdict = cl.Law.from_text("x' = 1").verdict(trials)
    assert verdict.usable is None
    assert verdict.sentences == (
        "Whether this law can be used for forecasts could not be judged: nothing was measured in what it forecasts.",
        "Not judged: object, trial 1: its 2 samples are too few; object, trial 2: its 1 samples are too few.",
    )


def test_little_and_still_data_are_no_test(line):
    law = cl.Law.from_text("x' = 1")
    few = law.verdict(line.until(12.0), line.until(8.0))
    assert (few.usable, few.lacking) == (None, "too few, 4 measurements, to compare with")
    still = cl.Trials.from_arrays(np.arange(40.0), np.exp(-np.arange(40.0)))
    verdict = cl.Law.from_text("x' = -x").verdict(still)
    assert (verdict.usable, verdict.lacking) == (None, "the states hardly move in what was judged")


def test_an_exact_forecast_is_told_without_a_ratio():
    trials = cl.Trials.from_arrays(np.arange(20.0), np.arange(20.0))
    verdict = cl.Law.from_text("x[k+1] = x + 1").verdict(trials)
    assert (verdict.error, verdict.usable) == (0, True)
    assert "are off by 0, persistence (the states stay as they were last measured) by 4." in str(verdict)


def test_coefficients_with_large_errors_are_poorly_known():
    law = cl.Law.from_text("x' = a - b x", {"a": {"one": 1.0, "two": 1.0}, "b": 0.1})
    covariance = np.array([np.diag([0.01, 0.01]), np.diag([0.36, 0.01])])
    law = replace(law, uncertainty=replace(law.uncertainty, covariance=covariance, noise=np.array([0.1])))
    trials = cl.Trials.from_arrays([np.arange(20.0)] * 2, [np.arange(20.0) ** 0.5] * 2, object=["one", "two"])
    verdict = law.verdict(trials)
    assert verdict.poorly_known == ("a (x', before 1, of two)", "b (x', before x)")


def test_laws_in_discrete_time_and_without_errors_are_judged():
    states = [0.3]
    for _ in range(40):
        states.append(1.5 * states[-1] * (1 - states[-1]) + 0.05 * np.sin(len(states)))
    trials = cl.Trials.from_arrays(np.arange(41.0), states)
    verdict = cl.fit("x[k+1] = r x (1 - x)", trials).verdict(trials)
    assert verdict.measurements == 14
    assert verdict.coverage is None
    assert "It has no bands" in str(verdict)
