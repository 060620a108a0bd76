"""`commonlaw discrepancy` and `predict --discrepancy` as a user meets them."""

import json

import pytest

import commonlaw as cl


@pytest.fixture
def drops(tmp_path):
    """Drops of two balls with drag."""
    drops = cl.datasets.linear_drag(noise=0.05, drag=(-0.3, -0.3), trials=1)
    drops.to_csv(tmp_path / "drops.csv")


@pytest.mark.usefixtures("drops")
def test_a_saved_law_is_given_the_drag_that_it_lacks_and_forecasts_with_it(run, done, fails, tmp_path):
    done("fit", "drops.csv", "x'' = -g", "--save", "law.json")
    given = ("drops.csv", "law.json", "--of", "v", "--noise", "x=0.05")
    out = done("discrepancy", *given, "--save", "with.json", "--save", "discrepancy.svg")
    assert out.startswith("Discrepancy: x'' = law + f(v), 2 log B = ")
    assert "Terms in place of the function" in out
    assert (tmp_path / "discrepancy.svg").stat().st_size > 0
    scores = [
        json.loads(run("predict", "drops.csv", "with.json", "--initial-samples", "15", "--json", *how)[1])["score"]
        for how in ([], ["--discrepancy"])
    ]
    assert scores[0] < 0.9999 < scores[1]
    found = json.loads(done("discrepancy", *given, "--zero-at", "none", "--json"))
    assert (found["claimed"], found["zero at"], found["holds nothing of"]) == (True, None, ["1"])
    refusal = fails("discrepancy", "drops.csv", "law.json", "--zero-at", "rest")
    assert "--zero-at rest: give a number, 'none' or 'auto'" in refusal
    assert "help discrepancy-missing]" in fails("predict", "drops.csv", "law.json", "--discrepancy")
