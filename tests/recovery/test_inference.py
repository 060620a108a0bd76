"""The default way from trials to a law, on trials whose law is known."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from benchmarks.variational import cramer_rao, solve
from commonlaw import datasets
from commonlaw.diagnostics import Diagnostic
from commonlaw.law import from_json, pool_objects, select_objects, to_json
from commonlaw.law.parameters import left_hand_sides, standard_errors
from tests.refusals import refused

STAGES = {"noise", "library", "mesh", "model error", "coefficients"}


def found(trials, truth, **settings):
    """The law that is found, of which the support is checked, and that coefficients are near the truth."""
    law = cl.discover(trials, **{"order": truth.order, "library": "poly:3"} | settings)
    expected = np.zeros_like(law.coefficients)
    for k, term in enumerate(truth.terms.names):
        expected[:, :, law.terms.index(term)] = select_objects(truth, law.objects).coefficients[:, :, k]
    np.testing.assert_array_equal(law.support, np.any(expected != 0, axis=0), str(law))
    errors = standard_errors(law)
    free = law.support & (errors > 0)
    scores = (law.coefficients - expected)[free] / errors[free]
    assert np.all(np.abs(scores) < 4)
    np.testing.assert_allclose(law.coefficients[~free], expected[~free])
    assert {step.stage for step in law.history} == STAGES | {
        *(f"terms of {side}" for side in left_hand_sides(law)),
        *(["pooling"] if law.uncertainty.pooled is not None else []),
    }
    assert np.all((law.uncertainty.inclusion_probabilities >= 0) & (law.uncertainty.inclusion_probabilities <= 1))
    assert np.all(law.uncertainty.inclusion_probabilities[law.support] > 0.9)
    assert np.all(law.uncertainty.inclusion_probabilities[~law.support] < 0.5)
    return law


def kept(trials, keep):
    """The trials with some of their samples, for each of which `keep` returns which."""
    return replace(trials, trials=tuple(
        replace(each, times=each.times[rows], states=each.states[rows], inputs=each.inputs[rows])
        for each, rows in ((trial, keep(len(trial))) for trial in trials)
    ))  # fmt: skip


DRAGS = {"drag": (-0.2, -0.5)}


@pytest.fixture(scope="module")
def drops():
    return datasets.linear_drag(**DRAGS, noise=0.05, samples=60, rate=20)


@pytest.fixture(scope="module")
def drag(drops):
    return found(drops, datasets.linear_drag.truth(**DRAGS), order=2, library="poly:2")


def oscillator(**options):
    return datasets.nonlinear_oscillator(samples=300, step=0.02, **options)


# What is found


def test_samples_at_irregular_times_will_do():
    generator = np.random.default_rng(3)
    measured = kept(oscillator(noise=0.02), lambda n: np.sort(generator.choice(n, 200, replace=False)))
    found(measured, datasets.nonlinear_oscillator.truth())


def test_intervals_are_as_narrow_as_the_data_allow():
    variables, equations = ("x", "y"), (("x^3", "y^3"), ("x^3", "y^3"))
    trials, noise = datasets.nonlinear_oscillator(samples=500, step=0.02, noise=0.05), np.array([0.05, 0.05])
    law = found(
        trials, datasets.nonlinear_oscillator.truth(), method=cl.TrajectoryLikelihood(noise={"x": 0.05, "y": 0.05})
    )
    coefficients = np.array([-0.1, 2.0, -2.0, -0.1])
    bounds = cramer_rao([solve(variables, equations, coefficients, np.array([2.0, 0.0]), trials[0].times)], noise)
    np.testing.assert_allclose(standard_errors(law)[0][law.support] / bounds, 1, atol=0.03)


# What is known


def test_known_terms_stay_and_are_certain(drops, drag):
    truth = datasets.linear_drag.truth(**DRAGS)
    law = found(drops, truth, order=2, library="poly:2", known={"1": -9.8})
    gravity, slope = law.terms.index("1"), law.terms.index("v")
    np.testing.assert_array_equal(law.coefficients[:, 0, gravity], -9.8)
    np.testing.assert_array_equal(standard_errors(law)[:, 0, gravity], 0)
    assert law.uncertainty.inclusion_probabilities[0, gravity] == 1
    assert np.all(standard_errors(law)[:, 0, slope] < standard_errors(drag)[:, 0, slope])
    assert [alternative.terms for alternative in law.provenance.alternatives if alternative.chosen] == [("1", "v")]


def test_forecasts_draw_objects_to_each_other_unless_that_is_not_wanted(drops, drag):
    own = cl.discover(drops, order=2, library="poly:2", method=cl.TrajectoryLikelihood(partial_pooling=False))
    assert own.uncertainty.pooled is None
    np.testing.assert_array_equal(drag.coefficients, own.coefficients)
    np.testing.assert_array_equal(drag.uncertainty.covariance, own.uncertainty.covariance)
    drawn, used = pool_objects(drag), drag.uncertainty.pooled
    assert drag.provenance.history == drawn.provenance.history[:-1]
    np.testing.assert_array_equal(used.coefficients, drawn.coefficients[:, drag.support])
    np.testing.assert_array_equal(used.covariance, drawn.uncertainty.covariance)
    gravity = drag.terms.index("1")
    assert np.ptp(drawn.coefficients[:, 0, gravity]) < np.ptp(drag.coefficients[:, 0, gravity])
    assert np.all(standard_errors(drawn)[:, 0, gravity] < standard_errors(drag)[:, 0, gravity])
    some = drops.select(object=drops.objects[:1])
    expected = drawn.predict(some, averaged=False)
    alone = from_json(to_json(select_objects(drag, some.objects))).predict(some, averaged=False)
    np.testing.assert_allclose(alone.trajectories[0].states, expected.trajectories[0].states, atol=1e-6)


def test_given_noise_is_used(drops, drag):
    settings = {"order": 2, "library": "poly:2"}
    law = cl.discover(drops, method=cl.TrajectoryLikelihood(noise={"x": 0.2}), **settings)
    assert law.uncertainty.noise == pytest.approx([0.2])
    assert law.history[0].reason == "as given"
    assert drag.provenance.history[0].reason != "as given"
    # With the same support, standard errors grow with the noise
    methods = [cl.TrajectoryLikelihood(noise={"x": noise}) for noise in (0.1, 0.05)]
    high, low = (standard_errors(cl.discover(drops, method=method, order=2, library="terms:1,v")) for method in methods)
    assert high == pytest.approx(2 * low, rel=0.05)


# Other ways


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"solver": "stlsq:0.1"}, "solver-with-value"),
        ({"covariance": "guess"}, Diagnostic("unknown-name", {"kind": "covariance", "name": "guess"})),
        ({"noise": {"y": 0.1}}, Diagnostic("unknown-name", {"name": "y"})),
        ({"noise": {}}, "noise-missing"),
        ({"noise": {"x": [1]}}, Diagnostic("argument-type", {"name": "noise of x", "kind": "list"})),
        ({"noise": {"x": 0.0}}, Diagnostic("noise-not-positive", {"name": "x"})),
        ({"noise": {"x": -1.0}}, Diagnostic("noise-not-positive", {"name": "x"})),
        ({"noise": {"x": np.nan}}, Diagnostic("noise-not-positive", {"name": "x"})),
        ({"noise": {"x": 1e300}}, Diagnostic("noise-overwhelming", {"name": "x"})),
        ({"huber_threshold": 0.0}, "huber-threshold"),
        ({"huber_threshold": np.nan}, "huber-threshold"),
    ],
)
def test_what_does_not_fit_is_refused(drops, settings, message):
    with refused(message):
        cl.discover(drops, order=2, library="poly:1", method=cl.TrajectoryLikelihood(**settings))


def test_a_trial_that_is_too_short_is_named(drops):
    few = replace(drops, trials=(*drops.trials[:-1], kept(drops, lambda n: np.arange(n) < 1).trials[-1]))
    with refused("one-value", where=drops.trials[-1].label):
        cl.discover(few, order=2, library="poly:3")


def test_short_trials_among_long_ones_do_not_change_the_noise(drops):
    few = replace(drops, trials=(*drops.trials, replace(drops.trials[-1].cut(5), name="short")))
    noise, alone = (cl.discover(each, order=2, library="poly:1").uncertainty.noise for each in (few, drops))
    np.testing.assert_allclose(noise, alone, rtol=0.02)


def test_the_noise_of_a_state_may_be_named_with_its_unit():
    trials = cl.Trials.from_arrays(np.arange(9.0), np.exp(-np.arange(9.0)), names=["U"], units={"U": "V"})
    assert cl.discover(
        trials, method=cl.TrajectoryLikelihood(noise={"U [V]": 0.03}), order=1, library="poly:3"
    ).uncertainty.noise == pytest.approx([0.03])
    with refused("unknown-name", kind="state", name="I"):
        cl.discover(trials, method=cl.TrajectoryLikelihood(noise={"I": 0.03}), order=1, library="poly:3")


# What must not matter


def test_the_order_of_objects_and_trials_does_not_matter(drops, drag):
    law = cl.discover(replace(drops, trials=drops.trials[::-1]), order=2, library="poly:2")
    law = select_objects(law, drag.objects)
    np.testing.assert_allclose(law.coefficients, drag.coefficients, rtol=1e-6)
    np.testing.assert_allclose(law.uncertainty.covariance, drag.uncertainty.covariance, rtol=1e-5)
    np.testing.assert_allclose(
        law.uncertainty.inclusion_probabilities, drag.uncertainty.inclusion_probabilities, rtol=1e-4
    )


def test_a_state_that_changes_between_trials_only_is_refused():
    times = np.linspace(0, 1, 20)
    still = cl.Trials.from_arrays([times] * 2, [np.full(20, level) for level in (1.0, 2.0)], names=["x"])
    with refused("state-constant", state="x", remedy="measure it while it changes"):
        cl.discover(still, order=1, library="poly:3")
