"""Bands of forecasts are as wide as forecasts of what was left out ask for, at each horizon."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

import commonlaw as cl
from commonlaw.inference.result import held_out_forecasts
from commonlaw.inference.result.held_out_forecasts import StandardizedErrors, interval_inflation
from commonlaw.law import from_json, to_json
from commonlaw.law.uncertainty import IntervalInflation
from tests.refusals import refused


def trial(ahead: np.ndarray, growth: float, seed: int) -> StandardizedErrors:
    """Return normal errors that grow with the horizon, in units of what 95 % intervals reach."""
    draws = np.random.default_rng(seed).standard_normal(len(ahead))
    return errors(ahead, abs((1 + growth * ahead) * draws / 1.96)[:, np.newaxis])


def errors(ahead: np.ndarray, sizes: np.ndarray) -> StandardizedErrors:
    return StandardizedErrors(ahead, norm.ppf(0.975) * sizes, np.ones_like(sizes), np.full_like(sizes, np.nan))


AHEAD = np.linspace(0.05, 6.0, 30)


@pytest.mark.parametrize("correlated", [False, True])
def test_twenty_trials_give_the_quantile_that_one_more_asks_for(correlated):
    """Each with thirty errors: independent ones, or the same one throughout, by whose largest bands then go."""
    inside, factors = [], []
    for seed in range(200):
        draws = np.random.default_rng(seed).standard_normal((21, 1 if correlated else 30, 1))
        sizes = np.broadcast_to(abs(draws) / 1.96 * 1.5, (21, 30, 1))
        found = interval_inflation([errors(AHEAD, size) for size in sizes[:20]])
        inside.append(np.mean(sizes[20, :, 0] <= found.at(AHEAD)))
        factors.append(found.factors.max())
    assert np.mean(inside) == pytest.approx(0.95, abs=0.03)
    assert np.median(factors) == pytest.approx(1.5 * (1.15 if correlated else 1.05), rel=0.15)


@pytest.mark.parametrize("count", [10, 100])
def test_bands_are_never_made_narrower(count):
    narrow = [replace(each, sizes=each.sizes / 3) for each in (trial(AHEAD, 0.0, seed) for seed in range(count))]
    assert {*interval_inflation(narrow).factors.tolist()} == {1.0}


def test_few_trials_lean_on_what_the_law_says_of_itself():
    wrong = errors(np.array([0.5, 0.9]), np.full((2, 1), 3.0))
    (one,) = set(interval_inflation([wrong]).factors.round(9))
    (four,) = set(interval_inflation([wrong] * 4).factors.round(9))
    assert 1.0 < one < four < 3 * 1.96
    assert four**2 == pytest.approx((2 + 4 * (3 * 1.959964) ** 2) / 6, rel=1e-6)


def test_what_was_never_forecast_widens_nothing():
    assert interval_inflation([]) is None
    assert interval_inflation([errors(np.array([]), np.empty((0, 1)))]) is None


def test_a_band_is_wider_by_the_factor_of_its_horizon(drops, law):
    wider = IntervalInflation(np.array([0.5, 1.0]), np.array([1.0, 3.0]))
    changed = replace(law, uncertainty=replace(law.uncertainty, interval_inflation=wider))
    again = from_json(to_json(changed))
    plain, found = (each.predict(drops, start=5, return_std=True) for each in (law, again))
    for i, drop in enumerate(drops):
        ahead = np.maximum(0.0, drop.times - drop.times[4])
        expected = plain.margins(measured=True)[i][:, 0] * np.interp(ahead, [0.5, 1.0], [1.0, 3.0])
        np.testing.assert_allclose(found.margins(measured=True)[i][:, 0], expected)


@pytest.mark.parametrize(
    ("horizons", "factors"), [([1.0, 0.5], [1.0, 1.0]), ([1.0], [0.0]), ([], []), ([1.0, 2.0], [1.0])]
)
def test_a_widening_that_is_none_is_refused(law, horizons, factors):
    wrong = IntervalInflation(np.array(horizons), np.array(factors))
    with refused("interval-inflation"):
        replace(law, uncertainty=replace(law.uncertainty, interval_inflation=wrong))


@pytest.fixture(scope="module")
def drops() -> cl.Trials:
    return cl.datasets.linear_drag(drag=(-0.3,), trials=2, noise=0.05)


@pytest.fixture(scope="module")
def law(drops) -> cl.Law:
    return cl.fit("x'' = -g - c v", drops)


def test_trials_that_differ_by_more_than_the_law_says_widen_the_bands_of_what_is_found():
    """A rate that changes from trial to trial is none of the law's errors; only a trial that was left out shows it."""
    generator, times = np.random.default_rng(3), np.linspace(0, 3, 20)

    def measured(scatter: float) -> cl.Trials:
        rates = 0.8 * np.exp(scatter * generator.standard_normal(5))
        states = [(np.exp(-rate * times) + 0.01 * generator.standard_normal(20))[:, np.newaxis] for rate in rates]
        return cl.Trials.from_arrays([times] * 5, states, names=["x"])

    white = cl.TrajectoryLikelihood(errors="white", noise={"x": 0.01})
    alike, different = (
        cl.discover(measured(scatter), library="poly:1", method=white, order=1) for scatter in (0.0, 0.3)
    )
    assert alike.uncertainty.interval_inflation.factors.max() < 1.5
    assert different.uncertainty.interval_inflation.factors.max() > 2


def test_the_later_half_of_a_trial_may_forecast_the_earlier_one_too():
    times = np.arange(11.0)
    trials = cl.Trials.from_arrays([times] * 2, [np.sin(times)] * 2, object=["a", "b"], names=["x"])
    forward, both = (list(held_out_forecasts._folds(trials, way)) for way in (False, True))
    assert [len(kept[0]) for kept, _ in forward] == [6, 9]
    *first, (kept, [(left_out, start)]) = both
    assert [len(kept[0]) for kept, _ in first] == [6, 9]
    assert start is None
    for whole, later, earlier in zip(trials, kept, left_out, strict=True):
        np.testing.assert_array_equal(np.concatenate([earlier.times, later.times]), whole.times)
        assert len(later) == 6
