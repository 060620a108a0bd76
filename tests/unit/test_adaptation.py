"""Coefficients that few samples of an object update, beside the product of two normal distributions."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law.parameters import named_parameters, standard_errors
from commonlaw.law.population import with_objects_of
from tests.refusals import refused

DRAGS = (-0.1, -0.2, -0.3, -0.5, -0.7, -0.4)


@pytest.fixture(scope="module")
def drops():
    return cl.datasets.linear_drag(drag=DRAGS, noise=0.05)


@pytest.fixture(scope="module")
def law(drops):
    """Five of six balls; gravity is universal, and drag each ball's own."""
    return cl.fit("x'' = -g - c v", drops.select(object=drops.objects[:5])).explain([])


def numbers(law):
    return law.coefficients[0][law.support], standard_errors(law)[0][law.support], law.uncertainty.covariance[0]


def test_the_posterior_is_the_product_of_what_was_known_and_what_the_trials_tell(drops, law):
    unseen = drops.select(object="Ball 6")
    expected, _, spread = numbers(with_objects_of(law, unseen)[0])
    noise = {"x": float(law.uncertainty.noise[0])}
    own, _, covariance = numbers(cl.fit("x'' = -g - c v", unseen, noise=noise, partial_pooling=False))
    total = np.linalg.inv(np.linalg.inv(spread) + np.linalg.inv(covariance))
    mean = total @ (np.linalg.solve(spread, expected) + np.linalg.solve(covariance, own))
    found, errors, _ = numbers(law.update(unseen))
    np.testing.assert_array_less(abs(found - mean), 0.05 * errors)
    np.testing.assert_allclose(errors, np.sqrt(np.diag(total)), rtol=0.02)


@pytest.mark.parametrize("start", ["", "; x(0) = h"])
def test_objects_that_share_a_parameter_are_updated_as_by_a_fit_of_all_trials(drops, start):
    three = drops.select(object=drops.objects[:3])
    equation, more = f"x'' = -g - c v{start}", {"shared": "g", "noise": {"x": 0.05}}
    found = cl.fit(equation, three.select(trial=1), **more).update(three.select(trial=2))
    expected = cl.fit(equation, three, **more)
    one, other = (named_parameters(of) for of in (found, expected))
    assert one.names == other.names
    assert np.ptp(one.values[:, one.names.index("g")]) < 1e-9
    np.testing.assert_array_less(abs(one.values - other.values), 0.1 * other.errors)
    np.testing.assert_allclose(one.errors, other.errors, rtol=0.05)
    correlations = [of.joint_covariance([(0, of.names.index("c")), (2, of.names.index("c"))]) for of in (one, other)]
    assert correlations[0][0, 1] == pytest.approx(correlations[1][0, 1], rel=0.1)


def test_an_adapted_law_forecasts_and_says_where_it_comes_from(drops, law):
    unseen = drops.select(object="Ball 6")
    adapted = law.update(unseen.select(trial=1).until(1.5))
    assert adapted.objects == ("Ball 6",)
    assert adapted.provenance.history[-1].stage == "adaptation"
    before, after = (each.predict(unseen.select(trial=2), return_std=True) for each in (law, adapted))
    assert after.std[0][-1, 0] < 0.3 * before.std[0][-1, 0]
    inside = abs(after.trajectories[0].states[:, :1] - unseen.trials[1].states) < after.margins(measured=True)[0]
    assert inside.mean() > 0.85


def test_known_objects_learn_from_more_trials(drops):
    first = drops.select(object=drops.objects[:2], trial=1)
    law = cl.fit("x'' = -9.8 - c v", first)
    found = law.update(drops.select(object="Ball 2", trial=2))
    both = cl.fit("x'' = -9.8 - c v", drops.select(object="Ball 2"))
    errors = standard_errors(found)
    assert errors[0, 0, 0] == 0  # Gravity is known
    np.testing.assert_allclose(found.coefficients[0], both.coefficients[0], rtol=0.02)
    np.testing.assert_allclose(errors[0, 0, 1], standard_errors(both)[0, 0, 1], rtol=0.2)


def test_laws_that_cannot_weigh_new_trials_are_refused(drops, law):
    noiseless = replace(law, uncertainty=replace(law.uncertainty, noise=None))
    with refused("weights-unknown", lacking="has no noise estimate"):
        noiseless.update(drops)
    walking = replace(law.uncertainty.error_model, walk=np.array([0.1, 0.1]))
    with refused("weights-unknown", lacking="has process noise"):
        replace(law, uncertainty=replace(law.uncertainty, error_model=walking)).update(drops)
    with refused("columns-differ", kind="states"):
        law.update(cl.Trials.from_arrays(np.arange(9.0), np.arange(9.0), names=["y"], object="Ball 1"))
