"""Trials: made from arrays, selected, split, compared and changed."""

import copy
import dataclasses
import pickle
from functools import partial

import numpy as np
import pandas as pd
import pytest
from sklearn.model_selection import GroupKFold, KFold

from commonlaw.trials import Schema, Trial, Trials
from tests.refusals import message, refused


def ramp(name="ball", run="1", samples=4, states=1):
    return Trial(name, run, np.arange(samples) / 10, np.arange(float(samples * states)).reshape(samples, states))


@pytest.fixture
def trials():
    made = [ramp(name, run) for name in ("golf", "tennis", "wiffle") for run in ("1", "2")]
    properties = {"golf": {"mass": 0.046, "skin": "hard"}, "tennis": {"mass": 0.057, "skin": "felt"}}
    return Trials(tuple(made), Schema(("x",)), properties)


def labels(trials):
    return [(trial.object, trial.name) for trial in trials]


def test_selection_is_by_names_and_properties_and_keeps_these(trials):
    assert labels(trials.select(object="golf", trial=2)) == [("golf", "2")]
    assert labels(trials.select(object=["golf", "wiffle"], trial=1.0)) == [("golf", "1"), ("wiffle", "1")]
    assert len(trials.select(trial=range(1, 3))) == 6
    assert trials.select(skin="felt").objects == ("tennis",)
    assert trials.select(mass=lambda mass: mass < 0.05).objects == ("golf",)
    assert trials.select(mass=[0.046, 0.057], trial=1).objects == ("golf", "tennis")
    assert trials.select(object="golf").properties == {"golf": {"mass": 0.046, "skin": "hard"}}
    assert trials.select(object="wiffle").properties == {}


@pytest.mark.parametrize(
    ("conditions", "expected"),
    [
        ({"object": "gulf"}, message("unknown-name", kind="object", name="gulf")),
        ({"trial": 3}, message("unknown-name", kind="trial", name="3")),
        ({"mas": 1}, message("unknown-name", kind="property", name="mas")),
        ({"object": "golf", "skin": "felt"}, message("no-trial-fits", conditions="object=golf, skin=felt")),
    ],
)
def test_selection_refuses_what_is_not_there(trials, conditions, expected):
    with refused(expected):
        trials.select(**conditions)


def test_splits_part_the_trials_in_two_and_folds_are_those_of_scikit_learn(trials):
    chosen, rest = trials.split(trial=1)
    assert labels(chosen) == [("golf", "1"), ("tennis", "1"), ("wiffle", "1")]
    assert sorted(labels(chosen) + labels(rest)) == sorted(labels(trials))
    with refused("split-one-sided"):
        trials.split(trial=[1, 2])
    groups = [trial.object for trial in trials]
    folds = [(trials[train], trials[test]) for train, test in GroupKFold(3).split(trials, groups=groups)]
    assert sorted(test.objects[0] for _, test in folds) == ["golf", "tennis", "wiffle"]
    assert all(not set(train.objects) & set(test.objects) for train, test in folds)
    assert [len(trials[test]) for _, test in KFold(3).split(trials)] == [2, 2, 2]


def test_indexing_is_that_of_an_array_of_trials(trials):
    assert trials[-1] is trials.trials[-1]
    assert labels(trials[1:3]) == labels(trials[[1, 2]]) == labels(trials[np.array([1, 2])])
    assert labels(trials[np.arange(6) < 2]) == labels(trials[:2])
    with refused("no-trial"):
        trials[[]]


def test_trials_are_constant_and_copies_are_equal(trials):
    with pytest.raises(dataclasses.FrozenInstanceError):
        trials.notes = ()
    with pytest.raises(ValueError, match="read-only"):
        trials[0].states[0] = 1.0
    given = np.zeros(3)
    made = Trial("ball", "1", np.arange(3.0), given)
    given[0] = 9.0
    assert made.states[0, 0] == 0.0
    for other in (pickle.loads(pickle.dumps(trials)), copy.deepcopy(trials)):
        assert labels(other) == labels(trials)
        assert (other.schema, other.properties) == (trials.schema, trials.properties)
        np.testing.assert_array_equal(other[3].states, trials[3].states)


def test_labels_are_the_same_however_they_are_written():
    assert ramp(3, 1.0).label == ramp(" 3", "1.0").label == "3, trial 1"


BALL, WHERE = partial(Trial, "ball", "1"), "ball, trial 1"


def trials_of(*trials, **properties):
    return Trials(trials, Schema(("x",)), properties)


@pytest.mark.parametrize(
    ("make", "arguments", "expected"),
    [
        (ramp, (" ",), "label-empty"),
        (ramp, ("ball", "1", 0), message("trial-without-samples", trial=WHERE)),
        (BALL, ([0, 1, 2], [0, 1]), message("rows-differ", WHERE, times=3, states=2, inputs=3)),
        (BALL, ([0, 2, 1], [0, 1, 2]), message("time-before", time=1.0, sample=3, before=2.0)),
        (BALL, ([0, 1, 1], [0, 1, 2], [0.0, 1.0, 2.0]), message("inputs-differ", time=1.0, first=2, second=3)),
        (BALL, ([0, 1], [0, np.inf]), message("sample-not-finite", WHERE, quantity="state", place="sample 2, state 1")),
        (BALL, ([0], [0], [np.nan]), message("sample-not-finite", WHERE, quantity="input", place="sample 1, input 1")),
        (BALL, ([0, 1], [np.nan, 0]), message("first-sample-empty", WHERE)),
        (partial(BALL, below=[[np.nan], [1.0]]), ([0, 1], [3.0, 2.0]), message("censored-shape", WHERE)),
        (
            partial(BALL, below=[[np.nan], [np.nan], [1.0]]),
            ([0, 1, 1], [3.0, 2.0, np.nan]),
            message("censored-replicates", WHERE, time=1.0),
        ),
        (BALL, ([0, 1], ["a", "b"]), message("not-an-array", WHERE)),
        (BALL, ([[0, 1]], [0, 1]), message("array-dimensions", WHERE, dimensions=1)),
        (Schema, ((),), "no-state-named"),
        (Schema, (("t",),), message("column-name-twice", name="t")),
        (trials_of, (), "no-trial"),
        (trials_of, (ramp(), ramp(run=1.0)), message("trial-twice", trial=WHERE)),
        (trials_of, (ramp(states=2),), message("columns-of-trial", trial=WHERE, given=2, kind="states")),
        (partial(trials_of, bell={"mass": 1}), (ramp(),), "properties-of-no-trial"),
        (partial(trials_of, ball={"x": 1}), (ramp(),), message("property-named-like-column", name="x")),
        (
            partial(trials_of, ball={"m": np.nan}),
            (ramp(),),
            message("property-unknown-value", property="m", object="ball"),
        ),
        (
            partial(trials_of, a={"mass": 1}, b={"mass": "??"}),
            (ramp("a"), ramp("b")),
            message("property-of-two-kinds", property="mass", known=1.0, first="a", value="??", second="b"),
        ),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(make, arguments, expected):
    with refused(expected):
        make(*arguments)


def test_one_trial_comes_from_plain_arrays_in_which_masked_measurements_are_missing():
    trials = Trials.from_arrays(range(3), np.ones((3, 2)), inputs=[4, 5, 6])
    assert (trials.schema.states, trials.schema.inputs, trials.objects) == (("x1", "x2"), ("u",), ("object",))
    np.testing.assert_array_equal(trials[0].inputs, [[4], [5], [6]])
    states = np.ma.masked_values([1.0, -999.0, 0.6, 0.5], -999.0)
    (trial,) = Trials.from_arrays(np.arange(4.0), states)
    assert trial.times.tolist() == [0.0, 2.0, 3.0]
    pairs = np.ma.masked_values(np.arange(24.0).reshape(12, 2), 7.0)
    (trial,) = Trials.from_arrays(np.arange(12.0), pairs)
    assert np.argwhere(np.isnan(trial.states)).tolist() == [[3, 1]]


def test_lists_of_arrays_may_differ_in_length_and_are_counted_by_object():
    trials = Trials.from_arrays(
        [np.arange(3), pd.Series([0, 1], index=[7, 8]), np.arange(4)],
        [np.arange(3), [1, 2], np.ones((4, 1))],
        object=["a", "b", "a"],
        names=["height"],
        units={"height": "m", "mass": "kg"},
        properties=pd.DataFrame({"object": ["b", "a"], "mass": [1, 2]}),
    )
    assert labels(trials) == [("a", "1"), ("b", "1"), ("a", "2")]
    assert trials.schema == Schema(("height",), units={"height": "m", "mass": "kg"})
    assert trials.properties == {"a": {"mass": 2.0}, "b": {"mass": 1.0}}
    assert labels(Trials.from_arrays(np.ones((2, 1)), np.ones((2, 1)), trial=["x", 7])) == [
        ("object", "x"),
        ("object", "7"),
    ]


@pytest.mark.parametrize(
    ("keywords", "expected"),
    [
        ({"times": []}, "no-times"),
        ({"states": [[1, 2]]}, message("one-per-trial", given=1, parts="arrays of states", trials=2)),
        ({"object": ["a"]}, message("one-per-trial", given=1, parts="objects", trials=2)),
        ({"names": ["x", "y"]}, message("names-count", states=1)),
        ({"units": {"y": "m"}}, message("unknown-name", kind="column", name="y")),
        ({"properties": {"a": {"mass": 1}}}, "properties-of-no-trial"),
        ({"properties": {"object": 1}}, message("properties-not-by-name", object="object", value=1)),
    ],
)
def test_arrays_that_do_not_fit_are_refused(keywords, expected):
    given = {"times": [[0, 1], [0, 1]], "states": [[1, 2], [3, 4]], **keywords}
    if not given["times"]:
        given["states"] = []
    with refused(expected):
        Trials.from_arrays(**given)


def test_samples_up_to_a_time_are_taken_and_trials_that_begin_later_left_out():
    trials = Trials.from_arrays([[0.0, 1.0, 2.0], [5.0, 6.0]], [[1.0, 2.0, 3.0], [4.0, 5.0]])
    early = trials.until(1.0)
    assert [each.times.tolist() for each in early] == [[0.0, 1.0]]
    assert trials.until(np.inf).objects == trials.objects
    with refused("trials-begin-later", time_name="t", time=-1.0):
        trials.until(-1.0)


@pytest.mark.parametrize("index", [10**9, -(10**9), [0, 5]])
def test_an_index_beyond_the_trials_is_refused_in_words(index):
    trials = Trials.from_arrays([[0.0, 1.0]] * 2, [[1.0, 2.0]] * 2)
    with refused("trial-index", trials=2) as raised:
        trials[index]
    assert isinstance(raised.value, IndexError)


@pytest.mark.parametrize("scale", [1e100, 1e-100])
def test_times_that_nothing_can_be_computed_with_are_refused(scale):
    with refused("times-too-large", trial="object, trial 1"):
        Trials.from_arrays(np.arange(5) * scale, np.arange(5.0))
    assert len(Trials.from_arrays(np.arange(5) * scale**0.5, np.arange(5.0))) == 1


def test_dates_are_times_since_the_earliest_of_all_trials():
    dates = np.array(["2024-03-31T01:30", "2024-03-31T01:32", "2024-03-31T01:36"], dtype="datetime64[m]")
    trials = Trials.from_arrays([dates + 4, dates], [[1, 2, 3], [4, 5, 6]])
    assert [trial.times.tolist() for trial in trials] == [[240, 360, 600], [0, 120, 360]]
    assert (trials.schema.units, trials.notes[0]) == (
        {"t": "s"},
        "t: dates taken as time in seconds since 2024-03-31 01:30:00",
    )
    (spans,) = Trials.from_arrays(dates - dates[0], [1, 2, 3])
    assert spans.times.tolist() == [0, 120, 360]
    (stamps,) = Trials.from_arrays(pd.DatetimeIndex(dates), [1, 2, 3])
    assert stamps.times.tolist() == [0, 120, 360]
    with refused("not-an-array"):
        Trial("cup", "1", dates, np.ones(3))


def test_trials_are_equal_by_what_was_measured(trials):
    same = dataclasses.replace(copy.deepcopy(trials), notes=("sorted",))
    assert same == trials
    assert hash(same) == hash(trials)
    assert same[0] == trials[0] != trials[1]
    with_gap = np.where(trials[0].times[:, np.newaxis] > 0.1, np.nan, trials[0].states)
    gap, again = (trials.with_trials([dataclasses.replace(trials[0], states=with_gap)]) for _ in range(2))
    assert gap == again != trials.with_trials([trials[0]])
    assert trials != trials.with_properties({trials.objects[0]: {"charge": 1.0}})
    assert trials != "trials"


def test_excluded_measurements_leave_the_inputs_at_their_times():
    times = np.arange(6.0)
    rows = {"object": "a", "t": times, "x": times**2, "u": 10 * times}
    trials = Trials.from_frame(pd.DataFrame(rows), inputs=["u"])
    (trial,) = trials.exclude(between=(2.0, 3.0))
    np.testing.assert_array_equal(trial.states[:, 0], [0.0, 1.0, np.nan, np.nan, 16.0, 25.0])
    np.testing.assert_array_equal(trial.inputs[:, 0], 10 * times)
    (late,) = trials.exclude(between=(-1.0, 1.0))
    np.testing.assert_array_equal(late.times, times[2:])
    with refused("everything-excluded"):
        trials.exclude(object="a")


def test_blanks_are_subtracted_at_their_times_and_between():
    times = np.array([0.0, 1.0, 2.0])
    plate = Trials.from_arrays(
        [times, times[::2], times[::2]], [5.0 + times, [1.0, 3.0], [2.0, 4.0]], object=["a", "b", "c"], names=["OD"]
    )
    (trial,) = plate.subtract_blanks("b", "c")
    np.testing.assert_allclose(trial.states[:, 0], 5.0 + times - [1.5, 2.5, 3.5])
    with refused("blanks-only"):
        plate.subtract_blanks("a", "b", "c")
    with refused("blank-not-measured"):
        Trials((ramp("a", states=2), BALL([0, 1], [[1.0, np.nan]] * 2)), Schema(("x", "y"))).subtract_blanks("ball")
