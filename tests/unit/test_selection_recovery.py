"""How often the terms of a known law are found: shares, intervals, and what counts as found."""

import numpy as np
import pytest
from scipy.stats import binomtest

import commonlaw as cl
from commonlaw.errors import CommonlawError
from commonlaw.selection import Recovery, recovered, recovers


@pytest.mark.parametrize(("found", "tried"), [(0, 7), (1, 1), (3, 50), (45, 50), (50, 50)])
@pytest.mark.parametrize("level", [0.5, 0.95, 0.999])
def test_intervals_are_those_of_wilson_and_hold_the_share(found, tried, level):
    recovery = Recovery(found, tried)
    low, high = recovery.interval(level)
    expected = binomtest(found, tried).proportion_ci(level, method="wilson")
    assert (low, high) == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert 0 <= low <= recovery.share <= high <= 1


@pytest.mark.parametrize(("found", "tried"), [(0, 0), (-1, 3), (4, 3)])
def test_counts_that_cannot_be_are_refused(found, tried):
    with pytest.raises(CommonlawError, match=f"{found} found of {tried} tried: try at least once"):
        Recovery(found, tried)


@pytest.mark.parametrize("level", [0.0, 1.0, 95.0])
def test_levels_that_are_no_confidence_are_refused(level):
    with pytest.raises(CommonlawError, match=f"level is {level:g}: give a confidence between 0 and 1"):
        Recovery(1, 2).interval(level)


def test_only_the_objects_with_exactly_the_true_terms_count_whatever_the_library():
    truth = cl.datasets.linear_drag.truth(drag=(-0.1, -0.3, -0.5))
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.3, -0.5), noise=0.0)
    law = cl.discover(
        drops,
        order=2,
        library="poly:2",
        method=cl.DerivativeRegression(differentiation="finite:6", solver="group-stlsq:0.5"),
    )
    assert recovers(law, truth)
    coefficients = law.coefficients.copy()
    coefficients[0, 0, law.terms.index("x^2")] = 1e-9
    coefficients[1, 0, law.terms.index("v")] = 0.0
    changed = cl.Law(law.terms, law.schema, 2, law.objects, coefficients)
    np.testing.assert_array_equal(recovered(changed, truth), [False, False, True])
    assert not recovers(changed, truth)
    assert recovers(changed.select(["Ball 3"]), truth)


def test_the_equation_of_a_term_counts():
    law = cl.datasets.nonlinear_oscillator.truth()
    here, there = (cl.Law(law.terms, law.schema, 1, law.objects, law.coefficients * [each]) for each in (
        [[1, 0], [1, 1]], [[1, 1], [1, 0]]))  # fmt: skip
    assert recovers(here, here)
    assert not recovers(here, there)


def test_laws_of_other_objects_or_equations_are_refused():
    truth = cl.datasets.linear_drag.truth()
    with pytest.raises(CommonlawError, match="unknown object of this law 'Ball 3'"):
        recovered(truth, cl.datasets.linear_drag.truth(drag=(-0.1, -0.2)))
    with pytest.raises(CommonlawError, match=r"the law gives x'', the true law x', y'; compare laws of the same"):
        recovered(truth, cl.datasets.nonlinear_oscillator.truth())
