"""Objects that do not follow the law of the others, on the command line."""

import json

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl


@pytest.fixture
def cups(tmp_path):
    """Five cups cool by x' = k (20 - x), but for the last, whose rate has a square in it."""
    generator, times, rows = np.random.default_rng(3), np.linspace(0, 5, 20), []
    for i, k in enumerate((0.4, 0.5, 0.7, 0.9, 0.0)):
        ratio = (80 - 20) / (80 + 20) * np.exp(-0.8 * times)
        curve = 20 + 60 * np.exp(-k * times) if k else 20 * (1 + ratio) / (1 - ratio)  # x' = 0.02 (400 - x^2)
        states = curve + 0.3 * generator.standard_normal(20)
        rows.append(pd.DataFrame({"object": f"cup {i + 1}", "t": times, "x": states}))
    pd.concat(rows).to_csv(tmp_path / "cups.csv", index=False)


@pytest.mark.usefixtures("cups")
def test_a_strange_object_is_left_out_unless_it_is_to_be_kept(run, fails, tmp_path):
    how = ["discover", "cups.csv", "--order", "1", "--library", "poly:2"]
    code, _, err = run(*how, "--save", "law.json")
    assert (code, err.count("[strange-object]")) == (0, 1)
    assert cl.Law.load(tmp_path / "law.json").objects == ("cup 1", "cup 2", "cup 3", "cup 4")
    assert "[commonlaw help law-of-other-objects]" in fails(
        "predict", "cups.csv", "law.json", "--where", "object=cup 5"
    )
    code, out, err = run("compare", "cups.csv", "law.json", "x' = a - b x^2", "--json")
    assert (code, [law["law"] for law in json.loads(out)["laws"]]) == (0, ["law.json", "x' = a - b x^2"])
    code, _, err = run(*how, "--set", "strange_objects=keep", "--save", "whole.json")
    assert (code, "[strange-object]" in err) == (0, False)
    assert len(cl.Law.load(tmp_path / "whole.json").objects) == 5
