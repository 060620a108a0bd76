"""Curves through measurements with gaps and outliers against those without."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.differentiation import RobustSpline, SmoothingSpline
from tests.refusals import refused

DRAWS = 6


def lorenz(samples=250):
    trial = cl.datasets.lorenz(samples=samples, rate=100.0, trials=1)[0]
    return trial.times, trial.states


def oscillator():
    times = np.linspace(0, 10, 150)
    return times, np.column_stack([np.exp(-0.1 * times) * wave(2 * times) for wave in (np.sin, np.cos)])


def drop():
    times = np.arange(42) / 15
    return times, (47 - 9.8 * (times / 0.3 - (1 - np.exp(-0.3 * times)) / 0.09))[:, np.newaxis]


def noisy(states, level, seed):
    """Return states with noise, and with gross outliers on top in a twentieth of the values."""
    rng = np.random.default_rng(seed)
    noise = level * states.std(axis=0)
    measured = states + noise * rng.standard_normal(states.shape)
    spoiled = rng.random(states.shape) < 0.05
    return measured, measured + 20 * noise * spoiled * rng.choice([-1, 1], states.shape)


def error(rates, states):
    return np.sqrt(np.mean((rates.states - states) ** 2, axis=0))


@pytest.mark.parametrize(
    ("make", "level"),
    [
        *((lorenz, 0.1), (oscillator, 0.01), (drop, 0.01), (drop, 0.1)),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((lorenz, 0.01), (oscillator, 0.1))),
    ],
)
def test_gross_outliers_hardly_make_the_curve_worse(make, level):
    times, states = make()
    ratios = []
    for seed in range(DRAWS):
        clean, spoiled = noisy(states, level, seed)
        reached = error(RobustSpline().differentiate(times, spoiled, 1), states)
        ratios += list(reached / error(SmoothingSpline().differentiate(times, clean, 1), states))
    assert np.median(ratios) < 1.1
    assert np.mean(np.array(ratios) < 1.5) > 0.8


@pytest.mark.parametrize("level", [0, 0.001, 0.01, 0.1])
@pytest.mark.parametrize("make", [lorenz, oscillator, drop])
def test_without_outliers_the_curve_is_that_of_the_smoothing_spline_bit_for_bit(make, level):
    times, states = make()
    same = []
    for seed in range(DRAWS):
        clean, _ = noisy(states, level, seed)
        robust, plain = (method().differentiate(times, clean, 2) for method in (RobustSpline, SmoothingSpline))
        pairs = zip((robust.states, *robust.derivatives), (plain.states, *plain.derivatives), strict=True)
        same.append(np.all([np.all(one == other, axis=0) for one, other in pairs], axis=0))
    assert np.mean(same) > 0.85


@pytest.mark.parametrize("seed", range(2))
def test_an_outlier_in_the_last_sample_of_many_is_found_and_the_curve_goes_on_straight(seed):
    times, states = lorenz(500)
    measured, _ = noisy(states, 0.1, seed)
    measured[-1] += 2 * states.std(axis=0)
    found = RobustSpline().differentiate(times, measured, 1)
    expected = SmoothingSpline().differentiate(times[:-1], measured[:-1], 1)
    np.testing.assert_allclose(found.states[:-1], expected.states, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.states[-1], expected.states[-1] + expected.derivatives[0][-1] / 100, atol=1e-9)


def test_in_gaps_stands_the_natural_spline_through_the_measured_values():
    times, states = oscillator()
    gaps = [10, 11, 12, 70, 149]
    measured, _ = noisy(states, 0.01, 1)
    gapped = measured.copy()
    gapped[gaps, 0] = np.nan
    found = RobustSpline().differentiate(times, gapped, 2)
    kept = np.delete(np.arange(150), gaps)
    expected = SmoothingSpline().differentiate(times[kept], measured[kept, :1], 2)
    for one, other in zip((found.states, *found.derivatives), (expected.states, *expected.derivatives), strict=True):
        np.testing.assert_allclose(one[kept, 0], other[:, 0], rtol=0, atol=1e-9 * np.abs(other).max())
    np.testing.assert_allclose(found.states[gaps, 0], states[gaps, 0], atol=0.03)
    assert found.derivatives[1][149, 0] == pytest.approx(0, abs=1e-9)
    whole = SmoothingSpline().differentiate(times, measured[:, 1:], 2)
    np.testing.assert_array_equal(found.states[:, 1:], whole.states)


def test_too_few_values_are_refused_by_the_number_of_the_state():
    times, states = oscillator()
    short = np.where(np.arange(150)[:, np.newaxis] < [150, 4], states, np.nan)
    with refused("too-few-values", state=2, measured=4, least=5):
        RobustSpline().differentiate(times, short, 1)
