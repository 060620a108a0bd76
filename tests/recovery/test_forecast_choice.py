"""Where a law imitates few measurements, the one is taken that forecasts best what was left out."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import wrightomega
from scipy.stats import norm

import commonlaw as cl
from commonlaw.discovery import trajectory_likelihood
from commonlaw.inference.result import held_out_forecasts
from commonlaw.inference.result.assembly import reported
from commonlaw.inference.result.held_out_forecasts import StandardizedErrors
from commonlaw.inference.search.error_models import fit_each_kind
from commonlaw.inference.search.pool import Pool

LEARNED = 9


@pytest.fixture(scope="module")
def seasonal() -> cl.Trials:
    """Growth w' = r (1 + sin(t)/2) w, of which a library without time holds no law."""
    generator, times = np.random.default_rng(0), np.linspace(0, 21, 15)
    states = list[np.ndarray]()
    for _ in range(5):
        rate, start = 0.15 * (1 + 0.15 * generator.standard_normal()), 10 * (1 + 0.1 * generator.standard_normal())
        grown = start * np.exp(rate * (times + (1 - np.cos(times)) / 2))
        states.append((grown * (1 + 0.01 * generator.standard_normal(len(times))))[:, np.newaxis])
    return cl.Trials.from_arrays([times] * 5, states, object=list("abcde"), names=["w"])


@pytest.fixture(scope="module")
def law(seasonal) -> cl.Law:
    early = seasonal.with_trials([trial.cut(LEARNED) for trial in seasonal])
    return cl.discover(early, library="poly:3", order=1)


@pytest.mark.slow
def test_candidates_of_a_law_that_forecasts_chose_are_ranked_by_their_scores_and_not_by_evidence():
    """Substrates of which the enzymes are saturated to the end: rates of their own power series have no such bend."""
    times, random = np.linspace(0, 5, 40), np.random.default_rng(3)
    states = [
        constant * wrightomega(np.log(4 / constant) + (4 - velocity * times) / constant)
        + 0.05 * random.standard_normal(40)
        for velocity, constant in ((1.0, 0.05), (1.5, 0.1))
    ]
    trials = cl.Trials.from_arrays([times] * 2, states, object=["a", "b"], names=["s"])
    law = cl.discover(trials, order=1, library="poly:3")
    table = law.comparison
    assert {*table["measure"]} == {"log score difference"}
    assert table["weight"].isna().all()
    assert table["chosen"].tolist() == [True] + [False] * (len(table) - 1)
    scores = table["score"]
    assert scores[0] == 0
    assert (scores.dropna() >= 0).all()
    assert np.isfinite(scores.dropna()).all()  # Forecasts that diverge have none
    assert law.uncertainty.inclusion_probabilities is None


@pytest.mark.slow
def test_the_law_of_growth_through_the_seasons_is_one_that_forecasts(seasonal, law):
    assert law.structure == ("w' = a w",)
    assert law.uncertainty.error_model.kind == "proportional"  # Errors of every group are among those that are tried
    forecast = law.predict(seasonal, start=LEARNED, return_std=True)
    later = [
        (trial.states[LEARNED:], trajectory.states[LEARNED:])
        for trial, trajectory in zip(seasonal, forecast.trajectories, strict=True)
    ]
    assert np.mean([(abs(found - known) < 0.5 * known).all() for known, found in later]) > 0.8
    inside = [
        ((low <= trial.states) & (trial.states <= high))[LEARNED:]
        for trial, (low, high) in zip(seasonal, forecast.bands(measured=True), strict=True)
    ]
    assert np.mean(inside) > 0.85


def errors(sizes: np.ndarray, reach: float, of_last: float = np.nan) -> StandardizedErrors:
    half, ahead = norm.ppf(0.975), np.arange(1.0, len(sizes) + 1)
    std, persistence = np.full((len(sizes), 1), reach / half), np.full((len(sizes), 1), of_last)
    return StandardizedErrors(ahead, half * sizes[:, np.newaxis], std, persistence)


def test_forecasts_are_weighed_with_bands_as_wide_as_they_should_be():
    missed = np.abs(np.random.default_rng(2).standard_normal((30, 8)))  # By far more than what 95 % reach
    own = held_out_forecasts._score([errors(each, 1.0) for each in missed])
    assert held_out_forecasts._score([errors(2 * each, 0.5) for each in missed]) == pytest.approx(own)
    assert held_out_forecasts._score([errors(each, 2.0) for each in missed]) == pytest.approx(own - 30 * np.log(2))
    assert held_out_forecasts._score([errors(each / 100, 1.0) for each in missed]) > own
    assert (
        held_out_forecasts._score([errors(each, 1.0) for each in missed] + [errors(np.full(8, np.inf), 1.0)]) == -np.inf
    )


@pytest.mark.parametrize(
    ("few", "process_noise", "diverged", "off"),
    [(True, False, 2, True), (True, False, 1, False), (False, True, 1, True), (False, False, 2, False)],
)
def test_forecasts_that_diverge_show_that_a_law_may_overfit(few, process_noise, diverged, off):
    trials = SimpleNamespace(objects=tuple("abc"))
    fit = SimpleNamespace(
        problem=SimpleNamespace(trials=trials), has_few_measurements=few, has_process_noise=process_noise
    )
    small, infinite = errors(np.full(8, 0.5), 1.0), errors(np.full(8, np.inf), 1.0)
    assert held_out_forecasts._are_forecasts_off(fit, [small] * 3) is False
    assert held_out_forecasts._are_forecasts_off(fit, [small] * (3 - diverged) + [infinite] * diverged) is off


@pytest.mark.parametrize(("of_last", "no_better"), [(0.4, True), (2.0, False), (np.nan, False)])
def test_forecasts_are_compared_with_the_last_value(of_last, no_better):
    assert held_out_forecasts._no_better_than_last([errors(np.full(8, 0.5), 1.0, of_last)] * 3) is no_better


def test_process_noise_that_took_all_terms_gives_way_to_a_law_that_forecasts():
    times, random = np.linspace(0, 12, 80), np.random.default_rng(4)
    states = np.exp(-0.1 * times) * np.cos(2 * times) + 0.02 * random.standard_normal(80)
    trials, pools = cl.Trials.from_arrays([times], [states], names=["x"]), list[Pool]()

    def recorded(pool):
        pools.append(pool)
        return reported(pool)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory_likelihood, "reported", recorded)
        cl.discover(trials, order=2, library="poly:1", cache=False)
    (pool,) = pools
    problem = pool.best.problem
    (empty,) = fit_each_kind(problem, np.zeros_like(problem.allowed), ("random-walk",))
    pool = replace(pool, fits=(empty,))
    errors = held_out_forecasts.standardized_errors(empty, lambda law: law)
    kinds = ("white", "random-walk")
    chosen, _ = held_out_forecasts.best_forecaster(pool, errors, kinds, lambda law: law, lambda _: None)
    assert empty.has_process_noise
    assert not chosen.best.has_process_noise
    assert [problem.terms.names[k] for k in np.flatnonzero(chosen.best.supports[0])] == ["x", "v"]
