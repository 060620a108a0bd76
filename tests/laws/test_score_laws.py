"""One law and the same measurements have one score, whoever asks for it."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.discovery import trajectory_likelihood
from commonlaw.inference.fit.convergence import converged
from commonlaw.inference.fit.final_score import score_of_fit, score_of_order
from commonlaw.inference.result.assembly import reported
from commonlaw.inference.score.score import Kind, Score
from commonlaw.inference.search.error_models import fit_each_kind, with_error_models
from commonlaw.inference.search.law_search import fit_terms
from commonlaw.inference.search.setup import FitSetup, RefitOptions
from commonlaw.inference.verbs.comparison import written_alike
from commonlaw.likelihood import ERRORS

PROBLEMS = {
    "order and library to be found": (cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.05), {}),
    "several plausible laws": (
        cl.datasets.linear_drag(drag=(-0.1, -0.5), noise=0.3, trials=1),
        {"order": 2, "library": "poly:2"},
    ),
    "two equations": (cl.datasets.lotka_volterra(noise=0.05, trials=1), {"order": 1, "library": "poly:2"}),
}


@pytest.fixture(scope="module", params=PROBLEMS.values(), ids=PROBLEMS)
def discovered(request):
    """Trials, the law that `discover` finds, and its fit in the search and as it is reported."""
    trials, settings = request.param
    return trials, *recorded(trials, **settings)


def recorded(trials, **settings):
    pools = []

    def record(pool):
        pools.append(pool)
        done = reported(pool)
        pools.append(done[0])
        return done

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory_likelihood, "reported", record)
        law = cl.discover(trials, cache=False, **settings)
    return law, *pools


def score_of_given(law, trials):
    """Return the score of a law as `fit` and `compare` take it."""
    setup = FitSetup.of(written_alike(law, trials.schema), trials, RefitOptions())
    pool = with_error_models(fit_terms(setup), None, (law.uncertainty.error_model.kind,), lambda _: None)
    return score_of_fit(converged(pool.best)[0])


def test_the_parts_add_up_to_the_evidence(discovered):
    *_, search, _ = discovered
    assert search.best.score.total == pytest.approx(search.best.evidence.value(search.best.supports), rel=1e-12)


def test_discover_reports_the_score_of_its_equations_and_the_prior_of_its_terms(discovered):
    trials, law, _, pool = discovered
    score = pool.best.score
    assert score.kind is Kind.EVIDENCE
    again = score_of_given(cl.fit("; ".join(law.structure), trials, errors="white"), trials)
    expected = {part: value for part, value in score.parts.items() if value and part != "structure"}
    assert {part: value for part, value in again.parts.items() if value} == pytest.approx(expected, abs=0.01)
    assert score.total - again.total == pytest.approx(score.parts["structure"], abs=0.01)
    assert score.parts["structure"] > 1


def test_plausible_laws_have_the_bayes_factors_of_compare_and_those_of_their_terms(discovered):
    trials, law, _, pool = discovered
    chosen, plausible = pool.best, {fit.model.equations: fit for fit in pool.best.alternatives}
    for model in law.models[1:3]:
        alternative = plausible[tuple(tuple(np.array(law.terms.names)[row]) for row in model.law.support)]
        texts = ["; ".join(each.structure) for each in (law, model.law)]
        above = cl.compare({text: cl.fit(text, trials, errors="white") for text in texts}, trials).set_index("law")
        terms = alternative.score.parts["structure"] - chosen.score.parts["structure"]
        factor = above["2 log B"][texts[1]] - above["2 log B"][texts[0]]
        assert alternative.score - chosen.score - terms == pytest.approx(factor, abs=0.02)
        odds = law.models[0].probability / model.probability
        assert 2 * np.log(odds) == pytest.approx(alternative.score - chosen.score, abs=0.01)


def test_an_order_has_the_bayes_factor_of_the_law_that_is_printed():
    """Solutions of a law replace one with process noise, whose evidence is far larger."""
    times = np.linspace(0, 10, 80)
    noise = 0.004 * np.random.default_rng(3).standard_normal(80)
    trials = cl.Trials.from_arrays([times], [np.exp(-0.3 * times) + 0.1 * np.sin(times**1.3) + noise], names=["x"])
    law = cl.discover(trials, library="poly:1", cache=False)
    assert law.structure == ("x' = a x",)
    assert "order-not-identifiable" not in [diagnostic.code for diagnostic in law.diagnostics]


def test_the_law_that_is_printed_is_the_best_of_its_pool(discovered):
    *_, printed = discovered
    others = [fit for fit in (*printed.best.alternatives, *printed.rivals) if fit.is_solved]
    assert all(printed.best.score - fit.score < 0.1 for fit in others)


def test_a_random_walk_has_one_score_on_all_meshes():
    times, random = np.linspace(0, 6, 40), np.random.default_rng(5)
    walk = 0.02 * np.cumsum(random.standard_normal(40)) + 0.01 * random.standard_normal(40)
    trials = cl.Trials.from_arrays([times], [np.exp(-0.2 * times) * np.cos(2 * times) + walk], names=["x"])
    problem = FitSetup.of(cl.fit("x'' = -k x - c v", trials, errors="white"), trials, RefitOptions()).problem()
    scores = list[float]()
    for points in (1, 2, 4):
        (fit,) = fit_each_kind(problem.with_points(points), problem.allowed, ("random-walk",))
        scores.append(score_of_fit(fit).total)
    assert np.ptp(scores) < 1.0  # By levels, which are estimated on each mesh


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
    (white,) = fit_each_kind(fit.problem, fit.supports, kinds)  # Others without any effect are no other errors
    assert white.errors == "white"
    asked = fit_each_kind(fit.problem, fit.supports, kinds[1:])
    assert {other.errors for other in asked} - {"white"} == {*kinds} - {"white", "by-object", "by-trial"}
    for other in asked:
        near = 0.2 if other.errors == "random-walk" else 0.1  # The least walk is 0.03 noise
        assert other.score - white.score == pytest.approx(0.0, abs=near), other.errors


def test_levels_that_are_not_worth_their_cost_are_zero():
    """Of white noise the likeliest level of other errors is seldom zero, and nearly never worth log n."""
    random, times = np.random.default_rng(3), np.linspace(0, 4, 30)
    for _ in range(5):
        states = [np.exp(-rate * times) + 0.05 * random.standard_normal(30) for rate in (0.5, 0.9)]
        trials = cl.Trials.from_arrays([times] * 2, states, names=["x"], object=["a", "b"])
        setup = FitSetup.of(cl.fit("x' = -k x", trials, errors="white"), trials, RefitOptions())
        fit = fit_terms(setup).best
        white, *worthwhile = fit_each_kind(fit.problem, fit.supports, tuple(ERRORS))
        assert all(other.score < white.score for other in worthwhile)


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
