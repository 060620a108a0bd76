"""What is said of the supports that a law was chosen from."""

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.inference.result import history
from commonlaw.inference.score.score import Kind
from commonlaw.law.tables import LOG_SCORE
from commonlaw.library import PolynomialLibrary, Variables


def law_of_degree(degree):
    terms = PolynomialLibrary(degree).bind(Variables(("x", "v")))
    return cl.Law(terms, cl.Schema(states=("x",)), 2, ("ball",), np.zeros((1, 1, len(terms))))


def test_probabilities_are_found_however_much_better_one_is():
    law, names = law_of_degree(1), [("1",), ("1", "x"), ()]
    listed = dict(zip(names, [5000.0, 0.0, np.inf], strict=True))
    np.testing.assert_allclose(history.probabilities(listed), [0, 1, 0], atol=1e-300)
    np.testing.assert_allclose(history.inclusion_probabilities(law, [listed]), [[1, 1, 0]])
    even = dict(zip(names[:2], [0.0, 2 * np.log(3)], strict=True))
    np.testing.assert_allclose(history.inclusion_probabilities(law, [even]), [[1, 0.25, 0]])


def test_candidates_are_ranked_by_what_chose_among_them():
    law = law_of_degree(1)
    listed = [{("1",): 0.0, ("x",): 6.0, ("v",): np.inf}]
    by_evidence = history.alternatives(law, listed, Kind.EVIDENCE)
    assert [each.measures["2 log B"] for each in by_evidence] == [0, 6, np.inf]
    assert by_evidence[1].measures["probability"] == pytest.approx(1 / (1 + np.exp(3)))
    by_forecasts = history.alternatives(law, listed, Kind.FORECASTS)
    assert [by_forecast.measures for by_forecast in by_forecasts] == [{LOG_SCORE: 0}, {LOG_SCORE: 3}, {LOG_SCORE: None}]


def test_probabilities_are_no_denormal_numbers():
    (_, other) = history.alternatives(law_of_degree(1), [{("1",): 0.0, ("x",): 1450.0}], Kind.EVIDENCE)
    assert other.measures["probability"] == 0
