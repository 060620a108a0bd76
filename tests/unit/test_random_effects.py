"""The random-effects model of coefficients over objects, beside joint normal distributions written out whole."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from commonlaw.hierarchy import RandomEffects, marginal_deviance, shrink
from tests.unit.estimates import measured


def dense(estimates, covariances, variances):
    """The joint covariance of all objects' estimates, and the matrix that gives each object the means."""
    objects, size = estimates.shape
    covariance = np.zeros((objects * size, objects * size))
    for o, each in enumerate(covariances):
        covariance[o * size : (o + 1) * size, o * size : (o + 1) * size] = each + np.diag(variances)
    return covariance, np.tile(np.eye(size), (objects, 1))


VARIANCES = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 5.0], [1e-3, 1.0, 1e3]])


@pytest.mark.parametrize("objects", [2, 7])
def test_the_marginal_likelihood_is_that_of_the_joint_normal_distribution(objects):
    _, estimates, covariances = measured(objects, 0.7)
    marginal = RandomEffects(estimates, np.linalg.inv(covariances)).marginal(VARIANCES)
    # What counts as nothing: each object's mean is its own estimate
    alone = sum(-2 * multivariate_normal(np.zeros(3), each).logpdf(np.zeros(3)) for each in covariances)
    for m, variances in enumerate(VARIANCES):
        covariance, design = dense(estimates, covariances, variances)
        precision = np.linalg.inv(covariance)
        information = design.T @ precision @ design
        means = np.linalg.solve(information, design.T @ precision @ estimates.ravel())
        np.testing.assert_allclose(marginal.means[m], means, rtol=1e-8)
        np.testing.assert_allclose(marginal.total[m], information, rtol=1e-8)
        expected = -2 * multivariate_normal(design @ means, covariance).logpdf(estimates.ravel()) - alone
        assert marginal.deviance[m] == pytest.approx(expected, rel=1e-8)
        restricted = expected + np.linalg.slogdet(information)[1]
        assert marginal.restricted_deviance[m] == pytest.approx(restricted, rel=1e-8)


@pytest.mark.parametrize("parameter", [0, 1, 2])
@pytest.mark.parametrize("near", [1.0, 1e-5])
def test_deviances_along_one_variance_are_those_of_the_whole_marginal(parameter, near):
    _, estimates, covariances = measured(5, 0.7)
    mixed = np.array([[1.0, 0.0, 0.0], [1 - near, near, 0.0], [0.2, 0.0, 1.0]])
    effects = RandomEffects(estimates, mixed.T @ np.linalg.inv(covariances) @ mixed)
    grid, base = np.array([0.0, 1e-6, 0.1, 1.0, 1e4]), np.array([0.3, 0.0, 2.0])
    tried = np.tile(base, (len(grid), 1))
    tried[:, parameter] = grid
    np.testing.assert_allclose(effects.deviances(base, parameter, grid), effects.marginal(tried).deviance, rtol=1e-7)


def test_coefficients_that_all_objects_have_in_common_cost_what_their_estimates_scatter():
    _, estimates, covariances = measured(6, 0.5)
    information = np.linalg.inv(covariances)
    effects = RandomEffects(estimates, information)
    covariance, design = dense(estimates, covariances, np.zeros(3))
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    left = np.linalg.lstsq(white @ design, white @ estimates.ravel(), rcond=None)[1]
    assert marginal_deviance(effects, common=3) == pytest.approx(left[0], rel=1e-8)
    assert marginal_deviance(effects) < marginal_deviance(effects, common=1) < marginal_deviance(effects, common=3)


@pytest.mark.parametrize("spread", [0.0, 0.5, 10.0])
def test_what_coefficients_cost_is_the_least_over_means_and_variances(spread):
    _, estimates, covariances = measured(6, spread, parameters=1)
    information = np.linalg.inv(covariances)
    found = marginal_deviance(RandomEffects(estimates, information))
    alone = sum(-2 * multivariate_normal(np.zeros(1), each).logpdf(np.zeros(1)) for each in covariances)
    costs = []
    for variance in np.array([0, *10.0 ** np.arange(-4, 2.1, 0.5)]) * np.mean(estimates**2):
        covariance, _ = dense(estimates, covariances, [variance])
        precision = 1 / np.diag(covariance)
        means = np.full(6, precision @ estimates[:, 0] / precision.sum())
        costs.append(-2 * multivariate_normal(means, covariance).logpdf(estimates.ravel()) - alone)
    assert found == pytest.approx(min(costs), rel=1e-8)
    assert marginal_deviance(RandomEffects(estimates[:1], information[:1])) == 0


def test_a_mean_that_the_data_do_not_tell_does_no_harm():
    _, estimates, covariances = measured(4, 0.5)
    information = np.linalg.inv(covariances)
    information[:, 1] = information[:, :, 1] = 0
    information[:, 1, 1] = 1e-300
    whole = RandomEffects(estimates, information).marginal(np.array([[0.2, 0.2, 0.2]])).deviance
    without = RandomEffects(estimates[:, [0, 2]], information[:, [0, 2]][:, :, [0, 2]]).marginal(np.full((1, 2), 0.2))
    np.testing.assert_allclose(whole, without.deviance)


def posterior(estimates, covariances, variances):
    """Means and covariance of all coefficients of all objects together, with flat priors on the means."""
    objects, size = estimates.shape
    vague = 1e5
    together = np.kron(np.full((objects, objects), vague), np.eye(size)) + np.kron(np.eye(objects), np.diag(variances))
    errors = np.zeros_like(together)
    for o, covariance in enumerate(covariances):
        errors[o * size : (o + 1) * size, o * size : (o + 1) * size] = covariance
    gain = together @ np.linalg.inv(together + errors)
    return (gain @ estimates.ravel()).reshape(objects, size), together - gain @ together


def test_common_and_own_coefficients_are_those_of_the_joint_posterior():
    _, estimates, covariances = measured(4, 0.5)
    found = shrink(estimates, covariances, np.array([0.0, np.inf, 0.0]))
    means, joint = posterior(estimates, covariances, [0.0, 1e5, 0.0])
    np.testing.assert_allclose(found.estimates, means, atol=1e-4)
    np.testing.assert_allclose(np.ptp(found.estimates[:, [0, 2]], axis=0), 0, atol=1e-9)
    for o in range(4):
        for other in range(4):
            block = joint[3 * o : 3 * o + 3, 3 * other : 3 * other + 3]
            ours = found.covariances[o] if o == other else found.shared_factors[o] @ found.shared_factors[other].T
            np.testing.assert_allclose(ours, block, atol=2e-4)


@pytest.mark.parametrize("objects", [3, pytest.param(8, marks=pytest.mark.slow)])
def test_coefficients_that_scatter_together_are_not_drawn_away_from_the_truth(objects):
    """A rate r of growth with one capacity K: the coefficients r and -r/K scatter along one line."""
    generator = np.random.default_rng(5)
    error = 0.05 * np.linalg.cholesky(np.array([[1.0, -0.95], [-0.95, 1.0]]))
    inside, before, after = [], [], []
    for _ in range(100):
        truth = np.exp(0.2 * generator.standard_normal((objects, 1))) * np.array([1.0, -0.5])
        estimates = truth + generator.standard_normal((objects, 2)) @ error.T
        found = shrink(estimates, np.tile(error @ error.T, (objects, 1, 1)), np.full(2, np.nan))
        errors = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))
        inside.append(abs(found.estimates - truth) < 1.96 * errors)
        before.append((estimates - truth) ** 2)
        after.append((found.estimates - truth) ** 2)
    assert np.mean(inside) > 0.87
    assert np.mean(after) < 1.15 * np.mean(before)


def test_what_is_drawn_far_from_the_origin_is_what_is_drawn_at_it():
    """Planes over two variables, seen from where the variables are counted and from far away."""
    generator = np.random.default_rng(0)
    x, y = generator.uniform(0, 1, (2, 6, 100))
    heights = generator.uniform(1, 2, (6, 3))  # At the origin, and slopes
    drawn = []
    for shift in (1e5, 1e6, 1e7):
        inverses = np.linalg.pinv(np.stack([np.ones_like(x), x + shift, y + shift], axis=2), rcond=0)
        estimates = np.column_stack([heights[:, 0] - shift * heights[:, 1:].sum(axis=1), heights[:, 1:]])
        covariances = 1e-2 * np.matmul(inverses, inverses.transpose(0, 2, 1))
        found = shrink(estimates, covariances, np.full(3, np.nan))
        drawn.append(
            np.hstack([found.estimates, np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))])[:, [1, 2, 4, 5]]
        )
    np.testing.assert_allclose(drawn[1:], [drawn[0]] * 2, rtol=1e-3)


def test_units_do_not_matter():
    _, estimates, covariances = measured(5, 0.3)
    units = np.array([1e-6, 1.0, 1e8])
    one = shrink(estimates, covariances, np.full(3, np.nan))
    other = shrink(estimates * units, covariances * np.outer(units, units), np.full(3, np.nan))
    np.testing.assert_allclose(other.estimates, one.estimates * units, rtol=1e-6)
    np.testing.assert_allclose(other.covariances, one.covariances * np.outer(units, units), rtol=1e-6)


@pytest.mark.parametrize("seed", [31, 32])
def test_coefficients_that_can_hardly_be_told_apart_never_pay_for_themselves(seed):
    """A marginal likelihood is at most that of each object by itself, however the digits run out."""
    generator, size = np.random.default_rng(seed), 8
    mixed = np.diag(np.logspace(0, -8, size)) @ np.linalg.qr(generator.normal(size=(size, size)))[0]
    factors = np.asarray(np.linalg.qr(generator.normal(size=(5, 30, size)) @ mixed, mode="r"))
    estimates = np.linalg.solve(factors, 10 * generator.normal(size=(5, size, 1)))[..., 0]
    assert marginal_deviance(RandomEffects(estimates, factors.transpose(0, 2, 1) @ factors)) >= 0


def test_an_object_that_says_nothing_of_one_coefficient_is_drawn_by_what_it_says_of_others():
    _, estimates, covariances = measured(5, 0.3)
    found = {}
    for size in (1e5, 1e12, 1e24):
        errors = covariances.copy()
        errors[4, 2, 2] += size
        found[size] = shrink(estimates, errors, np.full(3, np.nan)).estimates
    np.testing.assert_allclose(found[1e12], found[1e5], rtol=1e-3)
    np.testing.assert_allclose(found[1e24], found[1e12], rtol=1e-6)


def test_coefficients_that_scatter_stay_where_errors_of_each_object_are_those_of_fewer():
    generator = np.random.default_rng(0)
    halves = 1e-5 * generator.standard_normal((5, 8, 7))
    own, errors = generator.standard_normal((5, 8)), halves @ halves.swapaxes(1, 2)
    found = shrink(own, errors, np.full(8, np.nan))
    np.testing.assert_allclose(found.estimates, own, atol=1e-7)
    np.testing.assert_allclose(found.covariances, errors, atol=1e-4 * errors.max())


def test_objects_that_say_nothing_of_a_coefficient_are_drawn_to_the_others():
    _, estimates, covariances = measured(6, 0.3)
    sizes = np.ones((6, 3))
    sizes[:2, 1] = 1e70, 1e10
    wild = estimates + np.where(sizes > 1, sizes**0.5, 0.0)
    found = shrink(wild, covariances * sizes[:, :, np.newaxis] * sizes[:, np.newaxis], np.full(3, np.nan))
    rest = shrink(estimates[2:], covariances[2:], np.full(3, np.nan))
    assert abs(found.estimates[:2, 1] - rest.estimates[:, 1].mean()).max() < 3 * np.ptp(rest.estimates[:, 1])
    np.testing.assert_allclose(found.estimates[2:, 1], rest.estimates[:, 1], atol=0.1)
