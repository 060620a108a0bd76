"""Candidates as laws: fitted to the trials, from few terms to many, the chosen one among them as it is."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.inference import candidate_law, candidate_laws
from commonlaw.law import Alternative, Provenance
from tests.refusals import refused


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(drag=(-0.1, -0.5), trials=1, noise=0.05)


@pytest.fixture(scope="module")
def law(drops):
    return cl.discover(drops, order=2, library="poly:1")


def test_candidates_go_from_few_terms_to_many_and_the_chosen_law_is_as_it_was(law, drops):
    found = candidate_laws(law, drops, most=3)
    assert [each.size for each in found] == [1, 2, 3]
    assert [each.law is law for each in found] == [each.chosen for each in found] == [False, True, False]
    assert found[0].evidence > 100
    assert [each.evidence == 0 for each in found] == [False, True, False]


def test_other_candidates_have_the_coefficients_that_a_fit_of_them_gives(law, drops):
    larger = candidate_laws(law, drops)[-1].law
    noise = dict(zip(law.schema.states, law.uncertainty.noise, strict=True))
    fitted = cl.fit("x'' = a + b x + c v", drops, noise=noise, errors="white")
    np.testing.assert_allclose(
        larger.coefficients[:, larger.support], fitted.coefficients[:, fitted.support], rtol=1e-4
    )


def test_a_law_of_other_terms_is_that_candidate_or_says_what_is_missing(law, drops):
    larger = candidate_laws(law, drops)[-1]
    again = candidate_law(law, drops, larger.law.support)
    assert np.array_equal(again.law.coefficients, larger.law.coefficients)
    assert again.evidence == larger.evidence
    with refused("law-without-terms"):
        candidate_law(law, drops, law.support & False)


def test_candidates_have_errors_of_the_kind_that_the_law_has(drops):
    law = cl.fit("x'' = a + b v", drops, errors="proportional")
    other = candidate_law(law, drops, np.isin(law.terms.names, ["1"])[None]).law
    share, larger = (each.uncertainty.error_model.heteroscedastic["proportional"] for each in (law, other))
    assert (larger > share).all()
    assert other.predict(drops, return_std=True).std is not None


def test_equations_of_several_states_grow_one_after_the_other():
    times = np.linspace(0, 4, 25)
    truth = cl.Law.from_text("x' = -x; y' = -2 y")
    trials = cl.Trials.from_arrays(times, truth.simulate(times, [1, 1])["object"].states, names=["x", "y"])
    law = cl.fit("x' = -a x; y' = -b y", trials)
    kept = [("x'", ("x",), 0.0, True), ("y'", (), 90.0, False), ("x'", (), 80.0, False), ("y'", ("y",), 0.0, True)]
    candidates = tuple(Alternative(left, terms, {"2 log B": far}, True, chosen) for left, terms, far, chosen in kept)
    law = replace(law, provenance=Provenance(alternatives=candidates))
    found = candidate_laws(law, trials)
    forms = [("x' = a x", "y' = 0"), ("x' = 0", "y' = a y"), ("x' = a x", "y' = b y")]
    assert [each.law.structure for each in found] == forms
    assert [(each.evidence, each.chosen) for each in found] == [(90, False), (80, False), (0, True)]
    assert [each.law.structure for each in candidate_laws(law, trials, most=2)] == forms[1:]


def test_a_law_in_discrete_time_stands_alone(drops):
    law = cl.discover(drops, order=0, library="poly:1")
    assert [each.law for each in candidate_laws(law, drops)] == [law]
