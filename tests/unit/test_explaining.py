"""What decides coefficients: relations to properties, and pooling over objects."""

import json
import re
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.hierarchy import PropertyTable, RelationKind, explain, informative, shrink
from commonlaw.hierarchy.joint_model import CoefficientModel, Estimates, JointModel, log_evidence
from commonlaw.hierarchy.relation import dimensions_of, exponent_sets
from commonlaw.law import average_law, from_json, pool_objects, relations_frame, select_objects, to_json, to_latex
from commonlaw.law.parameters import coefficient_units, standard_errors
from commonlaw.law.pooling import by_properties
from commonlaw.law.population import with_objects_of, with_pooled_forecasts
from commonlaw.library import PolynomialLibrary, Variables
from tests.refusals import refused
from tests.unit.estimates import measured

OBJECTS = tuple(f"ball {i}" for i in range(1, 9))
UNITS = {"x": "m", "t": "s", "diameter": "m", "mass": "kg"}


def falling(scatter=0.0, pooled=True, units=UNITS):
    """Gravity and drag of eight balls with errors that hang together, and the balls' properties."""
    generator = np.random.default_rng(5)
    diameter, mass = np.exp(generator.uniform(*np.log([[0.04, 0.03], [0.25, 0.8]]), (8, 2))).T
    drag = 0.25 * diameter**2 / mass * np.exp(scatter * generator.standard_normal(8))
    terms = cl.library.PolynomialLibrary(2).bind(Variables(("x", "v")))
    truth = np.zeros((8, 1, len(terms)))
    truth[:, 0, 0], truth[:, 0, terms.names.index("v^2")] = -9.8, drag
    free = truth[:, 0][:, truth[0, 0] != 0]
    errors = 0.02 * abs(free)
    covariance = errors[:, :, np.newaxis] * errors[:, np.newaxis] * np.array([[1.0, -0.9], [-0.9, 1.0]])
    noise = np.matmul(np.linalg.cholesky(covariance), generator.standard_normal((8, 2, 1)))[..., 0]
    measured = truth.copy()
    measured[:, 0, truth[0, 0] != 0] += noise
    properties = {
        name: {"diameter": d, "mass": m, "colour": "red"} for name, d, m in zip(OBJECTS, diameter, mass, strict=True)
    }
    law = cl.Law(
        terms, cl.Schema(("x",), units=units), 2, OBJECTS, measured, cl.law.Uncertainty(covariance, noise=[0.01]),
        properties=properties,
    )  # fmt: skip
    return pool_objects(law) if pooled else law


@cache
def explained():
    """The law of these balls with its relations."""
    return falling().explain()


def test_a_law_says_what_is_universal_and_what_follows_properties():
    law = explained()
    assert law.equations(errors=False) == ("x'' = -9.934 + 0.2523 diameter^2/mass v^2",)
    assert str(law).splitlines()[0] == "x'' = -9.934 ± 0.069 + (0.2523 ± 0.0018) diameter^2/mass v^2"
    assert r"0.2523\, \frac{\mathrm{diameter}^{2}}{\mathrm{mass}}\, v^{2}" in to_latex(law, errors=False)
    table = relations_frame(law).set_index("term")
    assert table["kind"].to_dict() == {"1": "universal", "v^2": "power law"}
    assert table["unit"].to_dict() == {"1": "m/s²", "v^2": "kg/m³"}
    assert "v^2 in x'': power law of diameter^2/mass" in law.history[-1].choice
    assert "offered: diameter, mass" in law.history[-1].reason


def test_units_say_what_a_factor_is():
    law = explained()
    assert "the factor of v^2 has the unit kg/m³, that of a density" in str(law)
    missing = replace(law, schema=replace(law.schema, units={**UNITS, "mass": "s"}))
    assert "the factor of v^2 has the unit s/m³, which no common constant has: a property may be missing" in str(
        missing
    )
    without = replace(law, schema=replace(law.schema, units={"x": "m", "t": "s"}))
    assert "unit" not in str(without)
    pure = replace(law, schema=replace(law.schema, units={**UNITS, "diameter": "m^0.5", "mass": "km^2"}))
    assert "the coefficient of v^2 times mass/diameter^2 is a pi group" in str(pure)


def test_a_coefficient_without_a_unit_follows_properties_as_any_other():
    law = falling(units={**UNITS, "x": "1"}).explain()
    assert coefficient_units(law)["x''", "v^2"] == ""
    table = relations_frame(law).set_index("term")
    assert table["kind"]["v^2"] == "power law"
    assert table["unit"].to_dict() == {"1": "1/s²", "v^2": "kg/m²"}


def test_exponents_that_leave_a_factor_without_a_unit_are_more_probable():
    decay, dimensions = 1 / np.array([2.0, 3.0, 5.0, 9.0]), dimensions_of(["1/s"], {"a": "s^2", "b": "s"})
    # Both explain the coefficients alike, but only one leaves a number
    values = np.column_stack([decay**-1, decay**-1])
    found = []
    for table in (PropertyTable(("a", "b"), values), PropertyTable(("a", "b"), values, dimensions)):
        (relation,) = explain(decay[:, np.newaxis], (1e-4 * decay**2)[:, np.newaxis, np.newaxis], table).relations
        found.append(relation)
    assert found[1].properties == ("b",)
    assert found[1].probability > 1.5 * found[0].probability


def test_coefficients_become_what_relations_say_and_more_precise():
    before = falling(pooled=False)
    law = before.explain()
    (place,) = np.flatnonzero(law.support[0])[1:]
    values = [attribute["diameter"] ** 2 / attribute["mass"] for attribute in law.properties.values()]
    factor = law.uncertainty.explanation.relations[1].factors[0]
    np.testing.assert_allclose(law.coefficients[:, 0, place], factor * np.array(values))
    assert np.all(standard_errors(law)[:, law.support] < standard_errors(before)[:, before.support])
    np.testing.assert_allclose(
        average_law(law).uncertainty.covariance[0, 0, 0], law.uncertainty.explanation.covariance[0, 0]
    )
    assert select_objects(law, OBJECTS[:2]).uncertainty.explanation.relations == law.uncertainty.explanation.relations
    assert average_law(law).uncertainty.explanation is None


def test_pooling_and_earlier_explanations_do_not_matter():
    law = falling(pooled=False).explain()
    for other in (explained(), law.explain(), law.explain([]).explain()):
        np.testing.assert_allclose(other.coefficients, law.coefficients)


def test_without_properties_coefficients_are_universal_or_each_objects_own():
    law = falling().explain([])
    assert [str(relation.kind) for relation in law.uncertainty.explanation.relations] == ["universal", "own"]
    lines = str(law).splitlines()
    assert lines[0] == "x'' = -9.934 ± 0.069 + a v^2"
    assert lines[2].startswith("a is object-specific: typical value 0.0")
    assert [line.split()[:2] for line in lines[5:13]] == [name.split() for name in OBJECTS]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda saved: saved["relations"].append(None), Diagnostic("relations-count", {"given": 3, "expected": 2})),
        (lambda saved: saved["covariance"].pop(), Diagnostic("law-array-shape", {"array": "covariance of factors"})),
        (lambda saved: saved["covariance"][0].pop(), "not-a-law"),
        (lambda saved: saved["relations"][1].update(exponents=["2"]), "relation-damaged"),
        (lambda saved: saved["relations"][0].update(errors=[-1]), "relation-damaged"),
        (lambda saved: saved["relations"][0].update(kind="affine", scatter=-1), "relation-damaged"),
        (lambda saved: saved["relations"][0].update(kind="magic"), "not-a-law"),
    ],
)
def test_relations_that_contradict_themselves_are_refused(change, message):
    document = json.loads(to_json(explained()))
    change(document["explanation"])
    with refused(message):
        from_json(json.dumps(document))


def test_properties_can_be_given_when_the_law_knows_none(tmp_path):
    known = falling()
    bare = replace(known, properties={})
    with refused("properties-unknown"):
        bare.explain()
    table = tmp_path / "balls.csv"
    rows = [f"{name},{values['diameter']},{values['mass']}" for name, values in known.properties.items()]
    table.write_text("\n".join(["object,diameter [cm],mass", *rows]))
    for given in (known.properties, table):
        np.testing.assert_allclose(bare.explain(given).coefficients, explained().coefficients)
    assert bare.explain(table).schema.units["diameter"] == "cm"


@pytest.mark.parametrize(
    ("change", "names", "message"),
    [
        (lambda known: known, ["weight"], Diagnostic("unknown-name", {"kind": "property", "name": "weight"})),
        (lambda known: known, ["colour"], Diagnostic("property-not-a-number", {"property": "colour"})),
        (lambda _: cl.law.Uncertainty(), ["mass"], "uncertainty-unknown"),
        (lambda known: replace(known, unpooled=None), ["mass"], "own-coefficients-unknown"),
    ],
)
def test_what_cannot_be_explained_is_refused(change, names, message):
    with refused(message):
        replace(falling(), uncertainty=change(falling().uncertainty)).explain(names)


def test_one_object_and_terms_of_their_own_are_refused():
    law = falling(pooled=False)
    with refused("one-object-to-explain"):
        select_objects(law, OBJECTS[:1]).explain()
    coefficients = law.coefficients.copy()
    coefficients[0, 0, 0] = 0
    with refused("explain-own-terms"):
        replace(law, coefficients=coefficients).explain()
    with refused("relations-missing"):
        relations_frame(law)


def test_a_fitted_law_knows_the_properties_of_its_objects():
    drops = cl.datasets.linear_drag(noise=0.05)
    law = cl.fit("x'' = -g - c v", drops)
    assert law.properties == drops.properties
    explained = law.explain()
    assert [str(relation.kind) for relation in explained.uncertainty.explanation.relations] == ["universal", "affine"]
    assert explained.uncertainty.explanation.relations[1].factors == pytest.approx((0.0, 1.0), abs=0.02)
    assert cl.refine(explained, drops).uncertainty.explanation is None


def law_of(objects=6, spread=0.05):
    _, estimates, covariances = measured(objects, spread, parameters=2)
    terms = PolynomialLibrary(2).bind(Variables(("x", "v"), (), "t"))
    coefficients = np.zeros((objects, 1, len(terms)))
    coefficients[:, 0, [terms.index("1"), terms.index("v")]] = estimates
    names = tuple(f"ball {o + 1}" for o in range(objects))
    return cl.Law(terms, cl.Schema(states=("x",)), 2, names, coefficients, uncertainty=cl.law.Uncertainty(covariances))


def test_the_mean_over_partially_pooled_objects_has_the_covariance_of_a_mean():
    found = pool_objects(law_of())
    factor = found.uncertainty.shared_factor
    own = found.uncertainty.covariance - factor @ factor.transpose(0, 2, 1)
    mean = factor.mean(axis=0)
    expected = own.sum(axis=0) / 6**2 + mean @ mean.T
    np.testing.assert_allclose(average_law(found).uncertainty.covariance[0], expected)
    assert average_law(found).uncertainty.shared_factor is None
    some = select_objects(found, ["ball 2", "ball 5"])
    np.testing.assert_array_equal(some.uncertainty.shared_factor, found.uncertainty.shared_factor[[1, 4]])


def test_pooling_is_recorded_and_kept():
    found = pool_objects(law_of())
    assert found.history[-1].stage == "pooling"
    assert "v in x''" in found.history[-1].choice
    with refused("already-pooled"):
        pool_objects(from_json(to_json(found)))


def test_what_is_known_and_single_objects_stay():
    law = law_of()
    known = law.uncertainty.covariance.copy()
    known[:, 0] = known[:, :, 0] = 0
    fixed = pool_objects(replace(law, uncertainty=replace(law.uncertainty, covariance=known)))
    np.testing.assert_array_equal(fixed.coefficients[:, 0, 0], law.coefficients[:, 0, 0])
    np.testing.assert_array_equal(standard_errors(fixed)[:, 0, 0], 0)
    single = select_objects(law, ["ball 3"])
    assert pool_objects(single) is single
    with refused("uncertainty-unknown"):
        pool_objects(replace(law, uncertainty=replace(law.uncertainty, covariance=None)))


def plate(blanks, seed=0):
    """Growth in wells, and wells in which nothing grows."""
    source, times = np.random.default_rng(seed), np.arange(0, 12, 0.25)
    wells = [0.7 / (1 + 13 * np.exp(-rate * times)) for rate in (0.9, 1.0, 1.1, 1.2)]
    wells += [np.full(len(times), 0.1)] * blanks
    measured = [well + 0.002 * source.standard_normal(len(times)) for well in wells]
    names = [f"A{i}" for i in range(1, len(wells) + 1)]
    return cl.Trials.from_arrays([times] * len(wells), measured, object=names, names=["OD"])


def test_blanks_are_named_and_leave_the_pooling_of_the_other_wells_as_it_is():
    law = cl.fit("OD' = a + b OD + c OD^2", plate(2), errors="white", noise={"OD": 0.002})
    alone = cl.fit("OD' = a + b OD + c OD^2", plate(0), errors="white", noise={"OD": 0.002})
    np.testing.assert_allclose(law.coefficients[:4], alone.coefficients, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(standard_errors(law)[:4], standard_errors(alone), rtol=1e-6)
    named = [diagnostic for diagnostic in law.diagnostics if diagnostic.kind == "not identifiable"]
    assert len(named) == 1
    assert "2 objects (A5, A6)" in named[0].text
    assert not alone.diagnostics


def test_an_object_that_says_nothing_of_one_coefficient_changes_no_other():
    """As one whose input is never on: that coefficient is drawn to the mean of the others."""
    source = np.random.default_rng(1)
    covariances = np.tile(np.diag([1e-4, 1e-4]), (6, 1, 1))
    estimates = np.array([1.0, -2.0]) + 0.05 * source.standard_normal((6, 2))
    alone = shrink(estimates[:5], covariances[:5], np.full(2, np.nan))
    estimates[5, 1], covariances[5, 1, 1] = 3e5, 1e12
    found = shrink(estimates, covariances, np.full(2, np.nan))
    np.testing.assert_allclose(found.estimates[:5, 1], alone.estimates[:, 1], atol=1e-3)
    np.testing.assert_allclose(found.covariances[:5, 1, 1], alone.covariances[:, 1, 1], rtol=0.02)
    assert found.estimates[5, 1] == pytest.approx(-2, abs=0.1)
    np.testing.assert_array_equal(
        informative(estimates, np.diagonal(covariances, axis1=1, axis2=2)).sum(axis=0), [6, 5]
    )


def test_an_unseen_object_is_one_more_of_the_population_that_objects_with_information_are_of():
    law, times = law_of(), np.linspace(0, 1, 5)
    unseen = cl.Trials.from_arrays([times], [times**2], object=["ball 7"], names=["x"])
    expected, _ = with_objects_of(pool_objects(law), unseen)
    found, _ = with_objects_of(law, unseen)
    np.testing.assert_allclose(found.coefficients, expected.coefficients)
    np.testing.assert_allclose(found.uncertainty.covariance, expected.uncertainty.covariance)
    coefficients, covariances = (
        np.concatenate([each, each[:1]]) for each in (law.coefficients, law.uncertainty.covariance)
    )
    coefficients[-1] *= 1e6
    covariances[-1] *= 1e16
    blank = replace(
        law, objects=(*law.objects, "blank"), coefficients=coefficients, uncertainty=cl.law.Uncertainty(covariances)
    )
    found, _ = with_objects_of(blank, unseen)
    np.testing.assert_allclose(found.coefficients, expected.coefficients, rtol=1e-6)
    np.testing.assert_allclose(found.uncertainty.covariance, expected.uncertainty.covariance, rtol=1e-6)


def test_rates_and_simulations_follow_the_coefficients_that_forecasts_do():
    own = law_of()
    law, pooled = with_pooled_forecasts(own, np.zeros_like(own.support), True), pool_objects(own)
    np.testing.assert_array_equal(law.coefficients, own.coefficients)
    points = np.array([[1.0, 0.5], [0.2, -3.0]])
    np.testing.assert_allclose(law.rhs("ball 2", points), pooled.rhs("ball 2", points))
    assert abs(law.rhs("ball 2", points) - own.rhs("ball 2", points)).max() > 1e-3
    end, expected = (each.simulate([0, 1], [0, 1])["ball 2"].states[-1] for each in (law, pooled))
    np.testing.assert_allclose(end, expected)


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
    for seed in (0, 11):
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
    for seed in range(20):
        generator = np.random.default_rng(seed)
        truth = -0.12 * np.exp((seed % 2) * 0.3 * generator.standard_normal((8, 1)))
        estimates = truth + 0.01 * generator.standard_normal((8, 1))
        table = PropertyTable(("a", "b", "c"), np.exp(generator.normal(0, 0.6, (8, 3))))
        (found,) = explain(estimates, np.full((8, 1, 1), 1e-4), table).relations
        wrong += found.kind not in (RelationKind.UNIVERSAL, RelationKind.OWN)
    assert wrong <= 1


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


def test_results_show_coefficients_that_follow_from_properties_in_a_line():
    (line,) = by_properties(falling())
    assert re.fullmatch(r"by properties: x'' = -9\.\d+ ± [\d.]+ \+ \(0.25\d+ ± [\d.]+\) diameter\^2/mass v\^2", line)
    decoys = {
        name: {"digit": digit} for name, digit in zip(OBJECTS, (3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0), strict=True)
    }
    assert by_properties(replace(falling(), properties=decoys)) == []
    assert by_properties(replace(falling(), properties={})) == []
