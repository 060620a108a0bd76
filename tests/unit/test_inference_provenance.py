"""What is said of the supports that a law was chosen from."""

import numpy as np

import commonlaw as cl
from commonlaw.inference import provenance
from commonlaw.library import PolynomialLibrary, Variables


def law_of_degree(degree):
    terms = PolynomialLibrary(degree).bind(Variables(("x", "v")))
    return cl.Law(terms, cl.Schema(states=("x",)), 2, ("ball",), np.zeros((1, 1, len(terms))))


def compared(listed, values, chosen=0):
    return [
        provenance.ComparedTerms(names, value, i == chosen)
        for i, (names, value) in enumerate(zip(listed, values, strict=True))
    ]


def test_probabilities_are_found_however_much_better_one_is():
    law, names = law_of_degree(1), [("1",), ("1", "x"), ()]
    listed = compared(names, [5000.0, 0.0, np.inf])
    np.testing.assert_allclose(provenance.probabilities(listed), [0, 1, 0], atol=1e-300)
    np.testing.assert_allclose(provenance.inclusion_probabilities(law, [listed]), [[1, 1, 0]])
    even = compared(names[:2], [0.0, 2 * np.log(3)])
    np.testing.assert_allclose(provenance.inclusion_probabilities(law, [even]), [[1, 0.25, 0]])


def test_the_chosen_support_is_listed_however_many_have_more_evidence():
    law = law_of_degree(2)
    names = [(law.terms.names[k],) for k in (1, 2, 3, 4, 5, 0)] * 3
    found = provenance.alternatives(law, [compared(names, range(18), chosen=17)])
    assert [each.chosen for each in found] == [False] * 12 + [True]
    assert found[-1].terms == ("1",)
    assert found[-1].measures["2 log B"] == 17
