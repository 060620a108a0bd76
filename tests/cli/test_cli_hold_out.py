"""Trials, objects and times that a law is not learned from."""

import json

import numpy as np
import pytest

import commonlaw as cl


@pytest.fixture
def table(tmp_path):
    """Three objects that decay, twice each."""
    times, noise = np.linspace(0.0, 4.0, 40), np.random.default_rng(5)
    pairs = [(name, rate) for name, rate in (("a", 0.5), ("b", 0.7), ("c", 1.0)) for _ in range(2)]
    states = [5 * np.exp(-rate * times) + noise.normal(0, 0.05, 40) for _, rate in pairs]
    trials = cl.Trials.from_arrays([times] * 6, states, object=[name for name, _ in pairs])
    trials.to_csv(tmp_path / "decays.csv")


def learned(run, *options):
    """Return what `commonlaw fit` says about the decays with these options."""
    code, out, err = run("fit", "decays.csv", "x' = -k x", *options, "--json")
    assert (code, err) == (0, "")
    document = json.loads(out)
    trials = {(each["object"], each["trial"]) for each in document["forecast"]["errors"]}
    return document, trials, sorted(document["law"]["coefficients"])


@pytest.mark.usefixtures("table")
def test_trials_that_are_held_out_are_forecast(run):
    document, trials, objects = learned(run, "--hold-out", "trial=2")
    assert document["forecast"]["of"] == "held out"
    assert trials == {("a", "2"), ("b", "2"), ("c", "2")}
    assert objects == ["a", "b", "c"]
    same, *_ = learned(run, "--where", "trial=1")
    assert same["law"]["coefficients"] == document["law"]["coefficients"]


@pytest.mark.usefixtures("table")
def test_excluded_trials_are_neither_learned_from_nor_forecast(run):
    _, trials, objects = learned(run, "--exclude", "object=a", "--exclude", "trial=2", "--hold-out", "trial=1")
    assert trials == {("b", "1"), ("c", "1")}
    assert objects == ["b", "c"]
    _, trials, objects = learned(run, "--exclude", "object=a,b")
    assert trials == {("c", "1"), ("c", "2")}
    assert objects == ["c"]


@pytest.mark.usefixtures("table")
def test_an_object_can_be_held_out(run):
    document, trials, objects = learned(run, "--hold-out", "object=a")
    assert document["forecast"]["of"] == "training"  # Nothing is known of its coefficients
    assert {name for name, _ in trials} == {"b", "c"} == {*objects}


@pytest.mark.usefixtures("table")
def test_samples_after_a_time_can_be_held_out(run, tmp_path):
    document, trials, _ = learned(run, "--learn-until", "2")
    early = cl.Trials.read(tmp_path / "decays.csv").until(2.0)
    assert max(each.times[-1] for each in early) <= 2 < max(each.times[-1] + 4 / 39 for each in early)
    law = cl.fit("x' = -k x", early)
    assert document["law"]["coefficients"]["a"] == law.coefficients[0].tolist()
    assert len(trials) == 6


@pytest.mark.usefixtures("table")
def test_predict_leaves_trials_out_too(run):
    assert run("fit", "decays.csv", "x' = -k x", "--save", "law.json")[0] == 0
    code, out, _ = run("predict", "decays.csv", "law.json", "--exclude", "trial=2", "--json")
    assert code == 0
    assert {each["trial"] for each in json.loads(out)["errors"]} == {"1"}


@pytest.mark.usefixtures("table")
def test_the_verdict_is_on_what_was_held_out(run):
    for option, judged_on in (
        (("--hold-out", "trial=2"), "held-out trials"),
        (("--learn-until", "2"), "held-out later samples"),
        ((), "whole trials"),
    ):
        document, *_ = learned(run, *option)
        verdict = document["verdict"]
        assert (verdict["judged_on"], verdict["usable"]) == (judged_on, True)
        first = verdict["sentences"][0]
        assert first.startswith("This law can be used for forecasts" if option else "Forecasts its training data well")
    document, *_ = learned(run, "--hold-out", "object=a")
    assert document["verdict"]["unknown_objects"] == ["a"]
    code, out, _ = run("discover", "decays.csv", "--library", "poly:1", "--learn-until", "2")
    assert code == 0
    assert "\nThis law can be used for forecasts up to" in out
