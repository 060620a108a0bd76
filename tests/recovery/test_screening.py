"""Libraries of hundreds of terms: a few dozens are searched, and none that matters is lost."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.discovery import candidate_search
from commonlaw.inference.propose.screening import screen_terms
from commonlaw.library import Variables, parse_library

WIDE = "poly:11"
"""78 terms in x and v."""


def swings(samples=150):
    """Two pendulums that differ in their frequency, with damping in v only."""
    times, generator = np.linspace(0, 12, samples), np.random.default_rng(3)
    found = []
    for rate in (1.0, 1.4):
        turn = np.sqrt(rate**2 - 0.01)
        found.append(np.exp(-0.1 * times) * np.cos(turn * times) + 0.005 * generator.standard_normal(samples))
    return cl.Trials.from_arrays([times] * 2, found, object=["slow", "fast"])


@pytest.fixture(scope="module")
def swinging():
    return swings()


@pytest.fixture(scope="module")
def narrow(swinging):
    return cl.discover(swinging, order=2, library="poly:3")


def test_a_law_among_many_terms_is_that_among_few(swinging, narrow):
    law = cl.discover(swinging, order=2, library=WIDE)
    assert law.structure == narrow.structure == ("x'' = a x + b v",)
    for term in ("x", "v"):
        wide, few = (each.coefficients[:, 0, each.terms.index(term)] for each in (law, narrow))
        np.testing.assert_allclose(wide, few, rtol=1e-3)
    assert law.history[0].stage == "screening"
    assert law.history[0].choice.endswith("of 78 terms")


def test_a_term_that_screening_left_out_comes_back_if_it_improves_the_law(swinging, narrow, monkeypatch):
    def wrong(_, terms, *__):
        return np.array(["v" not in name for name in terms.names])

    monkeypatch.setattr(candidate_search, "screen_terms", wrong)
    law = cl.discover(swinging, order=2, library="poly:3", method=cl.TrajectoryLikelihood(errors="white"))
    assert law.structure == narrow.structure


def test_screening_keeps_terms_that_are_needed_and_terms_that_only_all_objects_together_tell(swinging):
    terms = parse_library(WIDE).bind(Variables(("x", "v")))
    needed = np.zeros(len(terms), dtype=bool)
    needed[terms.index("x^4 v^7")] = True
    kept = screen_terms(swinging, terms, np.full((2, 1, len(terms)), np.nan), needed)
    assert kept[terms.index("x")]
    assert kept[terms.index("v")]
    assert kept[terms.index("x^4 v^7")]
    assert kept.sum() < 45


def test_few_terms_are_searched_as_they_are(swinging):
    terms = parse_library("poly:3").bind(Variables(("x", "v")))
    assert screen_terms(swinging, terms, np.full((2, 1, 10), np.nan), np.zeros(10, dtype=bool)).all()
