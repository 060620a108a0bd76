"""Trials of few samples: what may be asked of them, and what is assumed of their noise."""

import numpy as np
import pytest
from scipy.optimize import curve_fit

import commonlaw as cl
from commonlaw import datasets
from commonlaw.inference.data.noise import estimated_noise

TIMES = np.linspace(0, 4, 5)


def test_ten_objects_of_five_samples_pay_for_two_terms_together():
    """Populations that double in about a time unit until they fill their room."""
    random, states = np.random.default_rng(0), []
    for _ in range(10):
        room, start, rate = random.uniform([2.0, 0.3, 0.8], [3.0, 0.8, 1.5])
        grown = room / (1 + (room / start - 1) * np.exp(-rate * TIMES))
        states.append(grown + 0.02 * random.standard_normal(5))
    trials = cl.Trials.from_arrays([TIMES] * 10, states, object=[f"object {i}" for i in range(10)], names=["x"])
    assert cl.discover(trials, library="poly:3", order=1).structure == ("x' = a x + b x^2",)


def test_as_many_terms_as_samples_can_tell_apart_are_said_to_be_so():
    one = datasets.linear_drag(drag=(-0.2,), noise=0.02, samples=12, rate=4, trials=1)
    law = cl.discover(one, order=2, library="poly:2", method=cl.TrajectoryLikelihood(noise={"x": 0.02}))
    assert law.support.sum() == 2
    assert [diagnostic.kind for diagnostic in law.diagnostics if diagnostic.kind != "not identifiable"] == [
        "few samples"
    ]
    law.predict(one, start=1)
    more = cl.discover(datasets.linear_drag(samples=20, rate=6), order=2, library="poly:2")
    assert "few samples" not in {diagnostic.kind for diagnostic in more.diagnostics}


@pytest.mark.parametrize("samples", [2, *(pytest.param(count, marks=pytest.mark.slow) for count in (3, 4)), 5, 7])
@pytest.mark.parametrize("order", [1, 2])
def test_a_single_short_trial_gives_a_law_and_says_what_noise_was_assumed(samples, order):
    times = np.linspace(0, 2, samples)
    law = cl.discover(cl.Trials.from_arrays(times, 3 * np.exp(-times)), order=order, library="poly:3")
    if samples - order - law.support.sum() < 4:  # Else the residuals of exact values estimate the noise
        assert law.history[0].reason.startswith("assumed: ")
        assert law.history[0].reason.endswith("`noise={'x': ...}`")


def test_noise_of_short_trials_is_the_scatter_about_parabolas_of_all_of_them_together():
    random, times = np.random.default_rng(0), np.array([0.0, 1.0, 1.5, 3.0, 4.0])
    states = [i + times - 0.1 * times**2 + 0.3 * random.standard_normal(5) for i in range(6)]
    trials = cl.Trials.from_arrays([times] * 6, states, object=list("abcdef"))
    rests = [np.polyfit(times, state, 2, full=True)[1][0] for state in states]
    assert estimated_noise(trials)[0] == pytest.approx([np.sqrt(sum(rests) / 12)], rel=1e-9)


def test_a_law_of_short_trials_has_the_noise_of_the_residuals_of_all_objects():
    times, generator = np.array([0.0, 1.0, 2.0, 4.0, 7.0, 10.0]), np.random.default_rng(0)
    states = [a / (1 + 0.5 * a * times) + 0.03 * generator.standard_normal(6) for a in np.linspace(1.5, 4, 8)]
    vials = cl.Trials.from_arrays([times] * 8, states, object=list("abcdefgh"))
    law = cl.discover(vials, order=1, library="poly:3")
    assert law.structure == ("x' = a x^2",)
    fits = [curve_fit(lambda t, a, k: a / (1 + a * k * t), times, state, [state[0], 0.5])[0] for state in states]
    left = sum(np.sum((a / (1 + a * k * times) - state) ** 2) for (a, k), state in zip(fits, states, strict=True))
    assert law.uncertainty.noise == pytest.approx(
        [np.sqrt(left / (48 - 16))], rel=0.1
    )  # Pooled rates have more freedom
