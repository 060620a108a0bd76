"""How often the terms of a known law are found: shares, intervals, and what counts as found."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law import select_objects
from studies.falling_balls.recovery import Recovery, recovered


@pytest.mark.parametrize(("found", "tried"), [(0, 7), (1, 1), (3, 50), (50, 50)])
def test_intervals_hold_the_share(found, tried):
    low, high = Recovery(found, tried).interval()
    assert 0 <= low <= Recovery(found, tried).share <= high <= 1


def test_only_the_objects_with_exactly_the_true_terms_count_whatever_the_library():
    truth = cl.datasets.linear_drag.truth(drag=(-0.1, -0.3, -0.5))
    drops = cl.datasets.linear_drag(drag=(-0.1, -0.3, -0.5), noise=0.0)
    method = cl.DerivativeRegression(differentiation="finite:6", solver="group-stlsq:0.5")
    law = cl.discover(drops, order=2, library="poly:2", method=method)
    assert recovered(law, truth).all()
    coefficients = law.coefficients.copy()
    coefficients[0, 0, law.terms.index("x^2")] = 1e-9
    coefficients[1, 0, law.terms.index("v")] = 0.0
    changed = cl.Law(law.terms, law.schema, 2, law.objects, coefficients)
    np.testing.assert_array_equal(recovered(changed, truth), [False, False, True])
    assert not recovered(changed, truth).all()
    assert recovered(select_objects(changed, ["Ball 3"]), truth).all()


def test_the_equation_of_a_term_counts():
    law = cl.datasets.nonlinear_oscillator.truth()
    here, there = (cl.Law(law.terms, law.schema, 1, law.objects, law.coefficients * [each]) for each in (
        [[1, 0], [1, 1]], [[1, 1], [1, 0]]))  # fmt: skip
    assert recovered(here, here).all()
    assert not recovered(here, there).any()
