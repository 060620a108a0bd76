"""Of trials with more samples than the likelihood carries a part is fitted, and the law says which."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import OutcomeKind
from commonlaw.discovery import default_method
from commonlaw.inference.data.subsampling import can_be_subsampled, subsample
from commonlaw.law.parameters import standard_errors

NOISE = 0.01


def swinging(step, *lengths, objects=None):
    generator = np.random.default_rng(2)
    times = [step * np.arange(length) for length in lengths]
    states = [np.cos(time) + NOISE * generator.standard_normal(len(time)) for time in times]
    return cl.Trials.from_arrays(times, states, object=objects or ["one"] * len(lengths))


def test_trials_that_are_carried_stay_as_they_are():
    trials = swinging(0.1, 300, 200)
    fitted, words = subsample(trials, np.array([NOISE]), 500)
    assert fitted is trials
    assert words == ""


def test_close_samples_are_thinned_over_the_whole_of_each_trial():
    trials = swinging(0.002, 9000, 6000)
    fitted, words = subsample(trials, np.array([NOISE]), 1500)
    assert words == "1500 of 15000: every 10th"
    for before, after in zip(trials, fitted, strict=True):
        np.testing.assert_array_equal(after.times, before.times[::10])
        np.testing.assert_array_equal(after.states, before.states[::10])


def test_samples_that_just_resolve_the_motion_are_kept_in_segments_spread_over_the_trials():
    trials = swinging(0.3, 4000, 1000)
    fitted, words = subsample(trials, np.array([NOISE]), 1000)
    assert words == "1000 of 5000: in 5 segments spread over the trials"
    assert {trial.name.split(",")[0] for trial in fitted} == {"1", "2"}
    for trial in fitted:
        np.testing.assert_allclose(np.diff(trial.times), 0.3)
    (first, last) = (fitted[i] for i in (0, -1))
    assert first.times[0] == 0
    assert last.times[-1] == trials[1].times[-1]


def test_every_object_keeps_its_share():
    trials = swinging(0.3, 300, 5000, 700, objects=["short", "long", "middle"])
    fitted, _ = subsample(trials, np.array([NOISE]), 2000)
    kept = {name: sum(map(len, fitted.of_object(name))) for name in trials.objects}
    assert kept["short"] == 300
    assert kept["middle"] == 700
    assert 900 <= kept["long"] <= 1000


def test_inputs_are_never_thinned():
    times = 0.002 * np.arange(4000)
    trials = cl.Trials.from_arrays(times, np.cos(times), inputs=np.sign(np.sin(9 * times)))
    fitted, _ = subsample(trials, np.array([1e-4]), 1000)
    assert all(np.allclose(np.diff(trial.times), 0.002) for trial in fitted)


@pytest.mark.parametrize(("step", "samples", "how"), [(0.01, 8000, "every 8th"), (0.25, 2400, "2 segments")])
def test_the_law_of_a_part_has_errors_and_says_what_it_was_fitted_to(step, samples, how):
    trials = swinging(step, samples)
    law = cl.discover(trials, order=2, library="poly:1", method=cl.TrajectoryLikelihood(max_samples=500))
    assert law.structure == ("x'' = a x",)
    error = standard_errors(law)[0][law.support][0]
    assert 0 < error < 1e-3
    assert law.coefficients[0][law.support][0] == pytest.approx(-1.0, abs=4 * error)
    assert law.uncertainty.noise[0] == pytest.approx(NOISE, rel=0.05)  # By all samples
    (said,) = [diagnostic for diagnostic in law.diagnostics if diagnostic.kind is OutcomeKind.SAMPLES]
    assert how in said.text
    assert law.history[0].stage == "samples"
    assert law.assess(trials).usable


def test_another_method_is_taken_where_objects_are_too_many_only_and_that_is_said():
    long = cl.Trials.from_arrays(np.arange(60_000.0), np.zeros(60_000))
    many = cl.Trials.from_arrays([np.arange(220.0)] * 260, [np.zeros(220)] * 260, object=[*map(str, range(260))])
    assert can_be_subsampled(long)
    assert not can_be_subsampled(many)
    assert isinstance(default_method(long), cl.TrajectoryLikelihood)
    assert isinstance(default_method(many), cl.DerivativeRegression)
