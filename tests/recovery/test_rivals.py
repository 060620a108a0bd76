"""Supports between which the likelihood, linearised about one of them, hardly decides."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.families import experiment
from benchmarks.next_experiment import first_trials
from commonlaw.inference.fit import annealing, fit as fits
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.result.assembly import weighted
from commonlaw.inference.search.law_search import PATH
from commonlaw.library import Variables, parse_library


def problem_of(trials):
    """The problem of a law of second order of five objects among cubic polynomials."""
    terms = parse_library("poly:3").bind(Variables(("x", "v")))
    return replace(prepare(trials, terms, np.full((5, 1, len(terms)), np.nan)), solver=PATH)


def names(fit):
    return [name for name, inside in zip(fit.problem.terms.names, fit.supports[0], strict=True) if inside]


def test_supports_that_are_hardly_less_probable_are_fitted_before_one_is_chosen():
    trials = experiment("heights of balls").measured(0.05, 7)
    problem = problem_of(trials)
    found = annealing.search(problem, lambda _: None)
    assert names(found[0]) == ["1", "v"]
    fitted = {each.supports.tobytes() for each in found}
    near = found[0].predicted_neighbours()
    plausible = [each for value, each in near if value < found[0].score.total + fits.PLAUSIBLE]
    assert len(plausible) > 1
    assert all(each.tobytes() in fitted for each in plausible)


@pytest.mark.parametrize("beginning", [["1"], ["1", "x", "v"]])
def test_what_ranks_ahead_of_a_law_is_fitted_and_taken(beginning):
    trials = experiment("heights of balls").measured(0.05, 7)
    problem = problem_of(trials)
    supports = np.isin(problem.terms.names, beginning)[np.newaxis]
    fit = fits.fitted(problem, annealing.fit_supports(problem, supports).estimates, supports, fits.NO_MODEL_ERROR)
    best = annealing.refit_leading(fit)
    assert names(best) == ["1", "v"]
    assert any(np.array_equal(alternative.supports, supports) for alternative in best.alternatives)
    assert best.score < fit.score


@pytest.mark.slow
@pytest.mark.parametrize("seed", [20, 25])
def test_a_law_is_reached_from_those_that_noisy_data_suggest(seed):
    """From ``a x`` two terms away, with the seed 20, and from one that needs odd starts where trials start alike."""
    first = first_trials("heights of balls", seed)
    assert first.discover(first.measured(0.1, seed)).structure == ("x'' = a + b v",)


def test_laws_are_as_plausible_as_fits_of_their_own_have_evidence():
    first = first_trials("heights of balls", 19)
    problem = problem_of(first.measured(0.1, 19))
    best = annealing.search(problem, lambda _: None)[0]
    (own, first_fit), *others = weighted(best)
    assert first_fit is best
    plausible = [(share, each) for share, each in others if share > 0.02]
    assert len(plausible) >= 3
    for share, each in plausible:
        again = annealing.fit_with(problem, each.supports, fits.NO_MODEL_ERROR)
        assert np.log(own / share) == pytest.approx((again.score - best.score) / 2, abs=0.05)
