"""Laws whose coefficients are drawn to their means over objects."""

from dataclasses import replace

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.errors import CommonlawError
from commonlaw.library import PolynomialLibrary, Variables
from tests.unit.estimates import measured


def law_of(objects=6, spread=0.05):
    _, estimates, covariances = measured(objects, spread, parameters=2)
    terms = PolynomialLibrary(2).bind(Variables(("x", "v"), (), "t"))
    coefficients = np.zeros((objects, 1, len(terms)))
    coefficients[:, 0, [terms.index("1"), terms.index("v")]] = estimates
    names = tuple(f"ball {o + 1}" for o in range(objects))
    return cl.Law(terms, cl.Schema(states=("x",)), 2, names, coefficients, uncertainty=cl.Uncertainty(covariances))


def test_the_mean_over_partially_pooled_objects_has_the_covariance_of_a_mean():
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
