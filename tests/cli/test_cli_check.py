"""`commonlaw check`, and `discover --known`, as a user meets them."""

import json

import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law import from_json


@pytest.fixture
def drops(tmp_path):
    """Drops of a ball with drag."""
    cl.datasets.linear_drag(noise=0.05, drag=-0.3).to_csv(tmp_path / "drops.csv")


@pytest.mark.usefixtures("drops")
def test_a_law_without_drag_leaves_patterns_and_one_with_drag_none(run, tmp_path):
    assert run("fit", "drops.csv", "x'' = -g - c v", "--save", "drag.json")[0] == 0
    assert run("fit", "drops.csv", "x'' = -g", "--save", "law.json")[0] == 0
    code, out, _ = run("check", "drops.csv", "drag.json", "--save", "residuals.csv", "--save", "residuals.svg")
    assert (code, "no pattern is significant" in out) == (0, True)
    assert (tmp_path / "residuals.svg").stat().st_size > 0
    assert pd.read_csv(tmp_path / "residuals.csv")["x residual/noise"].std() == pytest.approx(1.0, rel=0.15)
    code, out, _ = run("check", "drops.csv", "law.json")
    assert "Residuals of x, trend with v: a term in v" in out
    patterns = json.loads(run("check", "drops.csv", "law.json", "--json")[1])["patterns"]
    assert next(each for each in patterns if each["pattern"] == "trend with v")["significant"]


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
