"""States that are zero or never measured in a whole trial, as of species that were not put in."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.diagnostics import is_note
from commonlaw.law.alignment import matched
from commonlaw.law.observation import Observation
from commonlaw.law.parameters import named_parameters
from commonlaw.trials import Trials

LAW = "x' = 0.9 x (1 - (x + 0.7 y)/20); y' = 0.7 y (1 - (y + 0.5 x)/15)"
TIMES = np.arange(13.0)


def mixtures(absent=0.0, noise=0.02):
    random, frames = np.random.default_rng(3), []
    for label, start in (("x only", [1, 0]), ("y only", [0, 1]), ("both", [1, 1])):
        (curve,) = cl.Law.from_text(LAW).simulate(TIMES, start).values()
        values = np.where(curve.states == 0, absent, curve.states * (1 + noise * random.standard_normal((13, 2))))
        frames.append(pd.DataFrame({"culture": label, "day": TIMES, "x": values[:, 0], "y": values[:, 1]}))
    return pd.concat(frames, ignore_index=True)


@pytest.mark.parametrize("absent", [0.0, np.nan])
def test_treatments_in_which_a_state_is_absent_are_trials_of_one_object(absent):
    trials = Trials.from_frame(mixtures(absent))
    assert [(trial.object, trial.name) for trial in trials] == [
        ("object", "x only"), ("object", "y only"), ("object", "both")
    ]  # fmt: skip
    assert trials.schema.states == ("x", "y")
    assert Trials.from_frame(mixtures(absent), states=["x", "y"]) == trials
    assert any(is_note(line, "state-never-measured", "x") for line in trials.notes) == np.isnan(absent)
    assert any("`object='culture'`" in note for note in trials.notes) == np.isnan(absent)
    objects = Trials.from_frame(mixtures(absent), object="culture")
    assert objects.objects == ("x only", "y only", "both")
    assert any('= 0 @ "y only"' in note for note in objects.notes) == np.isnan(absent)


def test_replicates_of_treatments_in_which_a_state_is_absent_are_trials_too():
    frames = [mixtures().assign(replicate=replicate) for replicate in (1, 2)]
    trials = Trials.from_frame(pd.concat(frames, ignore_index=True))
    assert trials.objects == ("object",)
    assert {trial.name for trial in trials} == {f"{name}, {n}" for name in ("x only", "y only", "both") for n in (1, 2)}
    assert not trials.properties
    for roles in ({}, {"object": ""}):  # A saved schema has the label of trials alone
        same = Trials.from_frame(pd.concat(frames, ignore_index=True), trial="culture, replicate", **roles)
        assert same == trials


def test_the_note_on_states_never_measured_names_all_their_trials():
    frame = mixtures(np.nan)
    again = frame[frame["culture"] == "y only"].assign(culture="y again")
    notes = Trials.from_frame(pd.concat([frame, again], ignore_index=True)).notes
    assert any('`x(0) = 0 @ "y only", "y again"`' in note for note in notes)


@pytest.mark.parametrize(
    ("starts", "noted"),
    [
        ({}, "xy"),
        ({"x": {"object, trial y only": 0.0}}, "xy"),
        ({"x": {"object, trial y only": 0.0, "object, trial y again": 0.0}, "y": "y0"}, ""),
        ({"x": {"object": 0.0}}, "y"),
    ],
)
def test_the_note_on_states_never_measured_ends_with_their_starts(starts, noted):
    frame = mixtures(np.nan)
    again = frame[frame["culture"] == "y only"].assign(culture="y again")
    trials = Trials.from_frame(pd.concat([frame, again], ignore_index=True))
    law = cl.Law.from_text(LAW)
    law = replace(law, scheme="shooting", observation=Observation(trials.schema, initial=starts))
    notes = matched(law, trials).notes
    asked = [name for name in "xy" if any(is_note(line, "state-never-measured", name) for line in notes)]
    assert "".join(asked) == noted


def test_objects_of_which_all_states_are_present_stay_objects():
    frame = mixtures()
    assert len(Trials.from_frame(frame[frame["culture"] == "both"].assign(culture="a")).objects) == 1
    present = frame.assign(x=frame["x"] + 0.5, y=frame["y"] + 0.5)
    assert len(Trials.from_frame(present).objects) == 3
    blank = frame.assign(y=frame["x"] * 0.5)  # Both at rest: a blank
    assert len(Trials.from_frame(blank).objects) == 3
    dosed = present.assign(dose=np.where(present["culture"] == "both", 0.0, np.arange(len(present)) % 5))
    assert len(Trials.from_frame(dosed).objects) == 3


def test_competition_is_found_from_monocultures_and_a_mixture():
    law = cl.fit(
        "x' = r x (1 - (x + a y)/K); y' = s y (1 - (y + b x)/M)", Trials.from_frame(mixtures()), errors="white"
    )
    parameters = named_parameters(law)
    found = dict(zip(parameters.names, parameters.values[0], strict=True))
    expected = {"r": 0.9, "a": 0.7, "K": 20, "s": 0.7, "b": 0.5, "M": 15}
    assert found == pytest.approx(expected, rel=0.1)
