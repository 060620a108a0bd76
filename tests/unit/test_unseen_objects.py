"""Forecasts of objects that a law has never seen: by their properties, or as the typical object."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law.parameters import standard_errors
from commonlaw.law.population import is_typical, with_objects_of
from tests.refusals import refused

DRAGS = [0.1, 0.2, 0.3, 0.5, 0.7, 0.4]


@pytest.fixture(scope="module")
def drops():
    """Six balls with drag by mass, the last for forecasts."""
    drops = cl.datasets.linear_drag(noise=0.02, drag=tuple(-each for each in DRAGS))
    masses = {name: {"mass": 0.03 / each} for name, each in zip(drops.objects, DRAGS, strict=True)}
    return replace(drops, properties=masses, schema=replace(drops.schema, units={**drops.schema.units, "mass": "kg"}))


@pytest.fixture(scope="module")
def law(drops):
    return cl.fit("x'' = -g - c v", drops.select(object=drops.objects[:5]), errors="white").explain()


def test_coefficients_of_an_unseen_object_are_what_its_properties_give(drops, law):
    unseen = drops.select(object="Ball 6")
    found, (note,) = with_objects_of(law, unseen)
    assert note == "Ball 6 is not in the law: it has the coefficients that follow from its mass"
    assert not is_typical(law, "Ball 6", unseen)
    gravity, drag = law.uncertainty.explanation.relations
    np.testing.assert_allclose(
        found.coefficients[0, 0][found.support[0]], [gravity.factors[0], drag.factors[0] / 0.075]
    )
    turn = np.diag([1, 1 / 0.075])
    np.testing.assert_allclose(
        found.uncertainty.covariance[0], turn @ law.uncertainty.explanation.covariance @ turn, rtol=1e-9
    )
    forecast = law.predict(unseen, return_std=True)
    assert forecast.trials.notes[-1] == note
    assert forecast.score() > 0.999
    inside = abs(forecast.trajectories[0].states[:, :1] - unseen[0].states) < forecast.margins(measured=True)[0]
    assert inside.mean() > 0.85


def test_properties_in_another_unit_are_converted_and_others_refused(drops, law):
    unseen = drops.select(object="Ball 6")
    grams = replace(
        unseen,
        properties={"Ball 6": {"mass": 75.0}},
        schema=replace(unseen.schema, units={**unseen.schema.units, "mass": "g"}),
    )
    np.testing.assert_allclose(
        with_objects_of(law, grams)[0].coefficients, with_objects_of(law, unseen)[0].coefficients
    )
    metres = replace(grams, schema=replace(grams.schema, units={**grams.schema.units, "mass": "m"}))
    with refused("units-incompatible", name="mass", unit="m", law_unit="kg"):
        law.predict(metres)
    none = replace(unseen, properties={"Ball 6": {"mass": -1.0}})
    with refused("property-not-positive", property="mass", object="Ball 6", value=-1.0):
        law.predict(none)


def test_an_object_whose_properties_are_not_known_is_the_typical_one(drops, law):
    bare = replace(drops.select(object="Ball 6"), properties={})
    for each, why in (
        (law, ", as its mass is not known"),
        (replace(law, uncertainty=replace(law.uncertainty, explanation=None)), ""),
    ):
        forecast = each.predict(bare, return_std=True)
        assert forecast.trials.notes[-1] == f"Ball 6 is not in the law: it has the mean coefficients of the others{why}"
        found, _ = with_objects_of(each, bare)
        np.testing.assert_allclose(found.coefficients[0], law.coefficients.mean(axis=0))
        assert standard_errors(found)[0, 0, 1:].max() > np.std(law.coefficients[:, 0, 1:], axis=0).max()


def test_the_bands_of_an_unseen_object_carry_the_scatter_between_objects(drops):
    generator = np.random.default_rng(2)
    law = cl.fit("x'' = -g - c v", drops.select(object=drops.objects[:5]), errors="white").explain([])
    own = law.uncertainty.explanation.relations[1]
    assert str(own.kind) == "own"
    found, _ = with_objects_of(law, drops.select(object="Ball 6"))
    value, error = (each[0][found.support][1] for each in (found.coefficients, standard_errors(found)))
    # The mean of draws from the population, and what holds 95 % of them where the scatter is drawn as well
    spread = np.hypot(own.scatter, own.scatter_error)
    drawn = own.factors[0] * np.exp(spread * generator.standard_normal(400_000))
    assert value == pytest.approx(drawn.mean(), rel=0.03)
    doubt = np.sqrt(np.log1p((own.scatter_error / own.scatter) ** 2))
    scatters = own.scatter * np.exp(doubt * generator.standard_normal(400_000))
    reach = np.quantile(abs(scatters * generator.standard_normal(400_000)), 0.95) / 1.96
    drawn = np.exp(reach * generator.standard_normal(400_000))
    of_scatter = value * drawn.std() / drawn.mean()
    assert error == pytest.approx(np.hypot(of_scatter, own.errors[0] * value / own.factors[0]), rel=0.05)
    assert reach > 1.1 * spread


def test_known_and_unseen_objects_are_forecast_together(drops, law):
    forecast = law.predict(drops, return_std=True)
    assert [note.split(" ")[1] for note in forecast.trials.notes if "not in the law" in note] == ["6"]
    alone = law.predict(drops.select(object=drops.objects[:5]), return_std=True)
    for one, other in zip(alone.std, forecast.std[: len(alone.std)], strict=True):
        np.testing.assert_allclose(one, other)
    verdict = law.assess(drops, drops.select(object=drops.objects[:5]))
    assert verdict.unknown_objects == ()
    assert verdict.usable
