"""Supports between which the likelihood, linearised about one of them, hardly decides."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from benchmarks.families import experiment
from commonlaw.inference import search, search_state
from commonlaw.inference.law_search import PATH
from commonlaw.inference.search_problem import prepare
from commonlaw.library import Variables, parse_library


@pytest.mark.parametrize("seed", [0, 7])
def test_supports_that_are_hardly_less_probable_are_fitted_before_one_is_chosen(seed):
    trials = experiment("heights of balls").measured(0.05, seed)
    terms = parse_library("poly:3").bind(Variables(("x", "v")))
    problem = prepare(trials, terms, np.full((5, 1, len(terms)), np.nan))
    found = search.search(problem, PATH, lambda _: None)
    assert [name for name, inside in zip(terms.names, found[0].supports[0], strict=True) if inside] == ["1", "v"]
    fitted = {each.supports.tobytes() for each in found}
    linearised = replace(found[0], alternatives=())
    assert all(each.tobytes() in fitted for each in search_state.nearest(problem, linearised, below=6.0))


def test_supports_that_were_fitted_are_listed_with_the_evidence_of_their_fits():
    trials = experiment("heights of balls").measured(0.05, 7)
    terms = parse_library("poly:3").bind(Variables(("x", "v")))
    problem = prepare(trials, terms, np.full((5, 1, len(terms)), np.nan))
    best = search.search(problem, PATH, lambda _: None)[0]
    (listed,) = search_state.neighbours(problem, best)
    assert listed[0].chosen
    fitted = {each.tobytes(): above for above, each in best.fitted}
    exact = [each for each in listed if each.support[np.newaxis].tobytes() in fitted and not each.chosen]
    assert len(exact) >= 3
    again = search.fit_with(problem, exact[0].support[np.newaxis], search_state.NO_ERROR)
    assert exact[0].twice_log_bayes_factor == pytest.approx(again.value - best.value, abs=0.01)


@pytest.mark.parametrize(("noise", "seed"), [(0.05, 0), (0.02, 3)])
def test_one_short_trial_of_each_object_is_enough_for_a_law_of_two_terms(noise, seed):
    """From so little, evidence about fits of many terms has few digits, and must not be larger for it."""
    law = cl.discover(cl.datasets.linear_drag(noise=noise, seed=seed).select(trial=1), order=2)
    assert law.structure() == ("x'' = a + b v",)
    assert {each.kind for each in law.outcomes} <= {"not identifiable"}  # All drops begin alike
