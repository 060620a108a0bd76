"""Supports between which the likelihood, linearised about one of them, hardly decides."""

import numpy as np
import pytest

import commonlaw as cl
from benchmarks.families import experiment
from benchmarks.next_experiment import first_trials
from commonlaw.inference.fit import annealing, state as fits
from commonlaw.inference.fit.problem import prepare
from commonlaw.inference.result.averaging import weighted
from commonlaw.inference.score.score import Score
from commonlaw.inference.search import law_search
from commonlaw.inference.search.law_search import PATH
from commonlaw.library import Variables, parse_library


@pytest.mark.parametrize("seed", [0, 7])
def test_supports_that_are_hardly_less_probable_are_fitted_before_one_is_chosen(seed):
    trials = experiment("heights of balls").measured(0.05, seed)
    terms = parse_library("poly:3").bind(Variables(("x", "v")))
    problem = prepare(trials, terms, np.full((5, 1, len(terms)), np.nan))
    found = annealing.search(problem, PATH, lambda _: None)
    assert [name for name, inside in zip(terms.names, found[0].supports[0], strict=True) if inside] == ["1", "v"]
    fitted = {each.supports.tobytes() for each in found}
    near = fits.promised_near(problem, found[0])
    plausible = [each for value, each in near if value < found[0].score.total + fits.PLAUSIBLE]
    assert len(plausible) > 1
    assert all(each.tobytes() in fitted for each in plausible)


def test_supports_that_were_fitted_are_listed_with_the_evidence_of_their_fits():
    trials = experiment("heights of balls").measured(0.05, 7)
    terms = parse_library("poly:3").bind(Variables(("x", "v")))
    problem = prepare(trials, terms, np.full((5, 1, len(terms)), np.nan))
    best = annealing.search(problem, PATH, lambda _: None)[0]
    (listed,) = fits.neighbours(problem, best)
    assert listed[0].chosen
    fitted = {each.tobytes(): above for above, each in best.fitted}
    exact = [each for each in listed if each.support[np.newaxis].tobytes() in fitted and not each.chosen]
    assert len(exact) >= 3
    again = annealing.fit_with(problem, exact[0].support[np.newaxis], fits.NO_ERROR)
    assert exact[0].twice_log_bayes_factor == pytest.approx(again.score - best.score, abs=0.01)


@pytest.mark.parametrize("beginning", [["1"], ["1", "x", "v"]])
def test_what_ranks_ahead_of_a_law_is_fitted_and_taken(beginning):
    trials = experiment("heights of balls").measured(0.05, 7)
    terms = parse_library("poly:3").bind(Variables(("x", "v")))
    problem = prepare(trials, terms, np.full((5, 1, len(terms)), np.nan))
    supports = np.isin(terms.names, beginning)[np.newaxis]
    state, _ = fits.fitted(problem, annealing.fit_supports(problem, supports).estimates, supports, fits.NO_ERROR)
    best = annealing.beside_those_ahead(problem, state)
    assert [name for name, inside in zip(terms.names, best.supports[0], strict=True) if inside] == ["1", "v"]
    assert any(np.array_equal(each.supports, supports) for each in best.alternatives)
    assert best.score < state.score


def test_a_law_is_reached_that_is_no_neighbour_of_those_that_the_search_comes_by():
    """Under much noise it ends at ``a x``, from which ``a + b v`` is two terms away, and one from ``a + b x``."""
    first = first_trials("heights of balls", 20)
    law = first.discover(first.measured(0.1, 20))
    assert law.structure() == ("x'' = a + b v",)


def test_laws_are_as_plausible_as_fits_of_their_own_have_evidence():
    first = first_trials("heights of balls", 19)
    terms = parse_library("poly:3").bind(Variables(("x", "v")))
    problem = prepare(first.measured(0.1, 19), terms, np.full((5, 1, len(terms)), np.nan))
    best = annealing.search(problem, PATH, lambda _: None)[0]
    (own, state), *others = weighted(best)
    assert state is best
    plausible = [(share, each) for share, each in others if share > 0.02]
    assert len(plausible) >= 3
    for share, each in plausible:
        again = annealing.fit_with(problem, each.supports, fits.NO_ERROR)
        assert np.log(own / share) == pytest.approx((again.score - best.score) / 2, abs=0.05)


@pytest.mark.parametrize(("noise", "seed"), [(0.05, 0), (0.02, 3)])
def test_one_short_trial_of_each_object_is_enough_for_a_law_of_two_terms(noise, seed):
    """From so little, evidence about fits of many terms has few digits, and must not be larger for it."""
    law = cl.discover(cl.datasets.linear_drag(noise=noise, seed=seed).select(trial=1), order=2, library="poly:3")
    assert law.structure() == ("x'' = a + b v",)
    assert {each.kind for each in law.outcomes} <= {"not identifiable"}  # All drops begin alike


def test_laws_that_are_the_better_ones_in_turn_are_not_fitted_without_end(monkeypatch):
    one, other = (fits.SearchState(np.eye(1, 2, k, dtype=bool), (), 0.0, Score({})) for k in range(2))
    begun = law_search.LawSearch(None, None, one, law_search.PATH, (one,))
    turns = []

    def in_turn(_, state):
        turns.append(state)
        assert len(turns) < 9
        return other if state is one else one

    monkeypatch.setattr(law_search, "until_resolved", lambda problem, state, _: (problem, state))
    monkeypatch.setattr(law_search, "to_scale", lambda problem, state: (problem, state))
    monkeypatch.setattr(law_search, "beside_alternatives", in_turn)
    assert law_search.resolved(begun, str).state in (one, other)
