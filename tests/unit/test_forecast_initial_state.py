"""Starts fitted to the first samples against closed forms, the truth, and their own stated accuracy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares

from commonlaw import datasets
from commonlaw.differentiation import default_differentiation, parse_differentiation
from commonlaw.law import Law, Provenance, Uncertainty
from commonlaw.library import Variables, parse_library
from commonlaw.trials import Schema, Trial, Trials
from tests.refusals import refused


def measured(law, noise, differentiation=None):
    """The law with this noise of its measurements, and this way to estimate rates."""
    return replace(law, uncertainty=replace(law.uncertainty, noise=noise), provenance=Provenance(differentiation))


def law_of(library, states, coefficients, noise, order=1, rates=(), variance=0.0):
    """A law of one object, "tank", whose coefficients in use have this variance and are independent."""
    coefficients = np.array([coefficients], dtype=np.float64)
    terms = parse_library(library).bind(Variables((*states, *rates)))
    uncertainty = Uncertainty([variance * np.eye(int((coefficients != 0).any(axis=0).sum()))], noise=noise)
    return Law(terms, Schema(states), order, ("tank",), coefficients, uncertainty)


def trials_of(law, *states, times):
    return Trials(tuple(Trial("tank", str(i), times, state) for i, state in enumerate(states)), law.schema)


def start_of(forecast):
    return forecast.trajectories[0].states[0]


def noisy(trial, noise, seed):
    """The trial with white noise on its states."""
    return replace(trial, states=trial.states + noise * np.random.default_rng(seed).standard_normal(trial.states.shape))


def test_the_start_of_a_linear_law_and_its_standard_deviation_are_those_of_weighted_least_squares():
    """With samples at irregular times, and values missing, in the first sample too."""
    matrix, noise, rng = np.array([[-0.3, 2.0], [-1.5, -0.1]]), np.array([0.05, 0.2]), np.random.default_rng(0)
    law = law_of("terms:x,y", ("x", "y"), matrix, noise)
    times = 1.3 + np.cumsum(rng.uniform(0.02, 0.2, 40))
    slopes = np.array([expm(matrix * (t - times[0])) for t in times])
    states = slopes @ [1.0, -2.0] + noise * rng.standard_normal((40, 2))
    states[[0, 3, 4, 11], [1, 0, 0, 1]] = np.nan
    forecast = law.predict(trials_of(law, states, times=times), start=15, return_std=True)
    rows = (slopes[:15] / noise[:, np.newaxis]).reshape(-1, 2)
    seen = ~np.isnan(states[:15].ravel())
    expected = np.linalg.lstsq(rows[seen], (states[:15] / noise).ravel()[seen], rcond=None)[0]
    np.testing.assert_allclose(start_of(forecast), expected, rtol=1e-6)
    np.testing.assert_allclose(forecast.trajectories[0].states, slopes @ expected, rtol=1e-5, atol=1e-6)
    covariance = np.linalg.inv(rows[seen].T @ rows[seen])
    deviations = np.sqrt(np.einsum("nij,jk,nik->ni", slopes, covariance, slopes))
    np.testing.assert_allclose(forecast.std[0], deviations, rtol=1e-5)


def test_more_samples_than_a_trial_has_are_all_of_them():
    trials = datasets.linear_drag(noise=0.05)[[0]]
    law = measured(datasets.linear_drag.truth(), [0.05])
    expected, *found = (start_of(law.predict(trials, start=start)) for start in (len(trials[0]), 1000, "all"))
    np.testing.assert_array_equal(found, [expected] * 2)


@pytest.mark.parametrize("noise", [[0.02], [0.0], None])
def test_initial_conditions_fitted_to_whole_trials_are_those_of_least_squares_whatever_is_known_of_the_noise(noise):
    """Logistic growth whose first measurement is below zero: a forecast from there diverges, the fit does not."""
    times, rng = np.linspace(0, 12, 60), np.random.default_rng(1)

    def solution(begin):
        return 1 / (1 + (1 / begin - 1) * np.exp(-times))

    states = solution(0.002) + 0.02 * rng.standard_normal(60)
    states[0] = -0.01
    law = law_of("terms:x,x^2", ("x",), [[1.0, -1.0]], noise)
    forecast = law.predict(trials_of(law, states, times=times), start="all")
    expected = least_squares(lambda begin: solution(begin) - states, 0.005, x_scale=0.001).x
    np.testing.assert_allclose(start_of(forecast), expected, rtol=1e-3)
    np.testing.assert_allclose(forecast.trajectories[0].states[:, 0], solution(expected), atol=2e-5)


def test_standard_deviations_know_that_the_start_makes_up_for_errors_of_the_coefficients():
    times = np.linspace(0, 3, 60)
    measured = noisy(Trial("tank", "1", times, 4 / (1 + np.exp(-times))), 1e-4, 0).states
    law = law_of("terms:x,x^2", ("x",), [[1.0, -0.25]], [0.02], variance=0.03**2)
    trials = trials_of(law, measured, times=times)
    sure = replace(law, uncertainty=replace(law.uncertainty, covariance=np.zeros((1, 2, 2))))
    squares = sure.predict(trials, start=20, return_std=True).std[0] ** 2
    for index in range(2):
        change = np.zeros((1, 1, 2))
        change[..., index] = 1e-4
        ahead, behind = (
            replace(law, coefficients=law.coefficients + sign * change).predict(trials, start=20).trajectories[0].states
            for sign in (1, -1)
        )
        squares = squares + (0.03 * (ahead - behind) / 2e-4) ** 2
    np.testing.assert_allclose(law.predict(trials, start=20, return_std=True).std[0], np.sqrt(squares), rtol=1e-3)


def test_a_law_of_second_order_that_knows_its_noise_starts_from_what_rates_are_estimated_from():
    trials = datasets.linear_drag(noise=0.05, trials=1)
    rule = parse_differentiation("savgol:11:3")
    law = measured(datasets.linear_drag.truth(), [0.05], rule)
    np.testing.assert_array_equal(start_of(law.predict(trials)), start_of(law.predict(trials, start=14)))
    first = trials[0].states[0, 0]
    assert start_of(law.predict(trials))[0] != first
    for plain in (
        law.predict(trials, start=1),
        replace(law, uncertainty=replace(law.uncertainty, noise=None)).predict(trials),
    ):
        assert start_of(plain)[0] == first
    short = trials.with_trials([trial.cut(4) for trial in trials])
    fast = replace(law, provenance=replace(law.provenance, differentiation=parse_differentiation("forward")))
    assert start_of(fast.predict(short))[0] == first
    times = np.arange(40) / 20
    both = law_of("terms:1", ("x", "y"), [[-9.8], [1.0]], [0.1, 0.1], order=2, rates=("vx", "vy"))
    both = replace(both, provenance=Provenance(rule))
    holed = np.column_stack([20 - 4.9 * times**2, times**2 / 2]) + 0.01
    holed[2:20, 1] = np.nan
    np.testing.assert_array_equal(start_of(both.predict(trials_of(both, holed, times=times)))[:2], holed[0])
    pairs = datasets.lotka_volterra(noise=0.1)
    start = start_of(measured(datasets.lotka_volterra.truth(), [0.1, 0.1]).predict(pairs))
    np.testing.assert_array_equal(start, pairs[0].states[0])


def test_an_outlier_among_the_first_samples_pulls_no_harder_than_four_standard_deviations():
    trials = datasets.linear_drag(noise=0.02, seed=2)[[0]]
    law = measured(datasets.linear_drag.truth(), [0.02])
    states = trials[0].states.copy()
    starts = []
    for far in (0.0, 0.1, 5.0):
        states[4] += far
        starts.append(start_of(law.predict(trials.with_trials([replace(trials[0], states=states)]), start=15)))
    np.testing.assert_allclose(starts[1], starts[2], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(starts[0], starts[2], atol=0.05)


def test_standard_deviations_of_a_trajectory_that_runs_away_are_known_as_far_as_it_and_the_first_samples_go():
    times = np.linspace(0, 2, 41)
    law = law_of("terms:x^2", ("x",), [[1.0]], [0.5])
    forecast = law.predict(trials_of(law, 1 + 0 * times, times=times), start=6, return_std=True)
    lost = np.isnan(forecast.trajectories[0].states)
    assert lost.any()
    np.testing.assert_array_equal(np.isnan(forecast.std[0]), lost)
    # v = tan(1000 t + c): whatever the start, it is infinite after pi / 1000
    wild = law_of("terms:1,v^2", ("x",), [[1e3, 1e3]], [0.5], order=2, rates=("v",))
    forecast = wild.predict(trials_of(wild, np.sin(40 * times), times=times), start=6, return_std=True)
    assert np.isnan(forecast.trajectories[0].states[1:]).all()
    assert np.isnan(forecast.std[0]).all()


def test_what_no_start_can_be_fitted_to_is_refused_by_name():
    times = np.linspace(0, 1, 20)
    law = law_of("terms:x,y", ("x", "y"), np.eye(2), [0.1, 0.1])
    states = np.ones((20, 2))
    states[:8, 1] = np.nan
    trials = trials_of(law, states, times=times)
    with refused("initial-value-missing", state="y"):
        law.predict(trials, start=1)
    with refused("initial-values-too-few", name="y", measured=0, samples=8, least=1):
        law.predict(trials, start=8)
    for start in (0, 0.5, "first"):
        with refused("forecast-start", start=start):
            law.predict(trials, start=start)
    for noise, lacking in ((None, "has no noise estimate"), ([0.1, 0.0], "has zero noise for a state")):
        with refused("initial-values-without-noise", lacking=lacking):
            replace(law, uncertainty=replace(law.uncertainty, noise=noise)).predict(trials, start=15)
    with refused("discrete-start"):
        replace(law, order=0).predict(trials, start="all")
    roots = law_of("terms:sqrt(x)", ("x",), [[1.0]], [0.1])
    with refused("initial-value-not-fitted", samples=15, where="tank, trial 0"):
        roots.predict(trials_of(roots, -1 - times, times=times), start=15)


def test_what_the_first_sample_lacks_comes_from_the_next_ones():
    times = np.linspace(0, 1, 20)
    law = law_of("terms:x,y", ("x", "y"), [[0.0, 1.0], [-1.0, 0.0]], [0.01, 0.01])
    states = np.column_stack([np.sin(times), np.cos(times)])
    states[:8, 1] = np.nan
    trials = trials_of(law, states, times=times)
    np.testing.assert_allclose(start_of(law.predict(trials)), [0, 1], atol=1e-4)
    np.testing.assert_array_equal(start_of(law.predict(trials)), start_of(law.predict(trials, start=13)))
    np.testing.assert_allclose(start_of(law.predict(trials, start=10)), [0, 1], atol=1e-4)


@pytest.mark.parametrize("count", [2, 3, 4])
def test_few_samples_tell_the_start_of_a_linear_law_of_second_order_by_least_squares(count):
    times, noise = np.array([0.0, 0.3, 0.4, 0.9, 1.0, 2.0]), 0.05
    law = law_of("terms:x,v", ("x",), [[-1.0, 0.0]], [noise], order=2, rates=("v",))
    heights = np.sin(times) + noise * np.random.default_rng(3).standard_normal(6)
    heights[count:] = np.nan
    forecast = law.predict(trials_of(law, heights, times=times), return_std=True)
    rows = np.column_stack([np.cos(times), np.sin(times)])
    expected = np.linalg.lstsq(rows[:count], heights[:count], rcond=None)[0]
    np.testing.assert_allclose(start_of(forecast), expected, rtol=1e-5)
    covariance = noise**2 * np.linalg.inv(rows[:count].T @ rows[:count])
    np.testing.assert_allclose(forecast.std[0][:, 0] ** 2, np.sum((rows @ covariance) * rows, axis=1), rtol=1e-4)
    assert forecast.errors()["rms error"].notna().all()


def test_a_single_sample_starts_a_law_of_second_order_without_a_rate_and_this_is_said():
    times = np.linspace(0, 1, 5)
    law = law_of("terms:x,v", ("x",), [[-1.0, 0.0]], [0.05], order=2, rates=("v",))
    forecast = law.predict(trials_of(law, [2.0, *[np.nan] * 4], times=times), return_std=True)
    np.testing.assert_allclose(forecast.trajectories[0].states[:, 0], 2 * np.cos(times), rtol=1e-6)
    assert np.isnan(forecast.std[0]).all()
    assert forecast.trials.notes[0].endswith("one sample were set to zero, without a band: tank, trial 0")
    assert np.isnan(forecast.score())


def test_irregular_samples_start_a_law_whose_differentiation_wants_a_uniform_grid():
    times = np.delete(np.linspace(0, 4, 81), [3, 4, 30])
    law = law_of("terms:x,v", ("x",), [[-1.0, 0.0]], [0.01], order=2, rates=("v",))
    law = replace(law, provenance=Provenance(default_differentiation(2)))
    trials = trials_of(law, np.sin(times), times=times)
    for start in (None, 1, 2, 40):
        np.testing.assert_allclose(start_of(law.predict(trials, start=start, return_std=True)), [0, 1], atol=0.01)
    nameless = replace(law, uncertainty=replace(law.uncertainty, noise=None))
    np.testing.assert_allclose(start_of(nameless.predict(trials)), [0, 1], atol=0.01)


def test_a_forecast_has_more_times_than_samples():
    times = np.linspace(0, 1, 11)
    law = law_of("terms:x", ("x",), [[-1.0]], [0.01])
    trials = trials_of(law, np.exp(-times), times=times)
    forecast = law.predict(trials, times=[0.25, 0.1 + 0.2, 2.0], return_std=True)
    assert forecast.trajectories[0].times.tolist() == [*times[:3], 0.25, *times[3:], 2.0]
    np.testing.assert_allclose(forecast.trajectories[0].states[:, 0], np.exp(-forecast.trials[0].times), rtol=1e-6)
    assert forecast.errors()["rms error"].max() < 1e-6
    np.testing.assert_array_equal(
        start_of(law.predict(trials, times=[0.25, 5.0], start=8)), start_of(law.predict(trials, start=8))
    )
    with refused("forecast-times"):
        law.predict(trials, times=[np.inf])


def test_inputs_keep_their_last_value_beyond_the_samples():
    times = np.linspace(0, 1, 11)
    terms = parse_library("terms:u").bind(Variables(("x",), ("u",)))
    law = Law(terms, Schema(("x",), ("u",)), 1, ("tank",), np.array([[[1.0]]]), uncertainty=Uncertainty(noise=[0.1]))
    trials = Trials((Trial("tank", "1", times, 2 * times, 2 + 0 * times),), law.schema)
    assert law.predict(trials, times=[3.0]).trajectories[0].states[-1, 0] == pytest.approx(6)


@pytest.mark.parametrize("start", [None, 3, "all"])
def test_a_forecast_begins_with_the_first_row_even_if_that_is_below_a_limit(start):
    law = law_of("poly:1", ("x",), [[0.0, -0.5]], noise=[1e-3])
    times = np.linspace(0.0, 4.0, 9)
    states = np.exp(-0.5 * times)[:, None]
    states[0], limits = np.nan, np.full((9, 1), np.nan)
    limits[0] = 2.0
    trials = Trials((Trial("tank", "1", times, states, below=limits),), law.schema)
    forecast = law.predict(trials, start=start)
    for curve in (forecast.trajectories[0], forecast.smooth(20).trajectories[0]):
        np.testing.assert_allclose(curve.states[:, 0], np.exp(-0.5 * curve.times), rtol=1e-6)


def test_a_forecast_from_one_sample_begins_with_the_first_that_is_measured():
    law = law_of("poly:1", ("x",), [[0.0, -0.5]], noise=None)
    times = np.linspace(0.0, 4.0, 9)
    states, limits = np.exp(-0.5 * times)[:, None], np.full((9, 1), np.nan)
    states[:2], limits[:2] = np.nan, 2.0
    trials = Trials((Trial("tank", "1", times, states, below=limits),), law.schema)
    forecast = law.predict(trials, times=[5.0])
    np.testing.assert_array_equal(forecast.trials[0].times, [*times[2:], 5.0])
    np.testing.assert_allclose(
        forecast.trajectories[0].states[:, 0], np.exp(-0.5 * forecast.trials[0].times), rtol=1e-6
    )
    assert forecast.horizons[0].tolist() == (forecast.trials[0].times - times[2]).tolist()
