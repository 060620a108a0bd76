"""One law and the same measurements have one score, whoever asks for it."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.discovery import trajectory_likelihood
from commonlaw.inference import finish
from commonlaw.inference.fit.state import evidence_about
from commonlaw.inference.score.score import Kind, Score
from commonlaw.inference.search.law_search import fit_terms
from commonlaw.inference.search.setup import FitSetup
from commonlaw.inference.verbs import comparison

PROBLEMS = {
    "drops": (cl.datasets.linear_drag(noise=0.05), {"order": 2, "library": "poly:3"}),
    "order and library to be found": (cl.datasets.linear_drag(noise=0.05), {}),
    "two equations": (cl.datasets.lotka_volterra(noise=0.05), {"order": 1, "library": "poly:3"}),
}


@pytest.fixture(scope="module", params=PROBLEMS.values(), ids=PROBLEMS)
def discovered(request):
    """Trials, the law that `discover` finds, and the search that it comes from."""
    trials, settings = request.param
    searches = []

    def recorded(found, **rest):
        searches.append(found)
        return finish(found, **rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory_likelihood, "finish", recorded)
        law = cl.discover(trials, cache=False, **settings)
    return trials, law, searches[-1]


def test_the_parts_add_up_to_the_evidence(discovered):
    *_, found = discovered
    evidence = evidence_about(found.problem, found.state)
    assert found.state.score.total == pytest.approx(evidence.value(found.state.supports), rel=1e-12)


def test_discover_and_fit_give_the_same_score_part_by_part(discovered):
    trials, law, found = discovered
    fitted = fit_terms(FitSetup.of(law, trials)).state.score
    assert fitted.kind is found.state.score.kind is Kind.EVIDENCE
    assert dict(fitted.parts) == pytest.approx(dict(found.state.score.parts), rel=1e-6, abs=1e-6)


def test_compare_gives_the_same_score_but_for_the_terms_that_were_left_out(discovered, monkeypatch):
    trials, law, found = discovered
    scores = []

    def fit(setup):
        fitted = fit_terms(setup)
        scores.append(dict(fitted.state.score.parts))
        return fitted

    monkeypatch.setattr(comparison, "fit_terms", fit)
    cl.compare({"law": law}, trials)
    expected = dict(found.state.score.parts)
    assert scores[0].pop("structure") < expected.pop("structure")
    assert scores[0] == pytest.approx(expected, rel=1e-6, abs=1e-6)


def test_scores_of_two_kinds_do_not_compare():
    evidence, predictive = Score({"likelihood": 3.0}), Score({"forecasts": 2.0}, Kind.FORECASTS)
    with pytest.raises(TypeError, match="does not compare"):
        min(evidence, predictive)
    with pytest.raises(TypeError, match="does not compare"):
        evidence - predictive


def test_what_is_added_to_a_part_adds_to_the_total():
    score = Score({"likelihood": 1.0}).plus("multiplicity", 2.0).plus("multiplicity", np.log(4))
    assert dict(score.parts) == {"likelihood": 1.0, "multiplicity": 2.0 + np.log(4)}
    assert score.total == pytest.approx(3 + np.log(4))
