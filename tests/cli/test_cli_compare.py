"""Laws compared, checked, and experiments designed on the command line."""

import json

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law import from_json
from commonlaw.law.tables import MEANINGS

LAWS = ["x'' = -9.8 - c v", "x'' = -9.8"]


@pytest.fixture
def few(tmp_path):
    """A short table of drops, and a law of them."""
    trials = cl.datasets.linear_drag(drag=(-0.3, -0.5), noise=0.05, trials=1)
    trials.to_csv(tmp_path / "drops.csv")
    cl.fit("x'' = -9.8 - c v", trials).save(tmp_path / "law.json")
    return trials


def test_laws_in_words_are_compared_as_in_python(done, tmp_path, few):
    out = done("compare", "drops.csv", *LAWS[::-1], "--save", "table.csv")
    assert out.splitlines()[:2] == [
        "x'' = -9.8 - c v is the most probable of these laws.",
        "Very strong evidence against: x'' = -9.8.",
    ]
    expected = cl.compare({each: cl.fit(each, few) for each in LAWS}, few)
    saved = pd.read_csv(tmp_path / "table.csv")
    pd.testing.assert_frame_equal(saved, expected, check_exact=False, rtol=1e-6)
    assert MEANINGS["2 log B"] in out


@pytest.mark.usefixtures("few")
def test_a_saved_law_stands_beside_one_in_words(done):
    out = done("compare", "drops.csv", "law.json", "x'' = -9.8", "--json")
    assert [each["law"] for each in json.loads(out)["laws"]] == ["law.json", "x'' = -9.8"]


@pytest.mark.usefixtures("few")
def test_a_law_that_cannot_be_read_is_named_before_any_is_fitted(fails, monkeypatch):
    monkeypatch.setattr("commonlaw.fit", lambda *_, **__: pytest.fail("a law was fitted"))
    err = fails("compare", "drops.csv", "x'' = -9.8", "y'' = -9.8")
    assert err.startswith("commonlaw: y'' = -9.8: the equations are of y, the states are x")


def test_equations_with_the_doses_of_a_table_are_compared(fails, tmp_path):
    (tmp_path / "doses.csv").write_text("t,dose,c\n0,100,\n1,,8\n2,,5\n3,50,\n4,,6\n5,,4\n")
    err = fails("compare", "doses.csv", "c' = -k c + dose/V", "c' = -k a c + dose")
    assert err.startswith("commonlaw: c' = -k a c + dose")


def test_named_models_with_latent_states_are_compared_by_the_doses_of_a_table(done, tmp_path):
    t = np.array([0.2, 0.5, 1, 1.5, 2, 3, 4, 6, 8, 12])
    levels = 8 * 1.2 / 0.9 * (np.exp(-0.3 * t) - np.exp(-1.2 * t)) * (1 + 0.01 * np.cos(7 * t))
    rows = "".join(f"{time},,{level}\n" for time, level in zip(t, levels, strict=True))
    (tmp_path / "oral.csv").write_text(f"t,dose,conc\n0,80,\n{rows}")
    models = "one-compartment", "one-compartment-with-absorption"
    assert done("compare", "oral.csv", *models).startswith("one-compartment-with-absorption is the most probable")


@pytest.mark.parametrize("given", [["drops.csv"], ["drops.csv", "x' = 1"], ["drops.csv", "x' = 1", "x' = 1"]])
def test_one_law_is_nothing_to_compare(fails, given):
    assert "two laws or more that differ" in fails("compare", *given, code=2)


def test_a_data_set_stands_for_the_file(run, monkeypatch):
    asked = []

    def fit(text, *_, **__):
        asked.append(text)
        raise cl.CommonlawError("other", text="enough")

    monkeypatch.setattr("commonlaw.fit", fit)
    assert run("compare", "dataset:linear-drag", *LAWS)[0] == 1
    assert asked == LAWS[:1]


@pytest.fixture
def drops(tmp_path):
    """Drops of a ball with drag."""
    cl.datasets.linear_drag(noise=0.05, drag=-0.3).to_csv(tmp_path / "drops.csv")


@pytest.mark.usefixtures("drops")
def test_a_law_without_drag_leaves_patterns_and_one_with_drag_none(run, done, tmp_path):
    done("fit", "drops.csv", "x'' = -g - c v", "--save", "drag.json")
    done("fit", "drops.csv", "x'' = -g", "--save", "law.json")
    code, out, _ = run("check", "drops.csv", "drag.json", "--save", "residuals.csv", "--save", "residuals.svg")
    assert (code, "no pattern is significant" in out) == (0, True)
    assert (tmp_path / "residuals.svg").stat().st_size > 0
    assert pd.read_csv(tmp_path / "residuals.csv")["x residual/noise"].std() == pytest.approx(1.0, rel=0.15)
    code, out, _ = run("check", "drops.csv", "law.json")
    assert "Residuals of x, trend with v: a term in v" in out
    patterns = json.loads(run("check", "drops.csv", "law.json", "--json")[1])["patterns"]
    assert next(pattern for pattern in patterns if pattern["pattern"] == "trend with v")["significant"]


@pytest.mark.usefixtures("drops")
@pytest.mark.parametrize("known", ["x'' = -9.8", "gravity.json"])
def test_known_physics_is_a_base_as_an_equation_and_as_a_law(run, tmp_path, known):
    cl.Law.from_text("x'' = -g", {"g": 9.8}).save(tmp_path / "gravity.json")
    how = ("--order", "2", "--state", "x", "--library", "poly:1", "--known", known)
    code, out, _ = run("discover", "drops.csv", *how, "--json")
    law = from_json(json.dumps(json.loads(out)["law"]))
    assert code == 0
    assert law.coefficients[0, 0, law.terms.index("1")] == -9.8
    assert law.coefficients[0, 0, law.terms.index("v")] == pytest.approx(-0.3, rel=0.02)


@pytest.fixture
def laws(tmp_path):
    """Two laws of the same noisy drops, and their table."""
    drops = cl.datasets.linear_drag(drag=-0.3, noise=0.5, trials=1)
    drops.to_csv(tmp_path / "drops.csv")
    cl.fit("x'' = -g - c v", drops).save(tmp_path / "linear.json")
    cl.fit("x'' = -g + b v^2", drops).save(tmp_path / "quadratic.json")


@pytest.mark.slow
@pytest.mark.usefixtures("laws")
def test_the_experiment_that_tells_laws_apart_is_said_saved_and_drawn(run, done, tmp_path):
    rival = ("--rival", "quadratic.json", "--vary", "duration=4", "--vary", "rate=5", "--vary", "v=0")
    given = ("drops.csv", "linear.json", *rival)
    files = ("--within", "x=0..100", "--save", "design.csv", "--save", "design.svg")
    out = done("design", *given, "--vary", "x=20..60", *files)
    assert "0.50  x'' = -g - c v" in out
    assert "Most informative next experiment:" in out
    assert (tmp_path / "design.svg").stat().st_size > 0
    assert 20 <= pd.read_csv(tmp_path / "design.csv").loc[0, "x"] <= 60
    found = json.loads(run("design", *given, "--vary", "x=60", "--json")[1])
    assert found["chance now"] == 0.5
    assert found["chance"] > 0.6


@pytest.mark.slow
@pytest.mark.usefixtures("laws")
def test_what_is_wanted_and_what_it_costs_is_said_in_options(run, done, fails):
    given = ("design", "linear.json", "--vary", "x=40", "--vary", "v=-5..0", "--vary", "duration=2", "--vary", "rate=9")
    out = done(*given, "--for", "c of Ball 1", "--cost", "trial=2", "--cost", "sample=0.1")
    assert "cost 3.9" in out
    assert "its standard error is then" in out
    known = run(*given, "--for", "c of Ball 1", "--start-std", "x=0", "--start-std", "v=0", "--json")
    free = run(*given, "--for", "c of Ball 1", "--json")
    (then,), (otherwise,) = (json.loads(each[1])["experiments"] for each in (known, free))
    assert then["standard error"] < otherwise["standard error"]
    two = json.loads(run(*given, "--for", "c of Ball 1", "--at-most", "2", "--json")[1])
    assert two["cost"] == len(two["experiments"]) == 2
    assert "unknown state 'y'" in fails(*given, "--start-std", "y=0")
    err = fails("design", "linear.json", "--vary", "x=40")
    assert "the experiment is incomplete" in err
    assert "v=" in err
    assert "unknown price 'height'" in fails(*given, "--cost", "height=2")


@pytest.mark.usefixtures("laws")
def test_bounds_of_absent_terms_are_said_and_saved(run, done, tmp_path):
    assert "v^2 in x'': |coefficient| <" in done(
        "bounds", "drops.csv", "linear.json", "--term", "v^2", "--save", "bounds.csv"
    )
    assert len(pd.read_csv(tmp_path / "bounds.csv")) == 1
    assert run("bounds", "drops.csv", "linear.json", "--term", "v")[0] == 1
