"""A log-scaled state on the command line."""

import numpy as np
import pandas as pd
import pytest

TIMES = np.linspace(0, 12, 25)


@pytest.fixture
def plants(tmp_path):
    """A table of a plant that grows, written as plants.csv."""
    errors = np.exp(0.2 * np.random.default_rng(0).standard_normal(len(TIMES)))
    frame = pd.DataFrame({"t": TIMES, "weight": errors / (0.01 + 0.49 * np.exp(-0.6 * TIMES))})
    frame.to_csv(tmp_path / "plants.csv", index=False)
    return frame


def test_bands_of_a_log_scaled_state_are_above_zero_whatever_command_forecasts(run, done, plants, tmp_path):
    options = ["--set", "log_states=weight", "--library", "terms:weight,weight^2"]
    code, out, err = run("discover", "plants.csv", *options, "--save", "law.json")
    assert (code, err) == (0, "")
    assert "weight' = a weight + b weight^2" in out
    assert "% of it, on a logarithmic scale" in run("show", "law.json", "--history")[1]
    done("predict", "plants.csv", "law.json", "--save", "forecast.csv", "--save", "bands.svg")
    forecast = pd.read_csv("forecast.csv")
    assert (forecast["weight measured low"] > 0).all()
    ratio = forecast["weight measured high"] * forecast["weight measured low"] / forecast["weight forecast"] ** 2
    np.testing.assert_allclose(ratio, 1, rtol=1e-9)
    np.testing.assert_array_equal(forecast["weight"], plants["weight"])
    done("refine", "plants.csv", "law.json", "--save", "refined.json")
    assert "on a logarithmic scale" in run("show", "refined.json", "--history")[1]
    growth = "weight' = a weight + b weight^2"
    compared = run("compare", "plants.csv", growth, "law.json", "--set", "log_states=weight")
    assert "2 log B" in compared[1]
    assert "[scale-of-comparison]" not in compared[2]
    assert "[scale-of-comparison]" in run("compare", "plants.csv", growth, "law.json")[2]

    plants.assign(weight=plants["weight"] - plants["weight"].min()).to_csv(tmp_path / "zero.csv", index=False)
    code, _, err = run("discover", "zero.csv", "--set", "log_states=weight")
    assert code != 0
    assert "zero, trial 1: weight is 0 in sample " in err
    assert "leave --set log_states=... out" in err
    _, _, err = run("discover", "plants.csv", "--set", "log_states=weight", "--set", "trim=2")
    assert "the setting log_states does not go with --method derivative-regression" in err
