"""A positive state on the command line."""

import numpy as np
import pandas as pd
import pytest

TIMES = np.linspace(0, 12, 40)


@pytest.fixture
def plants(tmp_path):
    """A table of a plant that grows, written as plants.csv."""
    errors = np.exp(0.2 * np.random.default_rng(0).standard_normal(40))
    frame = pd.DataFrame({"t": TIMES, "weight": errors / (0.01 + 0.49 * np.exp(-0.6 * TIMES))})
    frame.to_csv(tmp_path / "plants.csv", index=False)
    return frame


def test_bands_of_a_positive_state_are_above_zero_whatever_command_forecasts(run, plants, tmp_path):
    options = ["--positive", "weight", "--library", "terms:weight,weight^2", "--history"]
    code, out, err = run("discover", "plants.csv", *options, "--save", "law.json")
    assert (code, err) == (0, "")
    assert "weight' = a weight + b weight^2" in out
    assert "% of it, on a logarithmic scale" in out
    assert run("predict", "law.json", "plants.csv", "--save", "forecast.csv", "--plot", "bands.svg")[0] == 0
    forecast = pd.read_csv("forecast.csv")
    assert (forecast["weight measured low"] > 0).all()
    ratio = forecast["weight measured high"] * forecast["weight measured low"] / forecast["weight forecast"] ** 2
    np.testing.assert_allclose(ratio, 1, rtol=1e-9)
    np.testing.assert_array_equal(forecast["weight"], plants["weight"])
    code, out, _ = run("refine", "law.json", "plants.csv", "--history")
    assert (code, "on a logarithmic scale" in out) == (0, True)
    growth = "weight' = a weight + b weight^2"
    out = run("fit", growth, "plants.csv", "--positive", "weight", "--against", "law.json")[1]
    assert "2 log B" in out
    assert "--positive ..., or none" in run("fit", growth, "plants.csv", "--against", "law.json")[2]

    plants.assign(weight=plants["weight"] - plants["weight"].min()).to_csv(tmp_path / "zero.csv", index=False)
    code, _, err = run("discover", "zero.csv", "--positive", "weight")
    assert code != 0
    assert "zero, trial 1: weight is 0 in sample " in err
    assert "leave --positive ... out" in err
    _, _, err = run("discover", "plants.csv", "--positive", "weight", "--trim", "2")
    assert "--positive does not go with --method derivative-regression" in err
