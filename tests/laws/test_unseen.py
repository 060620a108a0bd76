"""How large absent coefficients could be, against least squares and simulated truths."""

import numpy as np
import pytest
from scipy.stats import t

import commonlaw as cl
from commonlaw.inference import bounds
from commonlaw.law.quantiles import upper_bound
from tests.refusals import refused

DROPS = cl.datasets.linear_drag(noise=0.05)


def test_a_bound_holds_the_share_that_it_says():
    found = upper_bound([0.3, -2.0, 0.0], [1.0, 0.5, 2.0], [5.0, np.inf, 30.0], 0.9)
    for bound, center, scale, degrees in zip(found, (0.3, -2.0, 0.0), (1.0, 0.5, 2.0), (5.0, 1e9, 30.0), strict=True):
        between = t.cdf([(-bound - center) / scale, (bound - center) / scale], degrees)
        assert between[1] - between[0] == pytest.approx(0.9, abs=1e-6)


def test_a_curvature_is_bounded_as_by_least_squares():
    """Heights of a falling body with a free start: a jerk term t beside gravity is a cubic in time."""
    random, times = np.random.default_rng(0), np.linspace(0, 2, 60)
    heights = 10 - 4.9 * times**2 + 0.1 * random.normal(size=60)
    trials = cl.Trials.from_arrays([times], [heights], object=["ball"], names=["x"])
    found = bounds(cl.fit("x'' = -g", trials, noise={"x": 0.1}), trials, ["t"]).bounds[0]
    columns = np.column_stack([times**3 / 6, np.ones(60), times, times**2 / 2])
    wanted, *_ = np.linalg.lstsq(columns, heights)
    assert found.coefficient == pytest.approx(wanted[0], rel=0.02)
    assert found.error == pytest.approx(0.1 * np.sqrt(np.linalg.inv(columns.T @ columns)[0, 0]), rel=0.02)
    assert found.effect == pytest.approx(2 * found.at_most)


def test_a_term_that_is_there_is_seen():
    drops = cl.datasets.linear_drag(noise=0.05, quadratic=-0.02)
    found = bounds(cl.fit("x'' = -g - c v", drops), drops, ["v^2"])
    assert any(each.seen for each in found.bounds)
    assert "excludes zero" in str(found)
    assert len(found.to_frame()) == len(drops.objects)


def test_all_absent_terms_of_the_library_are_bounded_by_default():
    law = cl.discover(DROPS, order=2, library="poly:2")
    found = bounds(law, DROPS)
    assert {each.term for each in found.bounds} == {*law.terms.names} - {"1", "v"}
    assert "Terms that are not in the law" in found._repr_html_()


def test_terms_in_the_law_and_terms_that_cannot_be_read_are_refused():
    law = cl.fit("x'' = -g - c v", DROPS)
    with refused("limit-of-present-term", term="v"):
        bounds(law, DROPS, ["v"])
    with refused("unknown-name"):
        bounds(law, DROPS, ["w^2"])
