"""Fits have a status and an order, models tell them apart, and a pool begins with the best of them."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.inference.fit.annealing import fit_solutions
from commonlaw.inference.fit.fit import NO_MODEL_ERROR, Fit, Status, best_fit, fitted
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.score.score import Kind, Score
from commonlaw.inference.search.pool import Pool
from commonlaw.library import PolynomialLibrary, Variables
from tests.refusals import refused

TIMES = np.linspace(0, 4, 41)


@pytest.fixture(scope="module")
def problem():
    noise = 0.01 * np.random.default_rng(1).standard_normal((2, TIMES.size))
    states = [np.exp(-rate * TIMES) + own for rate, own in zip((0.8, 1.1), noise, strict=True)]
    trials = cl.Trials.from_arrays([TIMES] * 2, states, names=["x"], object=["a", "b"])
    terms = PolynomialLibrary(2).bind(Variables(("x",)))
    return prepare(trials, terms, np.full((2, 1, len(terms)), np.nan))


def supports_of(problem, *names):
    return np.array([[name in names for name in problem.terms.names]])


@pytest.fixture(scope="module")
def fits(problem):
    return [fit_solutions(problem, supports_of(problem, *names)) for names in (["1"], ["x"], ["1", "x"])]


def failed(problem):
    return Fit.failed(problem, supports_of(problem, "x^2"), Status.HAS_POLE)


def test_the_best_fit_is_that_of_largest_evidence(problem, fits):
    best = best_fit([failed(problem), *fits])
    assert best is fits[1]
    assert sorted([*fits, failed(problem)])[-1].status is Status.HAS_POLE


def test_a_failed_fit_is_worse_than_any_other_and_alone_refused(problem, fits):
    lost = failed(problem)
    assert not lost.is_usable
    assert np.isinf(lost.score.total)
    assert max(fits) < lost
    for none in ([], [lost]):
        with refused("no-law-near-measurements"):
            best_fit(none)
    with refused("no-law-near-measurements"):
        Pool((lost,))


def test_what_cannot_be_computed_has_a_status(problem):
    endless = [replace(start, coefficients=np.full_like(start.coefficients, np.nan)) for start in problem.starts]
    supports = supports_of(problem, "x")
    assert fitted(problem, endless, supports, NO_MODEL_ERROR).status is Status.NOT_COMPUTABLE
    assert fitted(problem, None, supports, NO_MODEL_ERROR).status is Status.NOT_COMPUTABLE
    assert failed(problem).refitted(supports).status is Status.HAS_POLE


def test_coefficients_outside_of_a_support_are_zero_wherever_a_fit_begins(problem, fits):
    everywhere = [replace(start, coefficients=np.full_like(start.coefficients, -1.0)) for start in problem.starts]
    fit = fitted(problem, everywhere, supports_of(problem, "x"), NO_MODEL_ERROR)
    for estimate, expected in zip(fit.estimates, fits[1].estimates, strict=True):
        np.testing.assert_allclose(estimate.coefficients, expected.coefficients, atol=1e-3)


def test_a_score_at_estimates_is_that_of_their_residuals_and_at_the_optimum_that_of_the_linearization(fits):
    best = fits[1]
    assert best.score_at_estimates.total == pytest.approx(best.score.total, abs=0.01)
    moved = [
        replace(estimate, coefficients=np.add(estimate.coefficients, [[0.0, 0.05, 0.0]])) for estimate in best.estimates
    ]
    away = replace(best, estimates=tuple(moved))
    score, noise_scale = away.score_at_estimates, away.evidence.noise_scale
    least, count = away.evidence.squares(away.supports), away.size * len(moved)
    expected = noise_scale.deviance(least + away.predicted_decrease, count) - noise_scale.deviance(least, count)
    assert score - away.score == pytest.approx(expected)
    assert expected > 1.0


def test_fits_of_one_model_are_of_equal_models(problem, fits):
    one, other, third = fits
    assert one.model != other.model != third.model
    again = fit_solutions(problem.with_scaled_noise(2.0, "for this test"), other.supports)
    assert again.model == other.model
    assert hash(again.model) == hash(other.model)
    assert other.model.equations == (("x",),)
    assert other.model.errors == "white"


def test_a_pool_begins_with_the_best_and_keeps_the_rest_in_order(fits):
    pool = Pool.of(fits)
    assert pool.best is fits[1]
    assert [pool.best, *pool.rivals] == sorted(fits)
    assert Pool.of(fits[:1]).joined(*fits[1:]).best is fits[1]


def test_scores_of_another_kind_are_not_compared(fits):
    forecast = fits[0].with_score(Score({"forecasts": 1.0}, Kind.FORECASTS))
    with pytest.raises(TypeError):
        Pool.of([forecast, fits[1]])
