"""Which of several laws the measurements are for, from the command line."""

import json

import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law.tables import MEANINGS

LAWS = ["x'' = -9.8 - c v", "x'' = -9.8"]


@pytest.fixture
def few(tmp_path):
    """A short table of drops, and a law of them."""
    trials = cl.datasets.linear_drag(drag=(-0.3, -0.5), noise=0.05, trials=1)
    trials.to_csv(tmp_path / "drops.csv")
    cl.fit("x'' = -9.8 - c v", trials).save(tmp_path / "law.json")
    return trials


def test_laws_in_words_are_compared_as_in_python(run, tmp_path, few):
    code, out, _ = run("compare", "drops.csv", *LAWS[::-1], "--save", "table.csv")
    assert code == 0
    assert out.splitlines()[:2] == [
        "x'' = -9.8 - c v is the most probable of these laws.",
        "Very strong evidence against: x'' = -9.8.",
    ]
    expected = cl.compare({each: cl.fit(each, few) for each in LAWS}, few)
    saved = pd.read_csv(tmp_path / "table.csv")
    pd.testing.assert_frame_equal(saved, expected, check_exact=False, rtol=1e-6)
    assert MEANINGS["2 log B"] in out


@pytest.mark.usefixtures("few")
def test_a_saved_law_stands_beside_one_in_words(run):
    code, out, _ = run("compare", "drops.csv", "law.json", "x'' = -9.8", "--json")
    assert code == 0
    assert [each["law"] for each in json.loads(out)["laws"]] == ["law.json", "x'' = -9.8"]


@pytest.mark.usefixtures("few")
def test_a_law_may_have_no_coefficient_and_no_term(run):
    code, out, _ = run("compare", "drops.csv", "x'' = 0", "x'' = -9.8", "--json")
    assert code == 0
    assert [(each["law"], each["coefficients"]) for each in json.loads(out)["laws"]] == [
        ("x'' = -9.8", 0),
        ("x'' = 0", 0),
    ]


@pytest.mark.usefixtures("few")
def test_a_law_that_cannot_be_read_is_named_before_any_is_fitted(run, monkeypatch):
    monkeypatch.setattr("commonlaw.fit", lambda *_, **__: pytest.fail("a law was fitted"))
    code, _, err = run("compare", "drops.csv", "x'' = -9.8", "y'' = -9.8")
    assert code == 1
    assert err.startswith("commonlaw: y'' = -9.8: the equations are of y, the states are x")


@pytest.mark.parametrize("given", [["drops.csv"], ["drops.csv", "x' = 1"], ["drops.csv", "x' = 1", "x' = 1"]])
def test_one_law_is_nothing_to_compare(run, given):
    code, _, err = run("compare", *given)
    assert code == 2
    assert "two laws or more that differ" in err


def test_a_data_set_stands_for_the_file(run, monkeypatch):
    asked = []

    def fit(text, *_, **__):
        asked.append(text)
        raise cl.CommonlawError("other", text="enough")

    monkeypatch.setattr("commonlaw.fit", fit)
    assert run("compare", "dataset:linear-drag", *LAWS)[0] == 1
    assert asked == LAWS[:1]
