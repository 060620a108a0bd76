"""One law and the same measurements have one score, whoever asks for it."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.discovery import trajectory_likelihood
from commonlaw.inference.fit.convergence import converged
from commonlaw.inference.fit.final_score import score_of_fit, score_of_order
from commonlaw.inference.result.assembly import assemble
from commonlaw.inference.score.score import Kind, Score
from commonlaw.inference.search.error_models import fit_each_kind
from commonlaw.inference.search.law_search import fit_terms
from commonlaw.inference.search.setup import FitSetup, RefitOptions
from commonlaw.inference.verbs import comparison
from commonlaw.likelihood import ERRORS

PROBLEMS = {
    "order and library to be found": (cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05), {}),
    "two equations": (cl.datasets.lotka_volterra(noise=0.05, trials=1), {"order": 1, "library": "poly:2"}),
}


@pytest.fixture(scope="module", params=PROBLEMS.values(), ids=PROBLEMS)
def discovered(request):
    """Trials, the law that `discover` finds, and the fit that it comes from."""
    trials, settings = request.param
    pools = []

    def recorded(pool, **rest):
        pools.append(pool)
        return assemble(pool, **rest)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory_likelihood, "assemble", recorded)
        law = cl.discover(trials, cache=False, **settings)
    return trials, law, pools[-1].best


def test_the_parts_add_up_to_the_evidence(discovered):
    *_, fit = discovered
    assert fit.score.total == pytest.approx(fit.evidence.value(fit.supports), rel=1e-12)


def test_discover_and_fit_give_the_same_score_part_by_part(discovered):
    trials, law, fit = discovered
    again = fit_terms(FitSetup.of(law, trials, RefitOptions())).best
    assert again.score.kind is fit.score.kind is Kind.EVIDENCE
    assert dict(again.score.parts) == pytest.approx(dict(fit.score.parts), rel=1e-6, abs=1e-6)
    assert again.model == fit.model


def test_compare_gives_the_same_score_but_for_the_terms_that_were_left_out(discovered, monkeypatch):
    trials, law, fit = discovered
    scores = []

    def fitted(setup):
        pool = fit_terms(setup)
        scores.append(dict(pool.best.score.parts))
        return pool

    monkeypatch.setattr(comparison, "fit_terms", fitted)
    cl.compare({"law": law}, trials)
    expected = dict(fit.score.parts)
    assert scores[0].pop("structure") < expected.pop("structure")
    # Coefficients scatter in the order of their names, whichever way a law is written
    assert scores[0].pop("scatter") == pytest.approx(expected.pop("scatter"), abs=0.5)
    assert scores[0] == pytest.approx(expected, rel=1e-6, abs=1e-6)


def _alternating(values):
    """Return values with errors that change their sign from sample to sample, and are largest where these are small."""
    signs = (-1.0) ** np.arange(len(values))[:, np.newaxis]
    return values + 0.02 * values.max() * signs / (1 + values / values.max()) * (values != 0)


def _decays():
    times = np.linspace(0, 4, 30)
    states = [_alternating(4 * np.exp(-rate * times)[:, np.newaxis]) for rate in (0.5, 0.9)]
    trials = cl.Trials.from_arrays([times] * 2, states, names=["x"], object=["a", "b"])
    return "x' = -k x", trials


def _cultures():
    """Two competing species, one of which is absent in each of two trials."""
    times, text = np.linspace(0, 9, 20), "x' = r x - s x^2 - a x y; y' = q y - u y^2 - b x y"
    law = cl.Law.from_text("x' = x - 0.01 x^2 - 0.012 x y; y' = 0.8 y - 0.01 y^2 - 0.008 x y")
    starts = ([5, 5], [5, 0], [0, 5])
    states = [_alternating(law.simulate(times, start)["object"].states) for start in starts]
    return text, cl.Trials.from_arrays([times] * 3, states, names=["x", "y"], object="culture")


@pytest.mark.parametrize(
    ("table", "kinds"), [(_decays, tuple(ERRORS)), (_cultures, ("white", "proportional", "random-walk"))]
)
def test_errors_of_size_zero_leave_the_score(table, kinds):
    text, trials = table()
    fit = fit_terms(FitSetup.of(cl.fit(text, trials, errors="white"), trials, RefitOptions())).best
    white, *others = fit_each_kind(fit.problem, fit.supports, kinds)
    assert {other.errors for other in others} == {*kinds} - {"white"}
    for other in others:
        assert other.score - white.score == pytest.approx(0.0, abs=0.2), other.errors  # The least walk is 0.03 noise


def test_the_score_of_a_search_is_that_of_solutions_where_a_state_is_absent():
    text, trials = _cultures()
    fit, _ = converged(fit_terms(FitSetup.of(cl.fit(text, trials, errors="white"), trials, RefitOptions())).best)
    linearized = score_of_order(replace(fit, score=fit.evidence.score(fit.supports)))
    assert score_of_fit(fit) - linearized.plus("structure", -linearized.parts["structure"]) == pytest.approx(
        0, abs=0.02
    )


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
