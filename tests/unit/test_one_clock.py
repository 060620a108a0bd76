"""Objects that are measured one after the other on one clock, which text names."""

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law.parameters import named_parameters
from commonlaw.trials import Trials

RATES = {"A": 1.0, "B": 0.5, "C": 1.4}


def spin_up(t, rate):
    return 100 * (1 - np.exp(-rate * t))


def coast_down(t, rate):
    return 80 * np.exp(-rate * t)


def logged(names, gap, course=spin_up, samples=12, seed=0):
    """Return the log of runs after each other, with a time between them."""
    random, elapsed = np.random.default_rng(seed), np.arange(samples) * 0.5
    runs = [
        pd.DataFrame(
            {
                "seconds": i * (elapsed[-1] + gap) + elapsed,
                "kind": name,
                "speed": (course(elapsed, RATES[name]) + random.normal(0, 0.5, samples)).round(2),
            }
        )
        for i, name in enumerate(names)
    ]
    return pd.concat(runs, ignore_index=True)


@pytest.mark.parametrize("course", [spin_up, coast_down])
@pytest.mark.parametrize("gap", [0.0, 0.5, 40.0])
@pytest.mark.parametrize("names", ["AB", "ABC", "ABCABC"])
def test_text_names_objects_where_the_clock_does_not_start_again(course, gap, names):
    trials = Trials.from_frame(logged(names, gap, course))
    assert trials.schema.object == "kind"
    assert trials.schema.states == ("speed",)
    assert {*trials.objects} == {*names}
    assert [len(trial) for trial in trials] == [12] * len(names)


@pytest.mark.parametrize("tau", [0.3, 1.0, 4.0])
def test_phases_of_one_object_are_remarks(tau):
    t = np.arange(40) * 0.5
    warm = 60 * (1 - np.exp(-np.minimum(t, 10) / tau)) * np.exp(-np.maximum(t - 10, 0) / tau)
    frame = pd.DataFrame({"t": t, "phase": np.where(t < 10, "heat", "cool"), "T": 20 + warm})
    assert Trials.from_frame(frame).objects == ("object",)
    assert len(Trials.from_frame(frame.assign(phase=["day", "night"] * 20))) == 1


def test_a_logger_that_takes_turns_has_an_object_each():
    values = np.column_stack([20 + start * np.exp(-np.arange(20) / 8) for start in (60, 40, 20)])
    frame = pd.DataFrame({"t": np.arange(60.0), "place": ["A", "B", "C"] * 20, "T": values.ravel()})
    trials = Trials.from_frame(frame)
    assert trials.objects == ("A", "B", "C")
    assert len(trials) == 3


def test_an_object_that_is_named_twice_on_one_clock_has_two_trials():
    frame = logged("ABAB", 0.5)
    trials = Trials.from_frame(frame, object="kind")
    assert [(trial.object, trial.name, trial.times[0]) for trial in trials] == [
        ("A", "1", 0.0), ("B", "1", 6.0), ("A", "2", 12.0), ("B", "2", 18.0)
    ]  # fmt: skip
    law = cl.fit("speed' = a - b speed", trials, errors="white")
    rates = named_parameters(law).values[:, 1]
    np.testing.assert_allclose(rates, [RATES["A"], RATES["B"]], rtol=0.05)
