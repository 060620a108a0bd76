"""`commonlaw design` as a user meets it."""

import json

import pandas as pd
import pytest

import commonlaw as cl


@pytest.fixture
def laws(tmp_path):
    """Two laws of the same noisy drops, and their table."""
    drops = cl.datasets.linear_drag(noise=0.5)
    drops.to_csv(tmp_path / "drops.csv")
    cl.fit("x'' = -g - c v", drops).save(tmp_path / "linear.json")
    cl.fit("x'' = -g + b v^2", drops).save(tmp_path / "quadratic.json")


@pytest.mark.usefixtures("laws")
def test_the_experiment_that_tells_laws_apart_is_said_saved_and_drawn(run, tmp_path):
    given = ("linear.json", "drops.csv", "--rival", "quadratic.json", "--vary", "x=20..60", "--vary", "duration=1..4")
    files = ("--within", "x=0..100", "--save", "design.csv", "--save", "design.svg")
    code, out, _ = run("design", *given, *files)
    assert code == 0
    assert "0.50  x'' = -g - c v" in out
    assert "Most informative next experiment:" in out
    assert (tmp_path / "design.svg").stat().st_size > 0
    assert 20 <= pd.read_csv(tmp_path / "design.csv").loc[0, "x"] <= 60
    found = json.loads(run("design", *given, "--at-most", "2", "--json")[1])
    assert found["chance now"] == 0.5
    assert found["chance"] > 0.6
    assert found["cost"] == len(found["experiments"])


@pytest.mark.usefixtures("laws")
def test_what_is_wanted_and_what_it_costs_is_said_in_options(run):
    given = ("design", "linear.json", "--vary", "x=40", "--vary", "v=-5..0", "--vary", "duration=2", "--vary", "rate=9")
    code, out, _ = run(*given, "--for", "c of Ball 3", "--cost", "trial=2", "--cost", "sample=0.1")
    assert code == 0
    assert "cost 3.9" in out
    assert "its standard error is then" in out
    known = run(*given, "--for", "c of Ball 3", "--start-std", "x=0", "--start-std", "v=0", "--json")
    free = run(*given, "--for", "c of Ball 3", "--json")
    (then,), (otherwise,) = (json.loads(each[1])["experiments"] for each in (known, free))
    assert then["standard error"] < otherwise["standard error"]
    code, _, err = run(*given, "--start-std", "y=0")
    assert (code, "unknown state 'y'" in err) == (1, True)
    code, _, err = run("design", "linear.json", "--vary", "x=40")
    assert code == 1
    assert "the experiment is incomplete" in err
    assert "v=" in err
    code, _, err = run(*given, "--cost", "height=2")
    assert (code, "unknown price 'height'" in err) == (1, True)


@pytest.mark.usefixtures("laws")
def test_bounds_of_absent_terms_are_said_and_saved(run, tmp_path):
    code, out, _ = run("bounds", "drops.csv", "linear.json", "--term", "v^2", "--save", "bounds.csv")
    assert code == 0
    assert "v^2 in x'': |coefficient| <" in out
    assert len(pd.read_csv(tmp_path / "bounds.csv")) == 5
    assert run("bounds", "drops.csv", "linear.json", "--term", "v")[0] == 1
