"""Differences between groups of objects."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t, ttest_ind

import commonlaw as cl
from commonlaw.law.pooling import comparable_groups
from tests.known_laws import known
from tests.refusals import refused

RATES = np.array([0.41, 0.47, 0.44, 0.60, 0.71, 0.66, 0.58])
DRUGS = ["none"] * 3 + ["high"] * 4


def law_of(rates, errors, drugs):
    """Return a law of decay whose rates have these standard errors."""
    objects = tuple(f"cell {i}" for i in range(len(rates)))
    law = known("x' = -k x", {"k": 1.0}, [[1.0]], objects=objects)
    covariance = np.array(errors)[:, np.newaxis, np.newaxis] ** 2
    properties = {name: {"drug": drug} for name, drug in zip(objects, drugs, strict=True)}
    coefficients = -np.array(rates)[:, np.newaxis, np.newaxis] * np.ones_like(law.coefficients)
    uncertainty = replace(law.uncertainty, covariance=covariance)
    return replace(law, coefficients=coefficients, uncertainty=uncertainty, properties=properties)


def test_between_objects_that_scatter_it_is_the_t_test():
    row = cl.law.contrasts(law_of(RATES, np.full(7, 1e-4), DRUGS), "drug", "none").iloc[0]
    test = ttest_ind(RATES[3:], RATES[:3])
    low, high = test.confidence_interval(0.95)
    assert [row["low"], row["high"]] == pytest.approx([low, high], rel=1e-5)
    assert row["difference"] / row["standard error"] == pytest.approx(test.statistic, rel=1e-5)


def test_between_objects_that_are_alike_it_is_that_of_weighted_means():
    errors = np.array([0.2, 0.1, 0.3, 0.2, 0.4, 0.2, 0.1])
    row = cl.law.contrasts(law_of(RATES, errors, DRUGS), "drug").iloc[0]
    means = [np.average(RATES[part], weights=errors[part] ** -2) for part in (slice(3, 7), slice(0, 3))]
    error = np.sqrt(sum(1 / np.sum(errors[part] ** -2) for part in (slice(3, 7), slice(0, 3))))
    assert (row["value"], row["reference"]) == ("none", "high")
    assert row["difference"] == pytest.approx(means[1] - means[0])
    assert row["standard error"] == pytest.approx(error)
    assert row["high"] - row["difference"] == pytest.approx(t.isf(0.025, 5) * error)


@pytest.mark.parametrize("rates", [(0.71, 0.32), (0.47, 0.82), (0.63, 0.9)])
def test_one_degree_of_freedom_and_next_to_no_errors_leave_the_scatter(rates):
    law = law_of([*rates, np.mean(rates)], [1e-10, 2e-10, 1e-10], ["none", "none", "high"])
    row = cl.law.contrasts(law, "drug", "none").iloc[0]
    scatter = np.std(rates, ddof=1)
    assert row["difference"] == pytest.approx(0.0, abs=1e-12)
    assert row["standard error"] == pytest.approx(scatter * np.sqrt(1 + 1 / 2))


def test_intervals_hold_with_scatter_and_errors():
    rng, held = np.random.default_rng(0), []
    for _ in range(300):
        errors = rng.uniform(0.02, 0.1, 8)
        rates = np.repeat([0.5, 0.8], 4) + 0.06 * rng.standard_normal(8) + errors * rng.standard_normal(8)
        row = cl.law.contrasts(law_of(rates, errors, ["a"] * 4 + ["b"] * 4), "drug").iloc[0]
        held.append(row["low"] < 0.3 < row["high"])
    assert 0.92 < np.mean(held) < 0.99


def test_pooled_laws_are_compared_by_the_estimates_of_their_objects():
    law = law_of(RATES, np.full(7, 0.1), DRUGS)
    pooled = cl.law.pool_objects(law)
    assert np.ptp(pooled.coefficients) < 0.9 * np.ptp(law.coefficients)
    pd.testing.assert_frame_equal(cl.law.contrasts(pooled, "drug"), cl.law.contrasts(law, "drug"))


def test_properties_that_many_objects_have_in_common_divide_them_into_groups():
    law = law_of(RATES, np.full(7, 0.1), DRUGS)
    assert comparable_groups(law) == {"drug": ["high", "none"]}
    own = {name: {"drug": DRUGS[i], "dose": i // 2, "mass": i} for i, name in enumerate(law.objects)}
    assert [*comparable_groups(replace(law, properties=own))] == ["drug"]  # Four doses of seven objects


def test_groups_that_cannot_be_compared_are_refused():
    with refused("contrast-groups", groups=1):
        cl.law.contrasts(law_of(RATES, np.full(7, 0.1), ["none"] * 7), "drug")
    law = law_of(RATES, np.full(7, 0.1), DRUGS)
    with refused("property-missing", object=law.objects[0]):
        cl.law.contrasts(replace(law, properties={name: law.properties[name] for name in law.objects[1:]}), "drug")
    with refused("contrast-groups", groups=7):
        cl.law.contrasts(law_of(RATES, np.full(7, 0.1), [*"abcdefg"]), "drug")
    with refused("unknown-name"):
        cl.law.contrasts(law_of(RATES, np.full(7, 0.1), DRUGS), "dose")
    with refused("contrast-without-errors", parameter="k"):
        cl.law.contrasts(replace(law_of(RATES, np.full(7, 0.1), DRUGS), uncertainty=cl.law.Uncertainty()), "drug")
