"""Trials of few samples: what may be asked of them, and what is assumed of their noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import curve_fit

import commonlaw as cl
from commonlaw import datasets
from commonlaw.inference.data.noise import estimated_noise
from commonlaw.inference.fit.annealing import rescale_noise, search
from commonlaw.inference.fit.lack_of_fit import with_heteroscedastic_noise
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.propose.few_measurements import under_proportional_noise, with_ranked_supports
from commonlaw.inference.search.law_search import PATH
from commonlaw.inference.search.pool import Pool
from commonlaw.library import PolynomialLibrary, Variables
from commonlaw.runtime.progress import silent

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


PREDATION = (("prey", "prey predator"), ("predator", "prey predator"))
YEARLY = {
    0.04: (
        "32.45 39.15 13.32 3.297 2.283 3.046 5.233 12.17 26.07 50.13 17.07 3.802 2.309",
        "4.866 17.58 39.35 27.46 14.59 8.348 4.727 3.543 4.764 14.95 38.96 29.0 16.48",
    ),
    0.1: (
        "30.1 49.53 14.71 3.202 2.256 2.911 6.017 12.22 29.03 36.07 19.56 3.819 2.494 "
        "2.833 4.941 11.44 26.2 42.51 21.32 4.822",
        "4.565 15.57 41.56 25.14 11.91 7.386 4.542 3.117 3.817 14.69 43.34 28.53 14.93 "
        "9.095 5.461 3.503 4.34 12.9 37.5 28.97",
    ),
}
"""Counts of prey and predators, simulated with relative noise."""


def predation(noise):
    """Return the search problem of the counts with this noise."""
    counts = np.array([[float(count) for count in column.split()] for column in YEARLY[noise]]).T
    trials = cl.Trials.from_arrays([np.arange(len(counts))], [counts], names=("prey", "predator"))
    terms = PolynomialLibrary(3).bind(Variables(trials.schema.states))
    problem = prepare(trials, terms, np.full((1, 2, len(terms)), np.nan))
    return replace(problem, solver=PATH)


def structure(pool):
    names = pool.best.problem.terms.names
    return tuple(tuple(names[k] for k in np.flatnonzero(support)) for support in pool.best.supports)


def test_integrals_propose_the_support_that_the_search_from_all_terms_misses_in_few_samples():
    fits = search(with_heteroscedastic_noise(predation(0.04), ("proportional",)), silent)
    pool = Pool((rescale_noise(fits[0]),), fits)
    ranked = with_ranked_supports(pool, silent)
    assert structure(ranked) == PREDATION
    assert structure(pool) != PREDATION
    assert pool.best.score - ranked.best.score > 10
    assert pool.best.lack_of_fit
    assert not ranked.best.lack_of_fit


def test_noise_that_grows_is_no_lack_of_fit_where_differences_of_few_samples_do_not_show_it():
    fits = search(predation(0.1), silent)
    pool = Pool((rescale_noise(fits[0]),), fits)
    assert pool.best.lack_of_fit
    grown = under_proportional_noise(pool, ("white", "proportional"))
    assert structure(grown) == PREDATION
    assert grown.best.errors == "proportional"
    assert not grown.best.lack_of_fit
    assert under_proportional_noise(pool, ("white",)) is pool
