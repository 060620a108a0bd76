"""Saved laws, of this version and of earlier ones; what no file may hold is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.cli.output import Artifacts
from commonlaw.diagnostics import Diagnostic
from commonlaw.differentiation import parse_differentiation
from commonlaw.law import Alternative, Law, PlausibleLaw, Provenance, Uncertainty, from_json, to_json, to_latex
from commonlaw.law.io import file_content
from commonlaw.law.law import with_other_laws
from commonlaw.law.uncertainty import IntervalInflation
from commonlaw.trials.files import parquet_bytes, parquet_columns
from tests.refusals import refused

LAW = cl.datasets.linear_drag.truth()


def changed(**changes):
    return json.dumps(json.loads(to_json(LAW)) | changes)


REFUSED = {
    "no object": (changed(coefficients={}), Diagnostic("law-empty", {"part": "object"})),
    "no term": (changed(terms=[], coefficients={"Ball 1": [[]]}), Diagnostic("law-empty", {"part": "term"})),
    "rates in first order": (changed(order=1), Diagnostic("law-terms-variables", {"order": "1", "rates": 0})),
    "two rates for one state": (changed(rates=["v", "w"]), Diagnostic("law-terms-variables", {"rates": 1})),
    "no rate": (changed(rates=[], terms=["1", "x"]), Diagnostic("law-terms-variables", {"rates": 1})),
    "a rate called like time": (changed(rates=["t"], terms=["1", "x"]), Diagnostic("variable-twice", {"name": "t"})),
    "nested without end": ("[" * 1_000_000, Diagnostic("json-too-deep", {"depth": 1000000})),
    "nested in a field": (changed(schema=json.loads("[" * 99 + "]" * 99)), Diagnostic("json-too-deep", {"depth": 100})),
    "no UTF-8": (to_json(LAW).encode().replace(b"Ball 1", b"Ball \xff"), Diagnostic("not-utf-8", {"source": "JSON"})),
    "a number that is too large": ('{"format": "commonlaw law", "version": 1e999}', "json-syntax"),
    "nothing": ("", "json-syntax"),
}


@pytest.mark.parametrize(("content", "message"), REFUSED.values(), ids=REFUSED)
def test_a_law_that_cannot_be_is_refused(content, message):
    with refused(message):
        from_json(content)


def test_a_law_without_any_term_in_its_support_comes_back():
    none = np.zeros((len(LAW.objects), 0, 0))
    found = Uncertainty(covariance=none, shared_factor=none, noise=np.ones(1))
    law = Law(LAW.terms, LAW.schema, 2, LAW.objects, np.zeros_like(LAW.coefficients), found)
    again = from_json(to_json(law))
    assert again.uncertainty.covariance.shape == again.uncertainty.shared_factor.shape == none.shape
    assert str(again) == str(law)


def test_a_law_of_enormous_errors_comes_back_and_is_shown():
    size = int(LAW.support.sum())
    enormous = np.tile(1e154 * np.eye(size), (len(LAW.objects), 1, 1))
    found = Uncertainty(covariance=enormous, noise=np.ones(1))
    law = from_json(to_json(Law(LAW.terms, LAW.schema, 2, LAW.objects, LAW.coefficients, found)))
    np.testing.assert_array_equal(law.uncertainty.covariance, enormous)
    assert "10^{77}" in to_latex(law, "Ball 1")


@pytest.fixture(scope="module")
def explained_law():
    """A law with everything that a file keeps by object: pooling, relations, properties, what else it could be."""
    drops = cl.datasets.linear_drag(noise=0.05)
    law, other = (cl.fit(text, drops) for text in ("x'' = a + b v", "x'' = a + b v + c x"))
    alternatives = Alternative("x''", ("1", "v"), {"2 log B": 0.0}, proven=True, chosen=True)
    law = replace(
        law,
        provenance=replace(law.provenance, alternatives=(alternatives,)),
        uncertainty=replace(
            law.uncertainty, interval_inflation=IntervalInflation(np.array([1.0, 2.0]), np.array([1.1, 1.2]))
        ),
    )
    law = with_other_laws(law, (PlausibleLaw(0.2, replace(other, provenance=Provenance())),))
    masses = {name: {"mass": mass, "make": "A"} for name, mass in zip(drops.objects, (3, 1, 1, 0.6, 0.4), strict=True)}
    return law.explain({**masses})


def edited(document, place, value):
    """The document with one number changed, and its place as messages write it."""
    *outer, last = place
    part = document
    for key in outer:
        part = part[key]
    part[last] = value
    return json.dumps(document), "$" + "".join(f"[{key!r}]" for key in place)


@pytest.mark.parametrize("value", [1e308, -1e308, 1e160, 10**200])
@pytest.mark.parametrize(
    "place",
    [
        ("coefficients", "Ball 2", 0, 0),
        ("uncertainty", "covariance", "Ball 1", 1),
        ("uncertainty", "shared_factor", "Ball 1", 0, 0),
        ("uncertainty", "noise", 0),
        ("uncertainty", "unpooled", "covariance", "Ball 3", 2),
        ("uncertainty", "interval_inflation", "factors", 0),
        ("properties", "Ball 1", "mass"),
        ("explanation", "relations", 0, "factors", 0),
        ("provenance", "domain", "visited", "x", 1),
        ("provenance", "alternatives", 0, "measures", "2 log B"),
        ("other_laws", 0, "uncertainty", "covariance", "Ball 1", 0),
        ("with_discrepancy", "coefficients", "Ball 1", 0, 0),
    ],
)
def test_a_number_that_cannot_be_computed_with_is_refused_by_its_place(explained_law, place, value):
    document = json.loads(to_json(explained_law))
    document["with_discrepancy"] = json.loads(to_json(explained_law)) | {"other_laws": []}
    content, where = edited(document, place, value)
    with refused("law-number-too-large", place=where.removeprefix("$")):
        from_json(content)


@pytest.mark.parametrize("name", ["law.json", "law.parquet"])
def test_a_law_that_would_be_refused_is_not_written(tmp_path, name):
    law = Law(LAW.terms, LAW.schema, 2, LAW.objects, 1e308 * np.sign(LAW.coefficients))
    (tmp_path / name).write_text("before")
    with refused("law-number-too-large"):
        law.save(tmp_path / name)
    assert (tmp_path / name).read_text() == "before"


def test_estimates_too_unlike_to_be_compared_are_refused(explained_law):
    for value in (1e15, 1e60, 1e150):
        content, _ = edited(
            json.loads(to_json(explained_law)), ("uncertainty", "unpooled", "covariance", "Ball 1", 2), value
        )
        with refused("relations-not-comparable", most=value**0.5):
            from_json(content).explain()


@pytest.mark.parametrize("exponent", ["1e999999999", "0.5", "1/0", "x", ""])
def test_exponents_that_are_no_fractions_are_refused(explained_law, exponent):
    document = json.loads(to_json(explained_law))
    document["explanation"]["relations"][0]["exponents"] = [exponent]
    with refused("law-exponents"):
        from_json(json.dumps(document))


def test_a_law_in_json_or_parquet_is_the_law(tmp_path, explained_law):
    law, again = explained_law, from_json(to_json(explained_law))
    assert again == law
    assert (str(again), again.history) == (str(law), law.history)
    law.save(tmp_path / "law.parquet")
    assert to_json(Law.load(tmp_path / "law.parquet")) == to_json(law)
    table = pd.read_parquet(tmp_path / "law.parquet").set_index("object")
    np.testing.assert_array_equal(table["coefficients 0 0"], law.coefficients[:, 0, 0])
    np.testing.assert_array_equal(table["properties mass"], [3, 1, 1, 0.6, 0.4])


def test_a_law_that_json_is_too_large_for_is_refused_in_python_and_goes_beside_it_in_commands(tmp_path, monkeypatch):
    monkeypatch.setattr("commonlaw.law.io.LARGEST_JSON", 1000)
    with refused("law-too-large-for-json", objects=5):
        LAW.save(tmp_path / "law.json")
    later = Artifacts()
    later.write_law(str(tmp_path / "law.json"), LAW)
    later.write_law(str(tmp_path / "law.json"), LAW)
    assert later.written == [str(tmp_path / "law.json.parquet")]
    assert ["is too large for JSON" in failure for failure in later.failures] == [True]
    assert to_json(Law.load(tmp_path / "law.json.parquet")) == to_json(LAW)


def parts_of_file():
    """The columns of a law's file, and what it keeps as JSON."""
    columns, metadata = parquet_columns("", file_content(LAW, ".parquet"))
    return columns, json.loads(metadata[b"commonlaw law"])


def loaded(tmp_path, columns, rest):
    (tmp_path / "law.parquet").write_bytes(parquet_bytes(columns, {b"commonlaw law": json.dumps(rest).encode()}))
    return Law.load(tmp_path / "law.parquet")


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ([1, 3], "it lacks 'coefficients 0 2'"),
        ([100_000, 1], "coefficients has the shape"),
        ([1, -1], "coefficients has the shape"),
        ("x", "not supported between"),
        (7, "has no len"),
    ],
)
def test_a_damaged_law_in_parquet_is_refused(tmp_path, shape, message):
    columns, rest = parts_of_file()
    rest["coefficients"]["shape"] = shape
    with refused("not-a-law") as raised:
        loaded(tmp_path, columns, rest)
    assert message in raised.value.parameters["error"]


def test_an_object_in_two_rows_is_refused(tmp_path):
    columns, rest = parts_of_file()
    with refused("not-a-law", error="an object stands in two rows"):
        loaded(tmp_path, {name: [*column, column[0]] for name, column in columns.items()}, rest)


def test_measurements_in_parquet_are_no_law(tmp_path):
    cl.datasets.linear_drag().to_parquet(tmp_path / "drops.parquet")
    with refused("not-a-law-but-measurements"):
        Law.load(tmp_path / "drops.parquet")


SAVED = Path(__file__).parent / "laws"
"""A law of two balls as version 2 wrote it; in version 1 laws knew neither their uncertainty nor their history.

And one of a signal with an offset of each trial and noise of each object, by shooting, as version 7 wrote it.
"""


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
    assert [diagnostic.kind for diagnostic in law.diagnostics] == ["model error"]
    first, second, constant = law.provenance.alternatives
    assert first.measures["2 log B"] == 0
    assert second.measures["2 log B"] > 4
    assert constant.measures == {"BIC": 3.5, "stability": None}
    assert constant.hyperparameters == ((0.5, 2.0) if version == 2 else ())
    again = from_json(to_json(law))
    assert (again.diagnostics, again.provenance.alternatives, again.provenance.history) == (
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


def test_inflation_of_intervals_is_read_by_its_name_until_version_5():
    law, inflation = Law.load(SAVED / "version-2.json"), IntervalInflation(np.array([0.5, 1.0]), np.array([1.0, 3.0]))
    law = replace(law, uncertainty=replace(law.uncertainty, interval_inflation=inflation))
    text = to_json(law).replace('"version": 8', '"version": 5').replace('"interval_inflation"', '"widening"')
    again = from_json(text)
    assert again.uncertainty.interval_inflation.factors.tolist() == [1.0, 3.0]
    assert again.uncertainty.interval_inflation.horizons.tolist() == [0.5, 1.0]


def test_a_factor_of_all_intervals_becomes_an_inflation_at_every_horizon():
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
            widths = (
                np.ones(2) if found.interval_inflation is None else found.interval_inflation.at(np.array([0.0, 100.0]))
            )
            assert widths.tolist() == [factor, factor]


def test_estimates_were_in_the_observation_until_version_7():
    law, raw = Law.load(SAVED / "version-7.json"), json.loads((SAVED / "version-7.json").read_text())
    known = raw["observation"]
    assert law.scheme == "shooting"
    assert (law.uncertainty.noise.tolist(), law.uncertainty.noise_of) == ([known["noise"]["y"]], known["noise_of"])
    assert law.uncertainty.degrees_of_freedom.tolist() == [known["degrees_of_freedom"]["y"]]
    assert law.provenance.domain.sizes == known["sizes"]
    assert law.provenance.log_likelihood == known["log_likelihood"]
    assert [vars(each) for each in law.trial_estimates] == known["estimated"]
    assert (law.observation.equations, law.observation.initial) == ({"y": "2 x + b"}, {"x": "h"})
    again = from_json(to_json(law))
    assert again == law
    assert again.provenance.log_likelihood == law.provenance.log_likelihood
    table = pd.DataFrame({"lab": ["a"] * 5, "t": np.arange(5.0), "y": 6 * np.exp(-0.49 * np.arange(5.0)) + 0.1})
    trials = cl.Trials.from_frame(table, object="lab", time="t", states=["y"])
    assert law.predict(trials).metric("r2") > 0.999
    for damage in ({"noise": {"z": 1.0}}, {"noise": {"y": "much"}}, {"noise": 3.0}, {"estimated": 1.0}, {"sizes": []}):
        with pytest.raises(cl.CommonlawError):
            from_json(json.dumps(raw | {"observation": known | damage}))


def test_initial_values_of_trials_were_by_state_until_version_4():
    raw = json.loads((SAVED / "version-7.json").read_text())
    law = Law.load(SAVED / "version-7.json")
    for estimate in raw["observation"]["estimated"]:
        estimate["state"] = estimate.pop("name")
    del raw["restrictions"]
    old = from_json(json.dumps(raw | {"version": 4}))
    assert old.restrictions is None
    assert [each.name for each in old.trial_estimates] == ["b(0)"] * 4
    assert np.array_equal(old.coefficients, law.coefficients)
    trials = cl.Trials.from_arrays(np.arange(9.0), np.exp(-np.arange(9.0)), names=["y"])
    with refused("restrictions-not-recorded"):
        cl.refine(old, trials)
