"""What decides coefficients: relations to objects' properties, beside normal distributions written out whole."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from commonlaw.hierarchy import PropertyTable, RelationKind, explain
from commonlaw.hierarchy.joint_model import CoefficientModel, Estimates, JointModel, log_evidence
from commonlaw.hierarchy.relation import exponent_sets

NAMES = ("diameter", "mass", "temperature")


def population(seed=0, objects=10, error=0.02, scatter=0.0, decoys=1):
    """Gravity that is universal and drag by diameter and mass, their estimates with errors that hang together."""
    generator = np.random.default_rng(seed)
    size = np.exp(generator.uniform(*np.log([[0.04, 0.03], [0.25, 0.8]]), (objects, 2)))
    values = np.column_stack([size, np.exp(generator.normal(3, 0.3, (objects, decoys)))])
    drag = 0.25 * size[:, 0] ** 2 / size[:, 1] * np.exp(scatter * generator.standard_normal(objects))
    truth = np.column_stack([np.full(objects, -9.8), drag])
    deviations = error * abs(truth)
    covariances = deviations[:, :, np.newaxis] * deviations[:, np.newaxis] * np.array([[1.0, -0.95], [-0.95, 1.0]])
    errors = np.matmul(np.linalg.cholesky(covariances), generator.standard_normal((objects, 2, 1)))[..., 0]
    return truth, truth + errors, covariances, PropertyTable(NAMES[: 2 + decoys], values)


def dense_log_evidence(joint, k, model, vague):
    """The density of all estimates under one model of coefficient k, its factors normal with that deviation."""
    objects, size, count = joint.design.shape
    width = model.columns.shape[1]
    design = np.zeros((objects, size, count + width))
    design[:, :, :count], design[:, k, count:] = joint.design, model.columns
    variances, residuals = joint.variances.copy(), joint.residuals.copy()
    variances[:, k], residuals[:, k] = model.variances, residuals[:, k] - model.offsets
    covariance = np.zeros((objects * size, objects * size))
    for o in range(objects):
        part = slice(o * size, (o + 1) * size)
        covariance[part, part] = joint.errors[o] + np.diag(variances[o])
    flat, improper = design.reshape(-1, count + width), np.append(np.ones(count, dtype=bool), model.precision == 0)
    prior = np.where(improper, vague, 1 / np.sqrt(np.append(np.ones(count), np.maximum(model.precision, 1e-300))))
    total = covariance + flat * prior**2 @ flat.T
    return multivariate_normal(np.zeros(len(total)), total).logpdf(residuals.ravel())


def test_the_evidence_is_that_of_the_joint_normal_distribution():
    generator = np.random.default_rng(1)
    logs, estimates = generator.normal(0, 0.5, (4, 10)), generator.normal(1, 0.2, (10, 2))
    covariances = np.tile([[0.04, -0.03], [-0.03, 0.09]], (10, 1, 1))
    measured = Estimates(estimates, covariances, estimates)
    others = [CoefficientModel.powers(logs[:1], np.full((1, 10), 4.0), False).some(0), CoefficientModel.left_out(10)]
    joint = JointModel.of(measured, others)
    several = CoefficientModel.powers(logs, np.array([[0.0], [1e-4], [0.01], [1.0]]) * np.ones(10), False)
    affine = CoefficientModel(
        np.concatenate([np.ones((4, 10, 1)), np.swapaxes(logs[:, np.newaxis], 1, 2)], axis=2),
        np.zeros((1, 10)), np.full((1, 10), 1e-4), False, np.array([0.0, 25.0]),
    )  # fmt: skip
    for tried in (several, affine):
        found = log_evidence(joint, 1, tried)
        expected = np.array([dense_log_evidence(joint, 1, tried.some(i), 1e3) for i in range(4)])
        np.testing.assert_allclose(np.diff(found), np.diff(expected), atol=2e-3)


def test_the_density_of_all_estimates_is_that_of_the_joint_normal_distribution():
    generator = np.random.default_rng(1)
    estimates, covariances = generator.normal(1, 0.2, (10, 2)), np.tile([[0.04, -0.03], [-0.03, 0.09]], (10, 1, 1))
    tried = CoefficientModel.powers(generator.normal(0, 0.5, (1, 10)), np.array([[0.1]]), False)
    other = CoefficientModel.powers(np.zeros((1, 10)), np.array([[0.0]]), False).some(0)
    measured = Estimates(estimates, covariances, estimates)
    left_out = JointModel.of(measured, [other, CoefficientModel.left_out(10)])
    found = JointModel.of(measured, [other, tried.some(0)]).log_evidence(np.zeros(2))
    expected = dense_log_evidence(left_out, 1, tried.some(0), 300.0) + 2 * np.log(300.0 * np.sqrt(2 * np.pi))
    assert found == pytest.approx(expected, abs=1e-3)


def test_scatter_is_looked_for_where_it_is_though_errors_hang_together():
    for seed in (0, 6, 11, 15):
        _, estimates, covariances, table = population(seed, error=0.05, scatter=0.1)
        gravity, drag = explain(estimates, covariances, table).relations
        assert (gravity.kind, drag.kind) == (RelationKind.UNIVERSAL, RelationKind.POWER_LAW)


def test_what_an_own_coefficient_says_of_another_is_the_conditional_normal_distribution():
    _, estimates, covariances, _ = population()
    joint = JointModel.of(
        Estimates(estimates, covariances, estimates),
        [
            CoefficientModel.left_out(10),
            CoefficientModel.powers(np.zeros((1, 10)), np.full((1, 10), 0.3), False).some(0),
        ],
    )
    mean, variance = joint.without(0)
    # The second coefficient is x = factor + scatter; with a vague factor, all objects in one normal distribution
    total = covariances.copy()
    total[:, 1, 1] += 0.3
    cross, vague = total[:, 0, 1], 1e4
    second = np.diag(total[:, 1, 1]) + vague
    gain = np.diag(cross) @ np.linalg.inv(second)
    np.testing.assert_allclose(mean, estimates[:, 0] - gain @ estimates[:, 1], rtol=1e-6)
    np.testing.assert_allclose(variance, np.diag(np.diag(total[:, 0, 0]) - gain @ np.diag(cross)), rtol=1e-6)


@pytest.mark.parametrize(("error", "scatter"), [(0.001, 0.0), (0.05, 0.0), (0.02, 0.1)])
def test_universal_coefficients_and_power_laws_are_told(error, scatter):
    truth, estimates, covariances, table = population(error=error, scatter=scatter)
    found = explain(estimates, covariances, table)
    gravity, drag = found.relations
    assert (gravity.kind, drag.kind) == (RelationKind.UNIVERSAL, RelationKind.POWER_LAW)
    assert dict(zip(drag.properties, drag.exponents, strict=True)) == {"diameter": 2, "mass": -1}
    assert abs(drag.factors[0] - 0.25) < 3 * drag.errors[0]
    assert drag.errors[0] == pytest.approx(np.sqrt(found.factor_covariance[1, 1]))
    assert abs(drag.scatter - scatter) <= 3 * drag.scatter_error
    np.testing.assert_allclose(found.estimates[:, 0], gravity.factors[0])
    own = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    better = np.sqrt(np.diagonal(found.covariances, axis1=1, axis2=2))
    assert np.all(better < 0.6 * own) or scatter
    assert np.mean(abs(found.estimates - truth) < 2.5 * better) > 0.9


def test_estimates_by_an_exact_relation_are_the_relation_and_hang_together_by_its_factor():
    _, estimates, covariances, table = population()
    found = explain(estimates, covariances, table)
    for k, relation in enumerate(found.relations):
        used = table.choose([table.names.index(name) for name in relation.properties])
        np.testing.assert_allclose(found.estimates[:, k], (relation.columns(used.values) @ relation.factors))
        ratio = np.sqrt(found.covariances[:, k, k]) / abs(found.estimates[:, k])
        np.testing.assert_allclose(ratio, relation.errors[0] / abs(relation.factors[0]))
    whole = found.shared_factors @ found.shared_factors.swapaxes(1, 2)
    np.testing.assert_allclose(whole, found.covariances)


@pytest.mark.parametrize("turn", [0, 1])
def test_units_of_properties_and_the_order_of_coefficients_and_objects_do_not_matter(turn):
    _, estimates, covariances, table = population(error=0.05)
    found = explain(estimates, covariances, table)
    units, order = np.array([1000.0, 1 / 28.35, 1.8]), np.roll(np.arange(10), 3)
    swap = [1, 0] if turn else [0, 1]
    changed = explain(
        estimates[order][:, swap], covariances[order][:, swap][:, :, swap],
        PropertyTable(table.names, (table.values * units)[order]),
    )  # fmt: skip
    np.testing.assert_allclose(changed.estimates[:, swap], found.estimates[order], rtol=1e-8)
    one, other = found.relations[1], changed.relations[swap[1]]
    assert (one.properties, one.exponents) == (other.properties, other.exponents)
    assert other.factors[0] == pytest.approx(one.factors[0] / units[0] ** 2 * units[1])
    assert other.probability == pytest.approx(one.probability)


def test_each_objects_own_coefficients_are_left_to_it():
    generator = np.random.default_rng(3)
    own = np.exp(generator.normal(np.log(0.15), 0.4, (10, 1)))
    estimates = own + 0.001 * generator.standard_normal((10, 1))
    values = np.exp(generator.normal(0, 0.7, (10, 3)))
    found = explain(estimates, np.full((10, 1, 1), 1e-6), PropertyTable(NAMES, values))
    (relation,) = found.relations
    assert relation.kind is RelationKind.OWN
    assert relation.scatter == pytest.approx(np.std(np.log(own)), rel=0.2)
    assert relation.factors[0] == pytest.approx(np.exp(np.mean(np.log(own))), rel=0.1)
    np.testing.assert_allclose(found.estimates, estimates, atol=1e-4)
    np.testing.assert_allclose(found.covariances, 1e-6, rtol=1e-2)


@pytest.mark.parametrize("scatter", [0.0, 0.3])
def test_coefficients_of_both_signs_are_affine_in_what_they_follow(scatter):
    generator = np.random.default_rng(4)
    values = generator.uniform([-3, 1], [3, 9], (12, 2))
    truth = -0.5 + 1.5 * values[:, :1] + scatter * generator.standard_normal((12, 1))
    estimates = truth + 0.05 * generator.standard_normal((12, 1))
    (found,) = explain(estimates, np.full((12, 1, 1), 0.05**2), PropertyTable(("charge", "mass"), values)).relations
    assert (found.kind, found.properties) == (RelationKind.AFFINE, ("charge",))
    assert np.all(abs(np.subtract(found.factors, [-0.5, 1.5])) < 3 * np.array(found.errors))
    assert (found.scatter > 0) == (scatter > 0)


def test_properties_that_say_nothing_are_seldom_taken():
    wrong = 0
    for seed in range(40):
        generator = np.random.default_rng(seed)
        truth = -0.12 * np.exp((seed % 2) * 0.3 * generator.standard_normal((8, 1)))
        estimates = truth + 0.01 * generator.standard_normal((8, 1))
        table = PropertyTable(("a", "b", "c"), np.exp(generator.normal(0, 0.6, (8, 3))))
        (found,) = explain(estimates, np.full((8, 1, 1), 1e-4), table).relations
        wrong += found.kind not in (RelationKind.UNIVERSAL, RelationKind.OWN)
    assert wrong <= 2


def test_properties_that_do_not_differ_or_are_not_there_explain_nothing():
    _, estimates, covariances, _ = population()
    for values in (np.empty((10, 0)), np.full((10, 1), 2.0)):
        found = explain(estimates, covariances, PropertyTable(NAMES[: values.shape[1]], values))
        assert [each.kind for each in found.relations] == [RelationKind.UNIVERSAL, RelationKind.OWN]


def test_simple_exponents_are_more_probable_and_all_together_certain():
    sets = exponent_sets(3, 2)
    assert np.exp(sets.log_prior).sum() == pytest.approx(1)
    alone = {
        Fraction(row[0]).limit_denominator(4): p
        for row, p in zip(sets.exponents, sets.log_prior, strict=True)
        if not row[1:].any()
    }
    prices = [alone[each] for each in map(Fraction, ("1", "2", "3", "4", "4/3", "5/3", "5/4"))]
    assert all(one > other for one, other in pairwise(prices))
    assert max(np.count_nonzero(sets.exponents, axis=1)) == 2
    for count, together in ((10, 3), (11, 2), (25, 2), (26, 1)):
        assert max(np.count_nonzero(exponent_sets(count, 3).exponents, axis=1)) == together


def test_what_estimates_cannot_tell_apart_is_rather_universal():
    generator = np.random.default_rng(0)
    kinds = []
    for _ in range(20):
        estimates = 0.1 + 0.1 * generator.standard_normal((10, 1))
        (found,) = explain(estimates, np.full((10, 1, 1), 0.01), PropertyTable((), np.empty((10, 0)))).relations
        kinds.append(found.kind)
    assert kinds.count(RelationKind.UNIVERSAL) >= 18
