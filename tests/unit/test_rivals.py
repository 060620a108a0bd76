"""Supports between which the likelihood, linearised about one of them, hardly decides."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import commonlaw as cl
from benchmarks.families import experiment
from benchmarks.next_experiment import first_trials
from commonlaw.inference.fit import annealing, fit as fits
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.result.assembly import weighted
from commonlaw.inference.score.score import Score
from commonlaw.inference.search import law_search
from commonlaw.inference.search.law_search import PATH
from commonlaw.inference.search.pool import Pool
from commonlaw.library import Variables, parse_library


def problem_of(trials):
    """The problem of a law of second order of five objects among cubic polynomials."""
    terms = parse_library("poly:3").bind(Variables(("x", "v")))
    return replace(prepare(trials, terms, np.full((5, 1, len(terms)), np.nan)), solver=PATH)


def names(fit):
    return [name for name, inside in zip(fit.problem.terms.names, fit.supports[0], strict=True) if inside]


@pytest.mark.parametrize("seed", [0, 7])
def test_supports_that_are_hardly_less_probable_are_fitted_before_one_is_chosen(seed):
    trials = experiment("heights of balls").measured(0.05, seed)
    problem = problem_of(trials)
    found = annealing.search(problem, lambda _: None)
    assert names(found[0]) == ["1", "v"]
    fitted = {each.supports.tobytes() for each in found}
    near = found[0].predicted_neighbours()
    plausible = [each for value, each in near if value < found[0].score.total + fits.PLAUSIBLE]
    assert len(plausible) > 1
    assert all(each.tobytes() in fitted for each in plausible)


def test_supports_that_were_fitted_are_listed_with_the_evidence_of_their_fits():
    trials = experiment("heights of balls").measured(0.05, 7)
    problem = problem_of(trials)
    best = annealing.search(problem, lambda _: None)[0]
    (listed,) = best.neighbours()
    np.testing.assert_array_equal(listed[0][1], best.supports[0])
    fitted = {each.supports.tobytes() for each in best.alternatives}
    (difference, support), *more = [pair for pair in listed[1:] if pair[1].tobytes() in fitted]
    assert len(more) >= 2
    again = annealing.fit_with(problem, support[np.newaxis], fits.NO_ERROR)
    assert difference == pytest.approx(again.score - best.score, abs=0.01)


@pytest.mark.parametrize("beginning", [["1"], ["1", "x", "v"]])
def test_what_ranks_ahead_of_a_law_is_fitted_and_taken(beginning):
    trials = experiment("heights of balls").measured(0.05, 7)
    problem = problem_of(trials)
    supports = np.isin(problem.terms.names, beginning)[np.newaxis]
    fit = fits.fitted(problem, annealing.fit_supports(problem, supports).estimates, supports, fits.NO_ERROR)
    best = annealing.beside_those_ahead(fit)
    assert names(best) == ["1", "v"]
    assert any(np.array_equal(each.supports, supports) for each in best.alternatives)
    assert best.score < fit.score


def test_a_law_is_reached_that_is_no_neighbour_of_those_that_the_search_comes_by():
    """Under much noise it ends at ``a x``, from which ``a + b v`` is two terms away, and one from ``a + b x``."""
    first = first_trials("heights of balls", 20)
    law = first.discover(first.measured(0.1, 20))
    assert law.structure == ("x'' = a + b v",)


def test_laws_are_as_plausible_as_fits_of_their_own_have_evidence():
    first = first_trials("heights of balls", 19)
    problem = problem_of(first.measured(0.1, 19))
    best = annealing.search(problem, lambda _: None)[0]
    (own, first_fit), *others = weighted(best)
    assert first_fit is best
    plausible = [(share, each) for share, each in others if share > 0.02]
    assert len(plausible) >= 3
    for share, each in plausible:
        again = annealing.fit_with(problem, each.supports, fits.NO_ERROR)
        assert np.log(own / share) == pytest.approx((again.score - best.score) / 2, abs=0.05)


@pytest.mark.parametrize(("noise", "seed"), [(0.05, 0), (0.02, 3)])
def test_one_short_trial_of_each_object_is_enough_for_a_law_of_two_terms(noise, seed):
    """From so little, evidence about fits of many terms has few digits, and must not be larger for it."""
    law = cl.discover(cl.datasets.linear_drag(noise=noise, seed=seed).select(trial=1), order=2, library="poly:3")
    assert law.structure == ("x'' = a + b v",)
    assert {each.kind for each in law.diagnostics} <= {"not identifiable"}  # All drops begin alike


def test_laws_that_are_the_better_ones_in_turn_are_not_fitted_without_end(monkeypatch):
    problem = SimpleNamespace(solver=PATH)
    one, other = (fits.Fit(problem, np.eye(1, 2, k, dtype=bool), (), 0.0, Score({})) for k in range(2))
    turns = []

    def in_turn(fit):
        turns.append(fit)
        assert len(turns) < 9
        return other if fit is one else one

    monkeypatch.setattr(law_search, "until_resolved", lambda fit, _: fit)
    monkeypatch.setattr(law_search, "to_scale", lambda fit: fit)
    monkeypatch.setattr(law_search, "beside_alternatives", in_turn)
    assert law_search.resolved(Pool((one,)), str).best in (one, other)
