"""What is said of the supports that a law was chosen from."""

import numpy as np

import commonlaw as cl
from commonlaw.inference import provenance
from commonlaw.inference.support_search import ComparedSupport
from commonlaw.library import PolynomialLibrary, Variables


def compared(supports, values, chosen=0):
    return [
        ComparedSupport(support, value, i == chosen)
        for i, (support, value) in enumerate(zip(supports, values, strict=True))
    ]


def test_probabilities_are_found_however_much_better_one_is():
    supports = [np.array([True, False]), np.array([True, True]), np.array([False, False])]
    listed = compared(supports, [5000.0, 0.0, np.inf])
    np.testing.assert_allclose(provenance.probabilities(listed), [0, 1, 0], atol=1e-300)
    np.testing.assert_allclose(provenance.inclusion_probabilities([listed]), [[1, 1]])
    even = compared(supports[:2], [0.0, 2 * np.log(3)])
    np.testing.assert_allclose(provenance.inclusion_probabilities([even]), [[1, 0.25]])


def test_the_chosen_support_is_listed_however_many_have_more_evidence():
    terms = PolynomialLibrary(2).bind(Variables(("x", "v")))
    law = cl.Law(terms, cl.Schema(states=("x",)), 2, ("ball",), np.zeros((1, 1, len(terms))))
    supports = [np.arange(len(terms)) == k for k in (1, 2, 3, 4, 5, 0)] * 3
    found = provenance.alternatives(law, [compared(supports, range(18), chosen=17)])
    assert [each.chosen for each in found] == [False] * 12 + [True]
    assert found[-1].terms == ("1",)
    assert found[-1].measures["2 log B"] == 17
