"""Laws that say what decides their coefficients: from what they know of their objects to text, tables and files."""

import json
from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.hierarchy import PropertyTable, explain
from commonlaw.hierarchy.relation import dimensions_of
from commonlaw.law import average_law, from_json, pool_objects, relations_frame, to_json
from commonlaw.law.parameters import coefficient_units, standard_errors
from commonlaw.library import Variables
from tests.refusals import refused

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


def test_a_law_says_what_is_universal_and_what_follows_properties():
    law = falling().explain()
    assert law.equations(errors=False) == ("x'' = -9.934 + 0.2523 diameter^2/mass v^2",)
    assert str(law).splitlines()[0] == "x'' = -9.934 ± 0.069 + (0.2523 ± 0.0018) diameter^2/mass v^2"
    assert r"0.2523\, \frac{\mathrm{diameter}^{2}}{\mathrm{mass}}\, v^{2}" in law.to_latex(errors=False)
    table = relations_frame(law).set_index("term")
    assert table["kind"].to_dict() == {"1": "universal", "v^2": "power law"}
    assert table["unit"].to_dict() == {"1": "m/s²", "v^2": "kg/m³"}
    assert "v^2 in x'': power law of diameter^2/mass" in law.history[-1].choice
    assert "offered: diameter, mass" in law.history[-1].reason


def test_units_say_what_a_factor_is():
    law = falling().explain()
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
    values = [each["diameter"] ** 2 / each["mass"] for each in law.properties.values()]
    factor = law.uncertainty.explanation.relations[1].factors[0]
    np.testing.assert_allclose(law.coefficients[:, 0, place], factor * np.array(values))
    assert np.all(standard_errors(law)[:, law.support] < standard_errors(before)[:, before.support])
    np.testing.assert_allclose(
        average_law(law).uncertainty.covariance[0, 0, 0], law.uncertainty.explanation.covariance[0, 0]
    )
    assert law.select(OBJECTS[:2]).uncertainty.explanation.relations == law.uncertainty.explanation.relations
    assert average_law(law).uncertainty.explanation is None


def test_pooling_and_earlier_explanations_do_not_matter():
    law = falling(pooled=False).explain()
    for other in (falling().explain(), law.explain(), law.explain([]).explain()):
        np.testing.assert_allclose(other.coefficients, law.coefficients)


def test_without_properties_coefficients_are_universal_or_each_objects_own():
    law = falling().explain([])
    assert [str(each.kind) for each in law.uncertainty.explanation.relations] == ["universal", "own"]
    lines = str(law).splitlines()
    assert lines[0] == "x'' = -9.934 ± 0.069 + a v^2"
    assert lines[2].startswith("a is object-specific: typical value 0.0")
    assert [line.split()[:2] for line in lines[5:13]] == [name.split() for name in OBJECTS]


@pytest.mark.parametrize("scatter", [0.0, 0.3])
def test_an_explained_law_comes_back_from_its_file(scatter):
    law = falling(scatter).explain()
    again = from_json(to_json(law))
    assert str(again) == str(law)
    assert again.uncertainty.explanation.relations == law.uncertainty.explanation.relations
    np.testing.assert_array_equal(again.uncertainty.explanation.covariance, law.uncertainty.explanation.covariance)
    np.testing.assert_array_equal(again.uncertainty.unpooled.covariance, law.uncertainty.unpooled.covariance)
    np.testing.assert_array_equal(again.uncertainty.shared_factor, law.uncertainty.shared_factor)
    assert again.properties == law.properties


def test_a_file_whose_relations_are_damaged_is_refused():
    document = json.loads(to_json(falling().explain()))
    document["explanation"]["relations"][1]["exponents"] = ["1/0", "2"]
    with refused("law-exponents"):
        from_json(json.dumps(document))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda saved: saved["relations"].append(None), Diagnostic("relations-count", {"given": 3, "expected": 2})),
        (
            lambda saved: saved["covariance"].pop(),
            Diagnostic("law-table-size", {"table": "the covariance of its factors is", "rows": 2, "columns": 2}),
        ),
        (
            lambda saved: saved["covariance"][0].pop(),
            Diagnostic("law-table-size", {"table": "the covariance of its factors is", "rows": 2, "columns": 2}),
        ),
        (
            lambda saved: saved["relations"][1].update(exponents=["2"]),
            Diagnostic("relation-damaged", {"kind": "power law"}),
        ),
        (
            lambda saved: saved["relations"][0].update(errors=[-1]),
            Diagnostic("relation-damaged", {"kind": "universal"}),
        ),
        (lambda saved: saved["relations"][0].update(kind="affine", scatter=-1), "relation-damaged"),
        (lambda saved: saved["relations"][0].update(kind="magic"), "not-a-law"),
    ],
)
def test_relations_that_contradict_themselves_are_refused(change, message):
    document = json.loads(to_json(falling().explain()))
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
        np.testing.assert_allclose(bare.explain(given).coefficients, known.explain().coefficients)
    assert bare.explain(table).schema.units["diameter"] == "cm"


@pytest.mark.parametrize(
    ("change", "names", "message"),
    [
        ({}, ["weight"], Diagnostic("unknown-name", {"kind": "property", "name": "weight"})),
        ({}, ["colour"], Diagnostic("property-not-a-number", {"property": "colour"})),
        ({"uncertainty": cl.law.Uncertainty()}, ["mass"], "uncertainty-unknown"),
        (
            {"uncertainty": replace(falling().uncertainty, unpooled=None)},
            ["mass"],
            "own-coefficients-unknown",
        ),
    ],
)
def test_what_cannot_be_explained_is_refused(change, names, message):
    with refused(message):
        replace(falling(), **change).explain(names)


def test_one_object_and_terms_of_their_own_are_refused():
    law = falling(pooled=False)
    with refused("one-object-to-explain"):
        law.select(OBJECTS[:1]).explain()
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
    assert [str(each.kind) for each in explained.uncertainty.explanation.relations] == ["universal", "affine"]
    assert explained.uncertainty.explanation.relations[1].factors == pytest.approx((0.0, 1.0), abs=0.02)
    assert cl.refine(explained, drops).uncertainty.explanation is None
