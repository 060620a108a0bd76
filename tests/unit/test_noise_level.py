"""The noise estimated from the data against the noise that was put in."""

from math import comb

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.differentiation.noise import (
    _covariance,
    differences,
    noise_level,
    outliers_among,
    outliers_of_window,
    rounding_noise,
)
from commonlaw.formulation import law_variables
from commonlaw.inference.fit.problem import prepare
from tests.refusals import message, refused

RNG_SEED = 0
LEVELS = (0.001, pytest.param(0.1, marks=pytest.mark.slow))
"""Of the noise, in standard deviations of the signal: what is small is more easily taken for a part of this."""


def _sine(samples_a_period, count=150):
    times = np.arange(count) / samples_a_period
    return times, np.sin(2 * np.pi * times + 0.3)


def _lorenz(count=150):
    # A turn takes about 0.75 units of time: a hundred samples
    trial = cl.datasets.lorenz(samples=count, rate=133.0, trials=1)[0]
    return trial.times, trial.states[:, 0]


def _found(signal, level, draws=200, outliers=0.0, size=20.0):
    """Return estimates over many draws in units of the true noise, shape (draws,)."""
    times, values = signal
    generator = np.random.default_rng(RNG_SEED)
    noise = generator.standard_normal((len(times), draws))
    spoiled = generator.random(noise.shape) < outliers
    noise += size * spoiled * generator.choice([-1, 1], noise.shape)
    scale = level * (values.std() or 1)
    return noise_level(times, values[:, np.newaxis] + scale * noise) / scale


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(
    "signal", [_sine(20), _sine(50), _lorenz(), (np.arange(150.0), np.zeros(150))], ids=["20", "50", "chaos", "none"]
)
def test_the_noise_of_150_samples_is_found_without_bias_and_to_a_tenth(signal, level):
    found = _found(signal, level)
    assert found.mean() == pytest.approx(1, abs=0.03)
    assert found.std() < 0.125


@pytest.mark.parametrize("size", [15.0, 1e6])
@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("signal", [_sine(40), _lorenz()], ids=["sine", "chaos"])
def test_outliers_in_one_sample_of_twenty_do_not_count(signal, level, size):
    found = _found(signal, level, 100, outliers=0.05, size=size)
    assert np.median(found) == pytest.approx(1, abs=0.08)
    assert np.quantile(found, 0.9) < 1.35


STEPS = {
    "jitter": np.random.default_rng(1).uniform(0.5, 1.5, 150),
    "two rates": np.repeat([0.3, 1.7], 75),
    "at random": np.random.default_rng(1).exponential(1, 150),
}


@pytest.mark.parametrize("steps", STEPS.values(), ids=STEPS)
@pytest.mark.parametrize("level", LEVELS)
def test_irregular_sampling_does_not_bias_it(steps, level):
    times = np.cumsum(steps)
    found = _found((times, np.sin(2 * np.pi * times / 40)), level)
    assert found.mean() == pytest.approx(1, abs=0.05)
    assert found.std() < 0.16


def test_differences_are_the_leading_coefficients_of_polynomials_with_weights_of_unit_length():
    generator = np.random.default_rng(3)
    times, states = np.cumsum(generator.uniform(0.1, 3, 9)), generator.standard_normal((9, 2))
    for order, found in enumerate(differences(times, states, 4), start=1):
        weights = [np.linalg.inv(np.vander(times[i : i + order + 1]))[0] for i in range(9 - order)]
        expected = [w / np.linalg.norm(w) @ states[i : i + order + 1] for i, w in enumerate(weights)]
        np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize(("j", "k"), [(1, 1), (2, 5), (4, 4), (3, 10)])
def test_the_covariance_of_two_orders_is_the_sum_of_squared_correlations(j, k):
    first, second = (
        np.array([(-1) ** i * comb(order, i) for i in range(order + 1)]) / np.sqrt(comb(2 * order, order))
        for order in (j, k)
    )
    assert _covariance(j, k) == pytest.approx(np.sum(np.correlate(first, second, "full") ** 2))


@pytest.mark.parametrize("signal", [_sine(100), _lorenz(1000)], ids=["sine", "chaos"])
def test_a_smooth_state_without_noise_has_next_to_none(signal):
    times, states = signal
    assert noise_level(times, states[:, np.newaxis])[0] < 1e-11 * states.std()


def test_a_constant_has_none_whatever_its_size():
    np.testing.assert_array_equal(noise_level(np.arange(30) / 7, np.full((30, 2), [1e9, -0.1])), 0)


def test_units_of_states_and_times_and_offsets_only_scale_it():
    times, states = _sine(30)
    noisy = states[:, np.newaxis] + 0.05 * np.random.default_rng(4).standard_normal((150, 1))
    found = noise_level(times, noisy)
    for scale, unit in ((1e-6, 1e9), (1e8, 1e-12)):
        np.testing.assert_allclose(noise_level(unit * (times + 3), scale * (noisy + 10)), scale * found, rtol=1e-6)


@pytest.mark.parametrize(
    ("times", "states", "expected"),
    [
        (
            np.arange(7.0),
            np.zeros((7, 1)),
            message("too-few-samples", count=7, needed=8, method="estimates of the noise"),
        ),
        (np.arange(9.0), np.zeros(9), "shapes-of-times-and-states"),
        (np.arange(9.0), np.zeros((8, 1)), "shapes-of-times-and-states"),
        (
            np.arange(9.0),
            np.where(np.arange(9) == 4, np.nan, 0)[:, np.newaxis],
            message("value-not-finite", sample="5"),
        ),
        (np.array([0, 1, 2, 2, 3, 4, 5, 6.0]), np.zeros((8, 1)), message("times-not-increasing", sample="4")),
    ],
)
def test_what_cannot_be_judged_is_refused_with_the_reason(times, states, expected):
    with refused(expected):
        noise_level(times, states)


def measured_of(values):
    times = np.linspace(0, 5, len(values))
    trials = cl.Trials.from_arrays([times], [values[:, np.newaxis]], names=["x"])
    terms = cl.library.PolynomialLibrary(1).bind(law_variables(trials.schema, 1))
    return prepare(trials, terms, np.full((1, 1, 2), np.nan))


def test_residuals_of_exact_measurements_count_by_the_least_noise():
    values = np.exp(-np.linspace(0, 5, 100))
    problem = measured_of(values)
    assert problem.noise[0] == pytest.approx(1e-4 * values.std())  # What laws are fitted under at least
    assert problem.least_variance == pytest.approx(1)
    less, more = (problem.noise_scale.deviance(share**2 * 100, 2) for share in (0.2, 0.5))
    assert more - less == pytest.approx((0.5**2 - 0.2**2) * 100)  # As squares under known noise
    assert problem.noise_scale.least == pytest.approx(1)


@pytest.mark.parametrize(("decimals", "step"), [(2, 0.01), (4, 1e-4), (15, 0.0)])
def test_few_values_have_the_step_of_their_decimals(decimals, step):
    times = np.arange(8.0)
    trials = cl.Trials.from_arrays([times] * 2, [(10 * np.exp(-r * times)).round(decimals) for r in (0.31, 0.17)])
    assert rounding_noise(trials) == pytest.approx([step / np.sqrt(12)])


def test_digits_tell_no_less_than_their_steps():
    problem = measured_of(np.exp(-np.linspace(0, 5, 100)).round(2))
    assert problem.least_variance == pytest.approx((0.01 / np.sqrt(12) / problem.noise[0]) ** 2)
    assert problem.noise_scale.least == pytest.approx(problem.least_variance)
    assert problem.noise_scale.deviance(1e-6, 2) == pytest.approx(problem.noise_scale.deviance(0.0, 2), abs=1e-3)


def test_outliers_are_found_by_differences_of_measurements_alone():
    random, times, hits, alarms = np.random.default_rng(1), np.linspace(0, 1, 60), 0, 0
    for _ in range(40):
        values = np.sin(12 * times + random.uniform(0, 6)) + 0.05 * random.standard_normal(60)
        places = random.choice(np.arange(3, 57), 3, replace=False)
        values[places] += random.choice([-1, 1], 3)
        far = outliers_among(times, values, 0.05)
        hits, alarms = hits + far[places].sum(), alarms + far.sum() - far[places].sum()
    assert hits > 0.85 * 120
    assert alarms < 0.01 * 40 * 57
    # Large differences within the noise are none, nor are few values, nor what samples do not resolve
    assert not outliers_among(times, values, 1.0).any()
    assert not outliers_among(times[:7], values[:7], 0.05).any()
    assert not outliers_among(times, np.sin(300 * times), 0.0).any()


def test_values_far_from_their_neighbours_are_found_at_the_ends_and_side_by_side():
    values = 0.1 * np.random.default_rng(4).standard_normal(60) + np.linspace(0, 5, 60)
    far = [0, 20, 21, 40, 59]
    values[far] += 3, 3, -3, -3, 3
    assert np.flatnonzero(outliers_of_window(values, 0.1)).tolist() == far
    assert not outliers_of_window(values, 1.0).any()
    assert not outliers_of_window(values[:7], 0.1).any()
    # An error that swings, and one that ends in a divergence
    assert not outliers_of_window(5 * np.sin(np.arange(60) / 2), 0.1).any()
    assert not outliers_of_window(np.append(np.linspace(0, 5, 56), [np.inf] * 4), 0.1).any()
