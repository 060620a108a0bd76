"""Which experiment next: proposals against closed forms, forecasts, and what then happens."""

from unittest.mock import Mock

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.experiments import suggestions
from commonlaw.experiments.search import MAX_REPEATS, Search
from commonlaw.forecast.initial_state import model_error_std
from commonlaw.forecast.population import with_objects_of
from commonlaw.integration import Inputs
from commonlaw.likelihood import ErrorModel
from tests.known_laws import NOISE, falling, known, said
from tests.refusals import refused


def test_gravity_is_best_measured_at_ends_and_middle():
    """Height is a parabola of time, whose curvature is told best at both ends and in between, once to twice to once."""
    designs = {
        "closed form": (0.0, 0.999, 1.001, 2.0),
        "even": (0.0, 0.667, 1.333, 2.0),
        "ends": (0.0, 0.001, 1.999, 2.0),
        "start": (0.0, 0.5, 1.0, 2.0),
    }
    found = cl.design(falling(), {"x": 10, "v": 0, "times": list(designs.values())}, about="g")
    assert found.experiments[0].experiment.settings["times"] == designs["closed form"]
    # With weights 1/4, 1/2, 1/4 over 4 samples the variance of the curvature, -g/2, is that of x(0) - 2 x(1) + x(2)
    variance = 4 * (NOISE**2 * (1 + 4 / 2 + 1)) / 4
    assert found.experiments[0].std == pytest.approx((1 + 1 / variance) ** -0.5, rel=1e-3)


def test_information_is_that_of_least_squares():
    times = np.linspace(0, 3, 7)
    found = cl.design(falling(), {"x": 10, "v": 0, "times": [times]}, about="coefficients")
    columns = np.column_stack([times**2 / 2, np.ones(7), times]) / NOISE
    information = 1 / np.linalg.inv(columns.T @ columns)[0, 0]
    assert found.experiments[0].bits == pytest.approx(np.log2(1 + information) / 2, rel=1e-6)


def test_slopes_of_a_straight_line_are_told_by_its_far_end():
    """x' = a from a free start: two thirds of a duration away tell less than its end (D-optimality)."""
    law = known("x' = a", {"a": 1.0}, [[1.0]])
    found = cl.design(law, {"x": 0, "times": [[0, 1.0], [0, 2.0], [0, 3.0]]}, about="coefficients")
    assert found.experiments[0].experiment.times.tolist() == [0.0, 3.0]
    assert found.experiments[0].bits == pytest.approx(np.log2(1 + 9 / (2 * NOISE**2)) / 2)


def test_what_is_said_of_measurements_agrees_with_forecasts():
    law = cl.fit("x'' = -g - c v", cl.datasets.linear_drag(noise=0.05), partial_pooling=False)
    settings = {"x": 40.0, "v": -1.0, "duration": 2.0, "samples": 9.0, "object": "Ball 3"}
    found = said(law, settings)
    forecast = cl.forecast.forecast_from(law, "Ball 3", np.linspace(0, 2, 9), np.array([40.0, -1.0]))
    np.testing.assert_allclose(found.mean, forecast.trajectories[0].states[:, 0], rtol=1e-6)
    assert forecast.std is not None
    np.testing.assert_allclose(np.linalg.norm(found.by_unknowns, axis=1), forecast.std[0][:, 0], rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(found.noise, np.asarray(law.uncertainty.noise) ** 2 * np.ones(9))
    assert found.coloured is None


@pytest.mark.parametrize(
    "errors",
    [ErrorModel(walk=np.array([0.1, 0.2])), ErrorModel(force=np.array([0.5]), force_time=0.7)],
    ids=["walk", "force"],
)
def test_errors_of_the_law_add_up_as_in_forecasts(errors):
    law = known("x'' = -g - c v", {"g": 9.8, "c": 0.3}, np.zeros((2, 2)), errors=errors)
    times = np.linspace(0, 2, 61)
    found = said(law, {"x": 40.0, "v": 0.0, "times": tuple(times), "object": "ball"})
    trial = cl.Trial("ball", "1", times, np.full((61, 1), 1.0))
    states = law.simulate(times, [40.0, 0.0])["ball"].states
    wanted = model_error_std(law, trial, Inputs.of(times, np.empty((61, 0))), states)[:, 0]
    np.testing.assert_allclose(np.sqrt(np.diag(found.coloured))[10:], wanted[10:], rtol=0.05)


def test_a_law_has_no_bands_from_where_it_has_no_derivatives():
    law = known("x' = -a sqrt(x)", {"a": 1.0}, [[0.0]], errors=ErrorModel(walk=np.array([0.1])))
    times, states = np.arange(4.0), np.array([[1.0], [0.25], [0.0], [0.25]])
    trial = cl.Trial("ball", "1", times, states)
    found = model_error_std(law, trial, Inputs.of(times, np.empty((4, 0))), states)[:, 0]
    assert np.isfinite(found[:2]).all()
    assert np.isinf(found[3])


def test_repeats_reach_what_they_promise():
    laws = [falling(1e-3), known("x'' = -g - c v", {"g": 9.8, "c": 0.1}, np.diag([1e-6, 0.0]))]
    vary = {"x": 10, "v": 0, "duration": 1, "rate": 10}
    found = cl.design(laws, vary)
    assert found.repeats is not None
    assert found.repeats > 1
    often = cl.design(laws, {**vary, "repeats": found.repeats})
    assert often.chance == pytest.approx(0.95, abs=0.02)
    assert cl.design(laws, {**vary, "repeats": found.repeats // 2}).chance < 0.95


def test_laws_that_imitate_each_other_are_not_told_apart():
    laws = [known(text, {"a": 1.0}, [[1.0]], inputs=("u",)) for text in ("x' = a", "x' = a u")]
    vary = {"x": 0, "duration": "1..4", "rate": 10, "u": 1}
    found = cl.design(laws, vary)
    assert not found.tells_apart
    assert "No experiment in these ranges discriminates between these laws" in str(found)
    found = cl.design(laws, {**vary, "u.shape": ["constant", "ramp"]})
    assert found.tells_apart
    assert found.experiments[0].experiment.settings["u.shape"] == "ramp"


def test_the_chance_is_what_happens():
    """Measurements made by either law, and the more probable one by least squares in closed form."""
    random, times = np.random.default_rng(5), np.linspace(0, 1, 11)
    laws = [known("x' = a", {"a": 1.0}, [[0.04]]), known("x' = a x", {"a": 1.0}, [[0.09]])]
    found = cl.design(laws, {"x": 1, "times": [times]})
    columns = [times, times * np.exp(times)], [np.ones(11), np.exp(times)], [1 + times, np.exp(times)]
    covariances = [
        NOISE**2 * np.eye(11) + variance * np.outer(own, own) + 1e4 * np.outer(start, start)
        for own, start, variance in zip(*columns[:2], (0.04, 0.09), strict=True)
    ]
    right, draws = 0, 4000
    for i in range(2):
        error = np.sqrt((0.04, 0.09)[i]) * random.normal(size=(draws, 1))
        made = columns[2][i] + error * columns[0][i] + NOISE * random.normal(size=(draws, 11))
        logs = []
        for mean, covariance in zip(columns[2], covariances, strict=True):
            off = made - mean
            squares = np.einsum("dn,nm,dm->d", off, np.linalg.inv(covariance), off)
            logs.append(-(squares + np.linalg.slogdet(covariance)[1]) / 2)
        right += int(np.sum(np.argmax(logs, axis=0) == i))
    assert found.chance == pytest.approx(right / (2 * draws), abs=0.025)


def test_the_chance_is_what_happens_far_from_lines():
    """Growth at a rate that is hardly known, or by a constant: against marginal likelihoods by quadrature."""
    random, times = np.random.default_rng(7), np.linspace(0, 2, 5)
    laws = [known("x' = a x", {"a": 0.5}, [[0.36]]), known("x' = a", {"a": 1.0}, [[1.0]])]
    found = cl.design(laws, {"x": 1, "times": [times]})
    unknowns = np.linspace(-5, 5, 201)[:, np.newaxis, np.newaxis]
    starts, weights = np.linspace(-1, 3, 201)[:, np.newaxis], np.exp(-(unknowns[..., 0] ** 2) / 2)
    curves = [starts * np.exp((0.5 + 0.6 * unknowns) * times), starts + (1 + unknowns) * times]
    chances = []
    for unknown, i in zip(random.normal(size=400), np.arange(400) % 2, strict=True):
        clean = np.exp((0.5 + 0.6 * unknown) * times) if i == 0 else 1 + (1 + unknown) * times
        made = clean + NOISE * random.normal(size=5)
        densities = [np.sum(weights * np.exp(-np.sum((made - own) ** 2, axis=2) / (2 * NOISE**2))) for own in curves]
        chances.append(max(densities) / sum(densities))
    assert found.chance == pytest.approx(np.mean(chances), abs=0.025)


def test_a_later_experiment_is_chosen_given_the_first():
    """With one coefficient each, two objects are measured in turn."""
    law = known("x' = a", {"a": 1.0}, [[1.0]], objects=("one", "two"))
    found = cl.design(law, {"x": 0, "duration": 1, "rate": 10}, experiments=2)
    assert {each.experiment.settings["object"] for each in found.experiments} == {"one", "two"}


def test_several_experiments_are_the_best_together():
    """Rates tell a cubic best at both ends and at 1/sqrt(5); one by one, the third would be in the middle."""
    law = known("x' = a + b u + c u^2 + d u^3", dict.fromkeys("abcd", 1.0), np.eye(4), inputs=("u",))
    levels = [-1, -0.75, -(5**-0.5), -0.25, 0, 0.25, 5**-0.5, 0.75, 1]
    found = cl.design(law, {"x": 0, "times": [0, 1], "u": levels}, experiments=4)
    chosen = np.array([each.experiment.settings["u"] for each in found.experiments])
    np.testing.assert_allclose(np.sort(chosen), [-1, -(5**-0.5), 5**-0.5, 1])
    columns = np.vander(chosen, 4) / (np.sqrt(2) * NOISE)
    assert found.experiments[-1].bits == pytest.approx(
        np.linalg.slogdet(np.eye(4) + columns.T @ columns)[1] / 2 / np.log(2)
    )


def test_prices_decide_and_the_budget_holds():
    law = known("x' = a", {"a": 1.0}, [[1.0]], objects=("one", "two"))
    vary = {"x": 0, "duration": 1, "rate": 10}
    found = cl.design(law, vary, cost={"trial": 1, "one": 5}, experiments=5, budget=3)
    assert [each.experiment.objects for each in found.experiments] == [("two",)] * 3
    assert found.cost == 3
    with refused("design-too-expensive", budget=0.5, cheapest=1.0):
        cl.design(law, vary, budget=0.5)


def test_each_object_makes_a_trial():
    law = known("x' = a", {"a": 1.0}, [[1.0]], objects=("one", "two"))
    vary = {"x": 0, "duration": 1, "rate": 10}
    both = cl.design(law, {**vary, "object": "each"})
    alone = cl.design(law, {**vary, "object": "one"})
    assert both.experiments[0].experiment.objects == ("one", "two")
    assert both.cost == 2 * alone.cost
    assert both.experiments[0].bits == pytest.approx(2 * alone.experiments[0].bits)


def test_a_trial_ends_where_it_leaves_its_limits():
    found = cl.design(falling(), {"x": 20, "v": 0, "duration": 4, "rate": 20}, within={"x": "0..100"})
    ended = found.experiments[0].experiment.times[-1]
    assert found.to_frame().loc[0, "duration"] == ended
    assert ended == pytest.approx(np.sqrt(2 * 20 / 9.8), abs=0.1)


def test_a_forecast_is_asked_for():
    law = known("x'' = -g", {"g": 9.8}, [[0.01]])
    times = np.linspace(0, 1, 21)
    found = cl.design(law, {"x": 10, "v": 0, "times": [times]}, about="x at t=10 from 100, 0")
    assert found.aim.quantity is not None
    assert found.aim.quantity.values[0] == pytest.approx(100 - 9.8 * 50)
    assert found.aim.quantity.std(np.ones(1)) == pytest.approx(0.1 * 50)
    columns = np.column_stack([times**2 / 2, np.ones(21), times]) / NOISE
    information = 1 / np.linalg.inv(columns.T @ columns)[0, 0]
    assert found.experiments[0].std == pytest.approx(50 / np.sqrt(100 + information), rel=1e-5)


def test_new_objects_have_coefficients_by_their_properties():
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.3, -0.5), noise=0.3, trials=1)
    masses = {name: {"mass": mass} for name, mass in zip(drops.objects, [0.3, 0.1, 0.06], strict=True)}
    laws = [cl.fit(text, drops).explain(masses) for text in ("x'' = -g - c v", "x'' = -g + b v^2")]
    vary = {"x": 40, "v": 0, "duration": 2, "samples": 9, "object.mass": 0.2}
    (found,) = cl.design(laws, vary).experiments
    assert "a new object with mass = 0.2" in found.text
    trial = cl.Trial("new", "1", [0.0], [[40.0]])
    wanted, _ = with_objects_of(laws[0], cl.Trials((trial,), drops.schema, {"new": {"mass": 0.2}}))
    states = wanted.simulate(np.linspace(0, 2, 9), [40.0, 0.0], sensitivities=True)["new"]
    np.testing.assert_allclose(found.forecasts.means[0, :, 0], states.states[:, 0], rtol=1e-4)
    slopes, covariance = states.sensitivities[:, 0, :-2], wanted.uncertainty.covariance[0]
    variances = np.einsum("ni,ij,nj->n", slopes, covariance, slopes) + laws[0].uncertainty.noise[0] ** 2
    np.testing.assert_allclose(found.forecasts.std[0, :, 0], np.sqrt(variances), rtol=1e-3)
    varied = cl.design(laws, {**vary, "object.mass": "0.03..0.5"})
    assert varied.chance >= cl.design(laws, vary).chance
    with refused("setting-not-a-property"):
        cl.design(laws[0], {**vary, "object.colour": "0..1"})


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        ({"x": "5..60"}, Diagnostic("setting-missing", {"settings": "v=0..1, duration=1..5, rate=10..100"})),
        ({"x": "5..60", "w": 1}, Diagnostic("unknown-name", {"kind": "setting of an experiment", "name": "w"})),
        ({"x": "60..5"}, "setting-range"),
        ({"x": "high"}, Diagnostic("setting-syntax", {"name": "x", "value": "high"})),
        (
            {"x": 1, "v": 0, "duration": -1, "rate": 5},
            Diagnostic("setting-too-small", {"name": "duration", "value": -1.0, "least": 0.0}),
        ),
        (
            {"x": 1, "v": 0, "duration": 1, "rate": 5, "object": "cube"},
            Diagnostic("unknown-name", {"kind": "object of this law", "name": "cube"}),
        ),
    ],
)
def test_settings_that_cannot_be_are_refused(vary, message):
    with refused(message):
        cl.design(falling(), vary)


def test_laws_that_know_no_errors_are_refused():
    law = cl.Law.from_text("x'' = -g", {"g": 9.8})
    with refused("uncertainty-unknown"):
        cl.design(law, {"x": 1, "v": 0, "duration": 1, "rate": 5})


def test_settings_are_those_of_trials_by_default():
    drops = cl.datasets.linear_drag(noise=0.05)
    law = cl.fit("x'' = -g - c v", drops)
    found = cl.design(law, {"object": "Ball 3"}, trials=drops, about="c of Ball 3")
    assert len(found.experiments[0].experiment.times) == 49
    assert 40 < found.experiments[0].experiment.start[0] < 50


def test_a_design_shows_itself_in_a_notebook():
    shown = cl.design(falling(), {"x": 10, "v": 0, "duration": 1, "rate": 10})._repr_html_()
    assert "Next experiment" in shown
    assert "bits" in shown


def test_what_to_measure_next_is_suggested_within_what_was_visited():
    drops = cl.datasets.linear_drag(noise=0.5)
    law = cl.fit("x'' = -g - c v", drops)
    found = suggestions(law, drops, most=2)
    assert [each.purpose for each in found] == [
        "To know all coefficients better",
        "To know c of Ball 1 better, the coefficient that is known worst",
    ]
    low, high = law.provenance.domain.visited["x"]
    for each in found:
        assert len(each.design.experiments) == 2
        assert all(low <= own.experiment.start[0] <= high for own in each.design.experiments)
    assert suggestions(cl.Law.from_text("x'' = -g", {"g": dict.fromkeys(drops.objects, 9.8)}), drops) == ()


@pytest.mark.parametrize("enough", [1, 2, 63, 80, 100, 101])
def test_repeats_are_as_few_as_settle_the_law(enough):
    search = Mock(chance=lambda made, _: float(made[0] >= enough))
    once = Mock(repeated=lambda times: times)
    assert Search.repeats(search, [once]) == (enough if enough <= MAX_REPEATS else None)
