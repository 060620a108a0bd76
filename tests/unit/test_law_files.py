"""Law files of strangers: what contradicts itself is refused, and what is a law comes back."""

import json

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.law import Law, Uncertainty

LAW = cl.datasets.linear_drag.truth()


def changed(**changes):
    return json.dumps(json.loads(LAW.to_json()) | changes)


REFUSED = {
    "no object": (changed(coefficients={}), "a law of no object says nothing"),
    "no term": (changed(terms=[], coefficients={"Ball 1": [[]]}), "a law of no term says nothing"),
    "rates in first order": (
        changed(order=1),
        "law of order 1 for x are over x, v, t; expected states and 0",
    ),
    "two rates for one state": (changed(rates=["v", "w"]), "over x, v, w, t; expected states and 1 rates"),
    "no rate": (changed(rates=[], terms=["1", "x"]), "over x, t; expected states and 1 rates"),
    "a rate called like time": (
        changed(rates=["t"], terms=["1", "x"]),
        "the name 't' stands for two variables",
    ),
    "nested without end": ("[" * 1_000_000, "not a law or it is damaged: JSON is nested 1000000 levels deep"),
    "nested in a field": (changed(schema=json.loads("[" * 99 + "]" * 99)), "nested 100 levels deep"),
    "no UTF-8": (LAW.to_json().encode().replace(b"Ball 1", b"Ball \xff"), r"JSON, line \d+: byte 0xff is not UTF-8"),
    "a number that is too large": ('{"format": "commonlaw law", "version": 1e999}', "Number out of range"),
    "nothing": ("", "not a law or it is damaged"),
}


@pytest.mark.parametrize(("content", "message"), REFUSED.values(), ids=REFUSED)
def test_a_law_that_cannot_be_is_refused(content, message):
    with pytest.raises(cl.CommonlawError, match=message):
        Law.from_json(content)


def test_a_law_without_any_term_in_its_support_comes_back():
    none = np.zeros((len(LAW.objects), 0, 0))
    found = Uncertainty(covariance=none, shared_factor=none, noise=np.ones(1))
    law = Law(LAW.terms, LAW.schema, 2, LAW.objects, np.zeros_like(LAW.coefficients), found)
    again = Law.from_json(law.to_json())
    assert again.covariance.shape == again.uncertainty.shared_factor.shape == none.shape
    assert str(again) == str(law)


def test_a_law_of_enormous_errors_comes_back_and_is_shown():
    size = int(LAW.support.sum())
    enormous = np.tile(1e308 * np.eye(size), (len(LAW.objects), 1, 1))
    found = Uncertainty(covariance=enormous, noise=np.ones(1))
    law = Law.from_json(Law(LAW.terms, LAW.schema, 2, LAW.objects, LAW.coefficients, found).to_json())
    np.testing.assert_array_equal(law.covariance, enormous)
    assert "10^{154}" in law.to_latex("Ball 1")
