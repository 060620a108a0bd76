"""Laws that were saved by earlier versions are still read."""

import json
from pathlib import Path

import numpy as np
import pytest

from commonlaw.differentiation import parse_differentiation
from commonlaw.law import Law, Uncertainty, from_json, to_json
from tests.refusals import refused

SAVED = Path(__file__).parent / "laws"
"""A law of two balls as version 2 wrote it; in version 1 laws knew neither their uncertainty nor their history."""


def test_a_law_of_version_2_is_read_whole():
    law = Law.load(SAVED / "version-2.json")
    raw = json.loads((SAVED / "version-2.json").read_text())
    assert law.objects == ("Ball 1", "Ball 2")
    assert law.terms.names == ("1", "x", "v", "x^2", "x v", "v^2")
    assert law.coefficients.tolist() == list(raw["coefficients"].values())
    assert law.provenance.differentiation == parse_differentiation("savgol:35:3")
    a, ab, b = raw["covariance"]["Ball 2"]
    assert law.uncertainty.covariance[1].tolist() == [[a, ab], [ab, b]]
    assert law.uncertainty.shared_factor.tolist() == list(raw["common"].values())
    assert law.uncertainty.noise.tolist() == raw["noise"]
    assert law.uncertainty.inclusion_probabilities.tolist() == raw["inclusion"]
    assert [(each.stage, each.choice, each.reason) for each in law.history] == [
        (each["stage"], each["choice"], each["reason"]) for each in raw["history"]
    ]


@pytest.mark.parametrize("version", [1, 2])
def test_names_of_earlier_versions_are_replaced(version):
    law = Law.load(SAVED / f"version-{version}.json")
    assert [each.kind for each in law.diagnostics] == ["model error"]
    first, second, constant = law.provenance.alternatives
    assert first.measures["2 log B"] == 0
    assert second.measures["2 log B"] > 4
    assert constant.measures == {"BIC": 3.5, "stability": None}
    assert constant.hyperparameters == ((0.5, 2.0) if version == 2 else ())
    again = from_json(to_json(law))
    assert (again.diagnostics, again.provenance.alternatives, again.history) == (
        law.diagnostics,
        law.provenance.alternatives,
        law.history,
    )
    np.testing.assert_array_equal(again.coefficients, law.coefficients)


def test_bayes_factors_against_the_chosen_become_those_against_the_best():
    raw = json.loads((SAVED / "version-2.json").read_text())
    raw["alternatives"][1]["measures"]["evidence lost"] = -3.0
    first, second, _ = from_json(json.dumps(raw)).provenance.alternatives
    assert (first.measures["2 log B"], second.measures["2 log B"]) == (3.0, 0.0)


def test_a_law_of_version_1_does_not_know_how_accurate_it_is():
    law = Law.load(SAVED / "version-1.json")
    assert law.uncertainty.covariance is law.uncertainty.noise is law.uncertainty.inclusion_probabilities is None
    assert law.uncertainty.shared_factor == Uncertainty().shared_factor
    assert law.history == ()
    np.testing.assert_array_equal(law.coefficients, Law.load(SAVED / "version-2.json").coefficients)


@pytest.mark.parametrize(
    "damage",
    [
        {"outcomes": 3},
        {"outcomes": ["diverged"]},
        {"outcomes": [{"kind": "unheard of", "where": "", "text": "", "remedy": ""}]},
        {"alternatives": [{"measures": 1}]},
        {"covariance": 1.0},
        {"noise": ["x"]},
        {"surplus": 1},
    ],
)
def test_a_damaged_law_of_version_2_is_refused(damage):
    raw = json.loads((SAVED / "version-2.json").read_text())
    with refused("not-a-law"):
        from_json(json.dumps(raw | damage))


def test_a_factor_of_all_intervals_becomes_a_widening_at_every_horizon():
    raw = json.loads(to_json(Law.load(SAVED / "version-2.json")))
    for factor in (1.0, 2.5):
        raw["uncertainty"]["error_model"] = {"widening": factor}
        other = {"uncertainty": raw["uncertainty"], "coefficients": {"Ball 1": [-9.0, -0.1], "Ball 2": [-9.0, -0.2]}}
        raw["other_laws"] = [other | {"probability": 0.2, "support": [[0, 2]]}]
        raw["with_discrepancy"] = {name: each for name, each in raw.items() if name != "other_laws"}
        raw["with_discrepancy"] = json.loads(json.dumps(raw["with_discrepancy"])) | {"with_discrepancy": None}
        law = from_json(json.dumps(raw))
        for each in (law, law.uncertainty.other_laws[0].law, law.provenance.with_discrepancy):
            found = each.uncertainty
            assert not found.error_model
            widths = np.ones(2) if found.widening is None else found.widening.at(np.array([0.0, 100.0]))
            assert widths.tolist() == [factor, factor]
