"""Laws whose coefficients are drawn to their means over objects."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.forecast.population import with_objects_of, with_pooled_forecasts
from commonlaw.hierarchy import informative, shrink
from commonlaw.law import average_law, from_json, pool_objects, to_json
from commonlaw.law.parameters import standard_errors
from commonlaw.library import PolynomialLibrary, Variables
from tests.refusals import refused
from tests.unit.estimates import measured


def law_of(objects=6, spread=0.05):
    _, estimates, covariances = measured(objects, spread, parameters=2)
    terms = PolynomialLibrary(2).bind(Variables(("x", "v"), (), "t"))
    coefficients = np.zeros((objects, 1, len(terms)))
    coefficients[:, 0, [terms.index("1"), terms.index("v")]] = estimates
    names = tuple(f"ball {o + 1}" for o in range(objects))
    return cl.Law(terms, cl.Schema(states=("x",)), 2, names, coefficients, uncertainty=cl.law.Uncertainty(covariances))


def test_the_mean_over_partially_pooled_objects_has_the_covariance_of_a_mean():
    law = law_of()
    found = pool_objects(law)
    draws = np.random.default_rng(1)
    own = found.uncertainty.covariance - np.matmul(
        found.uncertainty.shared_factor, found.uncertainty.shared_factor.transpose(0, 2, 1)
    )
    shared = np.matmul(found.uncertainty.shared_factor, draws.standard_normal((20000, 1, 2, 1)))[..., 0]
    alone = np.matmul(np.linalg.cholesky(own), draws.standard_normal((20000, 6, 2, 1)))[..., 0]
    expected = np.cov((shared + alone).mean(axis=1), rowvar=False)
    np.testing.assert_allclose(average_law(found).uncertainty.covariance[0], expected, rtol=0.05, atol=2e-4)
    assert average_law(found).uncertainty.shared_factor is None
    some = found.select(["ball 2", "ball 5"])
    np.testing.assert_array_equal(some.uncertainty.shared_factor, found.uncertainty.shared_factor[[1, 4]])


def test_pooling_is_recorded_and_kept():
    found = pool_objects(law_of())
    assert found.history[-1].stage == "pooling"
    assert "v in x''" in found.history[-1].choice
    again = from_json(to_json(found))
    np.testing.assert_array_equal(again.uncertainty.shared_factor, found.uncertainty.shared_factor)
    with refused("already-pooled"):
        pool_objects(again)


def test_what_is_known_and_single_objects_stay():
    law = law_of()
    known = law.uncertainty.covariance.copy()
    known[:, 0] = known[:, :, 0] = 0
    fixed = pool_objects(replace(law, uncertainty=replace(law.uncertainty, covariance=known)))
    np.testing.assert_array_equal(fixed.coefficients[:, 0, 0], law.coefficients[:, 0, 0])
    np.testing.assert_array_equal(standard_errors(fixed)[:, 0, 0], 0)
    single = law.select(["ball 3"])
    assert pool_objects(single) is single
    with refused("uncertainty-unknown"):
        pool_objects(replace(law, uncertainty=replace(law.uncertainty, covariance=None)))


def plate(blanks, seed=0):
    """Growth in wells, and wells in which nothing grows."""
    source, times = np.random.default_rng(seed), np.arange(0, 12, 0.25)
    wells = [0.7 / (1 + 13 * np.exp(-rate * times)) for rate in (0.9, 1.0, 1.1, 1.2)]
    wells += [np.full(len(times), 0.1)] * blanks
    measured = [own + 0.002 * source.standard_normal(len(times)) for own in wells]
    names = [f"A{i}" for i in range(1, len(wells) + 1)]
    return cl.Trials.from_arrays([times] * len(wells), measured, object=names, names=["OD"])


def test_blanks_are_named_and_leave_the_pooling_of_the_other_wells_as_it_is():
    law = cl.fit("OD' = a + b OD + c OD^2", plate(2), errors="white", noise={"OD": 0.002})
    alone = cl.fit("OD' = a + b OD + c OD^2", plate(0), errors="white", noise={"OD": 0.002})
    np.testing.assert_allclose(law.coefficients[:4], alone.coefficients, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(standard_errors(law)[:4], standard_errors(alone), rtol=1e-6)
    named = [each for each in law.diagnostics if each.kind == "not identifiable"]
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
