"""`commonlaw check` as a user meets it."""

import json

import pandas as pd
import pytest

import commonlaw as cl


@pytest.fixture
def drops(tmp_path):
    """Drops of a ball with drag."""
    cl.datasets.linear_drag(noise=0.05, drag=-0.3).to_csv(tmp_path / "drops.csv")


@pytest.mark.usefixtures("drops")
def test_a_law_without_drag_leaves_patterns_and_one_with_drag_none(run, tmp_path):
    assert run("fit", "x'' = -g - c v", "drops.csv", "--save", "drag.json")[0] == 0
    assert run("fit", "x'' = -g", "drops.csv", "--save", "law.json")[0] == 0
    code, out, _ = run("check", "drag.json", "drops.csv", "--save", "residuals.csv", "--plot", "residuals.svg")
    assert (code, "no pattern is more than chance" in out) == (0, True)
    assert (tmp_path / "residuals.svg").stat().st_size > 0
    assert pd.read_csv(tmp_path / "residuals.csv")["x residual/noise"].std() == pytest.approx(1.0, rel=0.15)
    code, out, _ = run("check", "law.json", "drops.csv")
    assert "Residuals of x, trend with v: the law lacks a term in v" in out
    patterns = json.loads(run("check", "law.json", "drops.csv", "--json")[1])["patterns"]
    assert next(each for each in patterns if each["pattern"] == "trend with v")["there"]
