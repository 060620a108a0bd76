"""Which experiment next: proposals against closed forms, forecasts, and what then happens."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.experiments import suggestions
from commonlaw.experiments.experiment import Experiment
from commonlaw.experiments.predictive import Hypothesis
from commonlaw.forecast.model_error import model_error_std
from commonlaw.integration import Inputs
from commonlaw.law.population import with_objects_of
from commonlaw.library import Terms, Variables
from commonlaw.likelihood import ErrorModel

NOISE = 0.1


def known(equation, values, covariance, noise=NOISE, objects=("ball",), errors=None, inputs=()):
    """Return a law with these values of its coefficients, for every object, and their covariance."""
    law = cl.Law.from_text(
        equation, {name: dict.fromkeys(objects, value) for name, value in values.items()}, inputs=inputs
    )
    own = np.tile(np.asarray(covariance, dtype=float), (len(objects), 1, 1))
    uncertainty = cl.Uncertainty(own, noise=np.full(len(law.states), noise), error_model=errors or ErrorModel())
    return cl.Law(law.terms, law.schema, law.order, law.objects, law.coefficients, uncertainty, law.provenance)


def falling(error=1.0):
    return known("x'' = -g", {"g": 9.8}, [[error**2]])


def said(law, settings):
    """Return what a law says of one experiment."""
    hypothesis = Hypothesis.of(law, law.objects)
    ((found,),) = hypothesis.says([Experiment.of(law, law.objects, settings, {})])
    return found


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
    np.testing.assert_allclose(found.noise, np.asarray(law.noise) ** 2 * np.ones(9))
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
    assert "No experiment in these ranges tells these laws apart" in str(found)
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
    with pytest.raises(cl.CommonlawError, match=r"no experiment costs 0\.5 or less, the cheapest 1"):
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
    variances = np.einsum("ni,ij,nj->n", slopes, covariance, slopes) + laws[0].noise[0] ** 2
    np.testing.assert_allclose(found.forecasts.std[0, :, 0], np.sqrt(variances), rtol=1e-3)
    varied = cl.design(laws, {**vary, "object.mass": "0.03..0.5"})
    assert varied.chance >= cl.design(laws, vary).chance
    with pytest.raises(cl.CommonlawError, match="decides no coefficient"):
        cl.design(laws[0], {**vary, "object.colour": "0..1"})


@pytest.mark.parametrize(
    ("vary", "message"),
    [
        ({"x": "5..60"}, "say with vary what can be set, for instance v=0..1, duration=1..5, rate=10..100"),
        ({"x": "5..60", "w": 1}, "unknown setting of an experiment 'w'"),
        ({"x": "60..5"}, "give two numbers, the smaller one first"),
        ({"x": "high"}, "x is 'high': give a number, a range such as 5..60, or a list"),
        ({"x": 1, "v": 0, "duration": -1, "rate": 5}, "duration is -1: give numbers above 0"),
        ({"x": 1, "v": 0, "duration": 1, "rate": 5, "object": "cube"}, "unknown object of this law 'cube'"),
    ],
)
def test_settings_that_cannot_be_are_refused(vary, message):
    with pytest.raises(cl.CommonlawError, match=message):
        cl.design(falling(), vary)


def test_laws_that_know_no_errors_are_refused():
    law = cl.Law.from_text("x'' = -g", {"g": 9.8})
    with pytest.raises(cl.CommonlawError, match="does not know how accurate its coefficients are"):
        cl.design(law, {"x": 1, "v": 0, "duration": 1, "rate": 5})


def test_settings_are_those_of_trials_by_default():
    drops = cl.datasets.linear_drag(noise=0.05)
    law = cl.fit("x'' = -g - c v", drops)
    found = cl.design(law, {"object": "Ball 3"}, trials=drops, about="c of Ball 3")
    assert len(found.experiments[0].experiment.times) == 49
    assert 40 < found.experiments[0].experiment.start[0] < 50


def test_a_design_shows_itself_in_a_notebook():
    shown = cl.design(falling(), {"x": 10, "v": 0, "duration": 1, "rate": 10})._repr_html_()
    assert "What to measure next" in shown
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


def test_an_input_is_shaped_to_tell_its_coefficient():
    """x' = a u with a free start: the integral of the input has to change most, as a level that stays does."""
    law = known("x' = a u", {"a": 1.0}, [[1.0]], inputs=("u",))
    vary = {"x": 0, "duration": 2, "samples": 9, "u": "0..2", "u.shape": ["constant", "step", "sine"], "u.period": 2}
    found = cl.design(law, vary).experiments[0]
    assert (found.experiment.settings["u"], found.experiment.settings["u.shape"]) == (2.0, "constant")
    columns = 2 * np.linspace(0, 2, 9)
    information = np.sum((columns - columns.mean()) ** 2) / NOISE**2
    assert found.bits == pytest.approx(np.log2(1 + information) / 2, rel=1e-3)


@pytest.mark.parametrize("shapes", ["constant, step", ["constant", "step"], ("constant", "step")])
def test_shapes_are_a_list_however_they_are_written(shapes):
    law = known("x' = a u", {"a": 1.0}, [[1.0]], inputs=("u",))
    found = cl.design(law, {"x": 0, "duration": 2, "samples": 9, "u": 2, "u.period": 2, "u.shape": shapes})
    assert found.experiments[0].experiment.settings["u.shape"] == "constant"


@pytest.mark.parametrize(
    ("setting", "message"),
    [({"u.shape": "1..5"}, r"unknown shape of an input '1\.\.5'"), ({"object": "1..5"}, r"unknown object .* '1\.\.5'")],
)
def test_ranges_of_words_are_refused_by_name(setting, message):
    law = known("x' = a u", {"a": 1.0}, [[1.0]], inputs=("u",))
    with pytest.raises(cl.CommonlawError, match=message):
        cl.design(law, {"x": 0, "duration": 2, "samples": 9, "u": 2, **setting})


def test_states_on_a_logarithmic_scale_start_above_zero():
    random, times = np.random.default_rng(0), np.linspace(0, 5, 40)
    states = [5 * np.exp(-rate * times + 0.05 * random.normal(size=40)) for rate in (0.5, 0.8)]
    trials = cl.Trials.from_arrays([times, times], states, object=["a", "b"], names=["x"])
    law = cl.discover(trials, library="poly:1", method=cl.TrajectoryLikelihood(positive=["x"]))
    with pytest.raises(cl.CommonlawError, match="follows its logarithm: give it above 0"):
        cl.design(law, {"x": "0..10", "duration": 5, "rate": 5})
    found = cl.design(law, {"x": "1..10", "duration": "1..8", "rate": 5}, about="coefficients")
    assert found.experiments[0].experiment.times[-1] == 8.0


@pytest.mark.parametrize("off", [0.0, 0.02, 10.0])
def test_starts_that_are_known_count_as_measured_beforehand(off):
    times = np.linspace(0, 2, 5)
    settings = {"x": 10, "v": 0, "times": [times]}
    found = cl.design(falling(), settings, about="g", start_std={"x": off, "v": off})
    columns = np.column_stack([-(times**2) / 2, np.ones(5), times]) / NOISE
    with np.errstate(divide="ignore"):
        prior = np.diag(1 / np.array([1.0, max(off, 1e-9), max(off, 1e-9)]) ** 2)
    expected = np.sqrt(np.linalg.inv(columns.T @ columns + prior)[0, 0])
    assert found.experiments[0].std == pytest.approx(expected, rel=1e-3)


def test_repeats_begin_anew_with_errors_of_their_starts():
    """Height in 1 s is known to the error of the start, and that is another one each time."""
    settings = {"x": 0, "v": 0, "times": [[0, 1]], "repeats": 4}
    found = cl.design(falling(), settings, about="g", start_std={"x": 0, "v": 0.5})
    variance = (0.5**2 + NOISE**2) / 4 * 2**2  # g = -2 x(1)
    assert found.experiments[0].std == pytest.approx((1 + 1 / variance) ** -0.5, rel=1e-3)


def test_starts_on_a_logarithmic_scale_are_off_by_shares():
    law = known("x' = a x", {"a": -0.3}, [[0.01]], noise=0.05)
    terms = Terms(Variables(("x",), (), "t", logarithmic=("x",)), law.terms.terms)
    law = replace(law, terms=terms, schema=replace(law.schema, logarithmic=("x",)))
    found = cl.design(law, {"x": 4, "times": [[0, 2]]}, about="a", start_std={"x": 0.2})
    columns = np.array([[0, 1], [2, 1]]) / 0.05  # log x = log x(0) + a t
    expected = np.linalg.inv(columns.T @ columns + np.diag([100, (4 / 0.2) ** 2]))[0, 0] ** 0.5
    assert found.experiments[0].std == pytest.approx(expected, rel=1e-3)


def test_errors_of_starts_that_cannot_be_are_refused():
    settings = {"x": 0, "v": 0, "duration": 1, "rate": 10}
    with pytest.raises(cl.CommonlawError, match="'y'"):
        cl.design(falling(), settings, start_std={"y": 0})
    with pytest.raises(cl.CommonlawError, match="the start of x is off by -1: give a number from zero on"):
        cl.design(falling(), settings, start_std={"x": -1})


@pytest.fixture
def eliminated():
    """A law by which a dose leaves, and its true trials."""
    law = known("c' = -k c + dose", {"k": 0.5}, np.diag([0.01, 0]), inputs=("dose",))
    return replace(law, schema=replace(law.schema, doses=("dose",), input_between="linear"))


def test_a_dose_that_leaves_is_best_measured_after_its_mean_stay(eliminated):
    """Box and Lucas 1959: of D exp(-k t) one sample tells k best at t = 1/k."""
    settings = {"c": 0, "dose": 3, "times": [[0, t] for t in (0.5, 1, 2, 3, 4)]}
    found = cl.design(eliminated, settings, about="k", start_std={"c": 0})
    assert found.experiments[0].experiment.settings["times"] == (0, 2)
    slope = 2 * 3 * np.exp(-0.5 * 2) / NOISE
    assert found.experiments[0].std == pytest.approx((100 + slope**2) ** -0.5, rel=1e-3)
    assert "dose of 3 after 0, 2 samples over 2" in found.experiments[0].text


def test_doses_are_given_when_and_as_often_as_is_set(eliminated):
    settings = {
        "object": "ball",
        "c": 0.0,
        "dose": 3.0,
        "dose.at": 1.0,
        "dose.every": 2.0,
        "times": (0.0, 0.5, 2.0, 4.5),
    }
    found = said(eliminated, settings)
    expected = [0, 0, 3 * np.exp(-0.5), 3 * np.exp(-0.5 * 3.5) + 3 * np.exp(-0.5 * 1.5)]
    np.testing.assert_allclose(found.mean, expected, atol=1e-3)


def test_doses_are_those_of_trials_by_default():
    times = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 8.0])
    random = np.random.default_rng(0)
    states, doses, since = [], [], times - 1
    for amount in (2.0, 4.0):
        doses.append(np.where(times == 1, amount, 0.0)[:, np.newaxis])
        clean = np.where(since > 0, amount * np.exp(-0.5 * since), 0.0)
        states.append((clean + 0.02 * random.normal(size=6))[:, np.newaxis])
    trials = cl.Trials.from_arrays([times] * 2, states, inputs=doses, names=["c", "dose"])
    law = cl.fit("c' = -k c + dose", trials, doses="dose")
    found = cl.design(law, {"c": 0}, trials=trials)
    settings = found.experiments[0].experiment.settings
    assert 2 <= settings["dose"] <= 4
    assert settings["dose.at"] == 1
    assert (settings["duration"], settings["samples"]) == (8, 6)


@pytest.mark.parametrize(
    ("vary", "message"),
    [({"dose.shape": "ramp"}, r"dose\.shape"), ({"dose.every": 0}, r"dose\.every is 0: give numbers above 0")],
)
def test_doses_have_no_shape_and_take_time(eliminated, vary, message):
    with pytest.raises(cl.CommonlawError, match=message):
        cl.design(eliminated, {"c": 0, "dose": 3, "duration": 5, "rate": 2, **vary})
