"""Coefficients drawn to their means over objects, beside the joint normal distribution written out whole."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.errors import CommonlawError
from commonlaw.law.pooling import pool
from commonlaw.library import PolynomialLibrary, Variables


def measured(objects, spread, parameters=3, seed=0):
    """Each object's true coefficients, estimates of them, and the covariances of their errors."""
    generator = np.random.default_rng(seed)
    designs = generator.standard_normal((objects, 8, parameters))
    covariances = np.linalg.inv(np.matmul(designs.transpose(0, 2, 1), designs))
    truth = np.array([5.0, 0.0, -3.0])[:parameters] + spread * generator.standard_normal((objects, parameters))
    errors = np.matmul(np.linalg.cholesky(covariances), generator.standard_normal((objects, parameters, 1)))[..., 0]
    return truth, truth + errors, covariances


def posterior(estimates, covariances, variances):
    """Means and covariance of all coefficients of all objects together, with flat priors on the means."""
    objects, size = estimates.shape
    vague = 1e5
    together = np.kron(np.full((objects, objects), vague), np.eye(size)) + np.kron(np.eye(objects), np.diag(variances))
    errors = np.zeros_like(together)
    for o, each in enumerate(covariances):
        errors[o * size : (o + 1) * size, o * size : (o + 1) * size] = each
    gain = together @ np.linalg.inv(together + errors)
    return (gain @ estimates.ravel()).reshape(objects, size), together - gain @ together


def test_common_and_own_coefficients_are_those_of_the_joint_posterior():
    _, estimates, covariances = measured(4, 0.5)
    found = pool(estimates, covariances, np.array([0.0, np.inf, 0.0]))
    means, joint = posterior(estimates, covariances, [0.0, 1e5, 0.0])
    np.testing.assert_allclose(found.estimates, means, atol=1e-4)
    np.testing.assert_allclose(np.ptp(found.estimates[:, [0, 2]], axis=0), 0, atol=1e-9)
    for o in range(4):
        for other in range(4):
            block = joint[3 * o : 3 * o + 3, 3 * other : 3 * other + 3]
            ours = found.covariances[o] if o == other else found.common[o] @ found.common[other].T
            np.testing.assert_allclose(ours, block, atol=2e-4)


def test_scattered_coefficients_stay_and_alike_ones_meet():
    _, estimates, covariances = measured(10, np.array([0.0, 30.0, 0.0]), seed=2)
    found = pool(estimates, covariances, np.full(3, np.nan))
    assert found.shrinkage[1] < 0.02
    assert np.all(found.shrinkage[[0, 2]] > 0.5)
    assert np.ptp(found.estimates[:, 0]) < 0.6 * np.ptp(estimates[:, 0])


@pytest.mark.parametrize("objects", [2, 10])
@pytest.mark.parametrize("spread", [0.0, 0.5, 10.0])
def test_intervals_hold_the_truth_and_errors_get_smaller(objects, spread):
    inside, before, after = [], [], []
    for seed in range(60):
        truth, estimates, covariances = measured(objects, spread, seed=seed)
        found = pool(estimates, covariances, np.full(3, np.nan))
        errors = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))
        inside.append(abs(found.estimates - truth) < 1.96 * errors)
        before.append((estimates - truth) ** 2)
        after.append((found.estimates - truth) ** 2)
    assert np.mean(inside) > 0.89
    # Two objects that are not alike may look so by chance
    assert np.mean(after) < np.mean(before) * (0.6 if spread == 0 else 1.3 if objects == 2 else 1.05)


def test_units_do_not_matter():
    _, estimates, covariances = measured(5, 0.3)
    units = np.array([1e-6, 1.0, 1e8])
    one = pool(estimates, covariances, np.full(3, np.nan))
    other = pool(estimates * units, covariances * np.outer(units, units), np.full(3, np.nan))
    np.testing.assert_allclose(other.estimates, one.estimates * units, rtol=1e-6)
    np.testing.assert_allclose(other.covariances, one.covariances * np.outer(units, units), rtol=1e-6)


def law_of(objects=6, spread=0.05):
    _, estimates, covariances = measured(objects, spread, parameters=2)
    terms = PolynomialLibrary(2).bind(Variables(("x", "v"), (), "t"))
    coefficients = np.zeros((objects, 1, len(terms)))
    coefficients[:, 0, [terms.index("1"), terms.index("v")]] = estimates
    names = tuple(f"ball {o + 1}" for o in range(objects))
    return cl.Law(terms, cl.Schema(states=("x",)), 2, names, coefficients, uncertainty=cl.Uncertainty(covariances))


def test_the_mean_over_pooled_objects_has_the_covariance_of_a_mean():
    law = law_of()
    found = law.partial_pooling()
    draws = np.random.default_rng(1)
    own = found.covariance - np.matmul(
        found.uncertainty.shared_factor, found.uncertainty.shared_factor.transpose(0, 2, 1)
    )
    shared = np.matmul(found.uncertainty.shared_factor, draws.standard_normal((20000, 1, 2, 1)))[..., 0]
    alone = np.matmul(np.linalg.cholesky(own), draws.standard_normal((20000, 6, 2, 1)))[..., 0]
    expected = np.cov((shared + alone).mean(axis=1), rowvar=False)
    np.testing.assert_allclose(found.average().covariance[0], expected, rtol=0.05, atol=2e-4)
    assert found.average().uncertainty.shared_factor is None
    some = found.select(["ball 2", "ball 5"])
    np.testing.assert_array_equal(some.uncertainty.shared_factor, found.uncertainty.shared_factor[[1, 4]])


def test_pooling_is_recorded_and_kept():
    found = law_of().partial_pooling()
    assert found.history[-1].stage == "pooling"
    assert "v in x''" in found.history[-1].choice
    again = cl.Law.from_json(found.to_json())
    np.testing.assert_array_equal(again.uncertainty.shared_factor, found.uncertainty.shared_factor)
    with pytest.raises(CommonlawError, match="pooled already"):
        again.partial_pooling()


def test_what_is_known_and_single_objects_stay():
    law = law_of()
    known = law.covariance.copy()
    known[:, 0] = known[:, :, 0] = 0
    fixed = replace(law, uncertainty=replace(law.uncertainty, covariance=known)).partial_pooling()
    np.testing.assert_array_equal(fixed.coefficients[:, 0, 0], law.coefficients[:, 0, 0])
    np.testing.assert_array_equal(fixed.standard_errors[:, 0, 0], 0)
    single = law.select(["ball 3"])
    assert single.partial_pooling() is single
    with pytest.raises(CommonlawError, match="does not know how accurate"):
        replace(law, uncertainty=replace(law.uncertainty, covariance=None)).partial_pooling()
