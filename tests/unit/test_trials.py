"""Trials: from arrays, in selections, with units, repeats and nameless objects, and what checks say of them."""

import copy
import dataclasses
import json
import pickle
import subprocess
import sys

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import least_squares
from sklearn.model_selection import GroupKFold, KFold

import commonlaw as cl
from commonlaw.diagnostics import Diagnostic
from commonlaw.law import Law, Uncertainty
from commonlaw.law.parameters import standard_errors
from commonlaw.library import Variables, parse_library
from commonlaw.trials import Schema, Trial, Trials
from commonlaw.trials.headers import known_unit, registry
from commonlaw.trials.transformations import in_units, with_logarithms, with_starts, without_rates
from tests.refusals import refused


def ramp(name="ball", run="1", samples=4, states=1):
    return Trial(name, run, np.arange(samples) / 10, np.arange(float(samples * states)).reshape(samples, states))


@pytest.fixture
def trials():
    made = [ramp(name, run) for name in ("golf", "tennis", "wiffle") for run in ("1", "2")]
    properties = {"golf": {"mass": 0.046, "skin": "hard"}, "tennis": {"mass": 0.057, "skin": "felt"}}
    return Trials(tuple(made), Schema(("x",)), properties)


def labels(trials):
    return [(trial.object, trial.name) for trial in trials]


def test_selection_by_names_takes_numbers_for_labels(trials):
    assert labels(trials.select(object="golf", trial=2)) == [("golf", "2")]
    assert labels(trials.select(object=["golf", "wiffle"], trial=1.0)) == [("golf", "1"), ("wiffle", "1")]
    assert len(trials.select(trial=range(1, 3))) == 6


def test_selection_by_property_takes_values_and_functions(trials):
    assert trials.select(skin="felt").objects == ("tennis",)
    assert trials.select(mass=lambda mass: mass < 0.05).objects == ("golf",)
    assert trials.select(mass=[0.046, 0.057], trial=1).objects == ("golf", "tennis")


def test_selection_keeps_the_properties_of_the_objects_kept(trials):
    assert trials.select(object="golf").properties == {"golf": {"mass": 0.046, "skin": "hard"}}
    assert trials.select(object="wiffle").properties == {}


@pytest.mark.parametrize(
    ("conditions", "message"),
    [
        ({"object": "gulf"}, Diagnostic("unknown-name", {"kind": "object", "name": "gulf"})),
        ({"trial": 3}, Diagnostic("unknown-name", {"kind": "trial", "name": "3"})),
        ({"mas": 1}, Diagnostic("unknown-name", {"kind": "property", "name": "mas"})),
        ({"object": "golf", "skin": "felt"}, Diagnostic("no-trial-fits", {"conditions": "object=golf, skin=felt"})),
    ],
)
def test_selection_refuses_what_is_not_there(trials, conditions, message):
    with refused(message):
        trials.select(**conditions)


def test_split_parts_the_trials_in_two(trials):
    chosen, rest = trials.split(trial=1)
    assert labels(chosen) == [("golf", "1"), ("tennis", "1"), ("wiffle", "1")]
    assert sorted(labels(chosen) + labels(rest)) == sorted(labels(trials))
    with refused("split-one-sided"):
        trials.split(trial=[1, 2])


def test_indexing_is_that_of_an_array_of_trials(trials):
    assert trials[-1] is trials.trials[-1]
    assert labels(trials[1:3]) == labels(trials[[1, 2]]) == labels(trials[np.array([1, 2])])
    assert labels(trials[np.arange(6) < 2]) == labels(trials[:2])
    with refused("no-trial"):
        trials[[]]


def test_splitters_of_scikit_learn_work_on_trials(trials):
    groups = [trial.object for trial in trials]
    folds = [(trials[train], trials[test]) for train, test in GroupKFold(3).split(trials, groups=groups)]
    assert sorted(test.objects[0] for _, test in folds) == ["golf", "tennis", "wiffle"]
    assert all(not set(train.objects) & set(test.objects) for train, test in folds)
    assert [len(trials[test]) for _, test in KFold(3).split(trials)] == [2, 2, 2]


def test_trials_cannot_be_changed(trials):
    with pytest.raises(dataclasses.FrozenInstanceError):
        trials.notes = ()
    with pytest.raises(ValueError, match="read-only"):
        trials[0].states[0] = 1.0
    given = np.zeros(3)
    made = Trial("ball", "1", np.arange(3.0), given)
    given[0] = 9.0
    assert made.states[0, 0] == 0.0


def test_trials_are_copied_and_pickled_with_all_they_hold(trials):
    for other in (pickle.loads(pickle.dumps(trials)), copy.deepcopy(trials)):
        assert labels(other) == labels(trials)
        assert (other.schema, other.properties) == (trials.schema, trials.properties)
        np.testing.assert_array_equal(other[3].states, trials[3].states)


def test_labels_are_the_same_however_they_are_written():
    assert ramp(3, 1.0).label == ramp(" 3", "1.0").label == "3, trial 1"


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: ramp(name=" "), "label-empty"),
        (lambda: ramp(samples=0), Diagnostic("trial-without-samples", {"trial": "ball, trial 1"})),
        (
            lambda: Trial("ball", "1", [0, 1, 2], [0, 1]),
            Diagnostic("rows-differ", {"times": 3, "states": 2, "inputs": 3}, "ball, trial 1"),
        ),
        (
            lambda: Trial("ball", "1", [0, 2, 1], [0, 1, 2]),
            Diagnostic("time-before", {"time": 1.0, "sample": 3, "before": 2.0}),
        ),
        (
            lambda: Trial("ball", "1", [0, 1, 1], [0, 1, 2], [0.0, 1.0, 2.0]),
            Diagnostic("inputs-differ", {"time": 1.0, "first": 2, "second": 3}),
        ),
        (
            lambda: Trial("ball", "1", [0, 1], [0, np.inf]),
            Diagnostic("sample-not-finite", {"quantity": "state", "place": "sample 2, state 1"}, "ball, trial 1"),
        ),
        (
            lambda: Trial("ball", "1", [0, 1], [0, 1], [0, np.nan]),
            Diagnostic("sample-not-finite", {"quantity": "input", "place": "sample 2, input 1"}, "ball, trial 1"),
        ),
        (lambda: Trial("ball", "1", [0, 1], [np.nan, 0]), Diagnostic("first-sample-empty", {}, "ball, trial 1")),
        (lambda: Trial("ball", "1", [0, 1], ["a", "b"]), Diagnostic("not-an-array", {}, "ball, trial 1")),
        (
            lambda: Trial("ball", "1", [[0, 1]], [0, 1]),
            Diagnostic("array-dimensions", {"dimensions": 1}, "ball, trial 1"),
        ),
        (lambda: Schema(()), "no-state-named"),
        (lambda: Schema(("t",)), Diagnostic("column-name-twice", {"name": "t"})),
        (lambda: Trials((), Schema(("x",))), "no-trial"),
        (
            lambda: Trials((ramp(), ramp(run=1.0)), Schema(("x",))),
            Diagnostic("trial-twice", {"trial": "ball, trial 1"}),
        ),
        (
            lambda: Trials((ramp(states=2),), Schema(("x",))),
            Diagnostic("columns-of-trial", {"trial": "ball, trial 1", "given": 2, "kind": "states"}),
        ),
        (lambda: Trials((ramp(),), Schema(("x",)), {"bell": {"mass": 1}}), "properties-of-no-trial"),
        (
            lambda: Trials((ramp(),), Schema(("x",)), {"ball": {"x": 1}}),
            Diagnostic("property-named-like-column", {"name": "x"}),
        ),
        (
            lambda: Trials((ramp(),), Schema(("x",)), {"ball": {"mass": np.nan}}),
            Diagnostic("property-unknown-value", {"property": "mass", "object": "ball"}),
        ),
        (
            lambda: Trials((ramp("a"), ramp("b")), Schema(("x",)), {"a": {"mass": 1}, "b": {"mass": "??"}}),
            Diagnostic(
                "property-of-two-kinds", {"property": "mass", "known": 1.0, "first": "a", "value": "??", "second": "b"}
            ),
        ),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(make, message):
    with refused(message):
        make()


def test_one_trial_comes_from_plain_arrays():
    trials = Trials.from_arrays(range(3), np.ones((3, 2)), inputs=[4, 5, 6])
    assert (trials.schema.states, trials.schema.inputs, trials.objects) == (("x1", "x2"), ("u",), ("object",))
    np.testing.assert_array_equal(trials[0].inputs, [[4], [5], [6]])


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
    ("keywords", "message"),
    [
        ({"times": []}, "no-times"),
        ({"states": [[1, 2]]}, Diagnostic("one-per-trial", {"given": 1, "parts": "arrays of states", "trials": 2})),
        ({"object": ["a"]}, Diagnostic("one-per-trial", {"given": 1, "parts": "objects", "trials": 2})),
        ({"names": ["x", "y"]}, Diagnostic("names-count", {"states": 1})),
        ({"units": {"y": "m"}}, Diagnostic("unknown-name", {"kind": "column", "name": "y"})),
        ({"properties": {"a": {"mass": 1}}}, "properties-of-no-trial"),
        ({"properties": {"object": 1}}, Diagnostic("properties-not-by-name", {"object": "object", "value": 1})),
    ],
)
def test_arrays_that_do_not_fit_are_refused(keywords, message):
    given = {"times": [[0, 1], [0, 1]], "states": [[1, 2], [3, 4]], **keywords}
    if not given["times"]:
        given["states"] = []
    with refused(message):
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


def test_masked_measurements_are_missing():
    states = np.ma.masked_values([1.0, -999.0, 0.6, 0.5], -999.0)
    (trial,) = Trials.from_arrays(np.arange(4.0), states)
    assert trial.times.tolist() == [0.0, 2.0, 3.0]
    pairs = np.ma.masked_values(np.arange(24.0).reshape(12, 2), 7.0)
    (trial,) = Trials.from_arrays(np.arange(12.0), pairs)
    assert np.argwhere(np.isnan(trial.states)).tolist() == [[3, 1]]


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


T = np.arange(30) / 15


def ball(*states, times=T, **keywords):
    return Trials.from_arrays(times, np.column_stack(states), object="ball", **keywords)


def fall(times=T, noise=0.0):
    return 50 - 4.9 * times**2 + noise * np.random.default_rng(0).standard_normal(len(times))


@pytest.fixture
def drops(ball_drops_folder):
    trials = Trials.read(ball_drops_folder / "Ball_drops_data.xls", trial="Drop #", states="Height")
    return trials.split(object="Bowling Ball")[1]


def test_the_measured_drops_are_clipped_as_in_the_paper(drops):
    clipped = drops.clip_irregular()
    lengths = {trial.label: (len(before), len(trial)) for before, trial in zip(drops, clipped, strict=True)}
    assert lengths["Golf Ball, trial 1"] == (43, 42)
    assert lengths["Baseball, trial 1"] == (44, 42)
    assert lengths["Baseball, trial 2"] == (44, 43)
    assert min(after for _, after in lengths.values()) == 42
    assert sum(before != after for before, after in lengths.values()) == 7
    assert "Golf Ball, trial 1 from 43 to 42 samples" in clipped.notes[-1]
    assert "irregular frame, a step more than 7.5 % off" in clipped.notes[-1]
    for before, after in zip(drops.clip_irregular(0.005), clipped, strict=True):
        np.testing.assert_array_equal(before.times, after.times)
    assert "Volleyball" not in clipped.notes[-1]


def test_clipping_keeps_the_first_samples_as_they_are(drops):
    for before, after in zip(drops, drops.clip_irregular(), strict=True):
        np.testing.assert_array_equal(after.states, before.states[: len(after)])
        np.testing.assert_array_equal(after.times, before.times[: len(after)])


def test_regular_trials_are_not_touched(drops):
    regular = ball(fall())
    assert regular.clip_irregular() is regular
    assert drops.clip_irregular(tolerance=1.0) is drops
    assert Trials.from_arrays([1.0], [2.0]).clip_irregular()[0].times.tolist() == [1.0]


@pytest.mark.parametrize("unit", [1e-6, 1.0, 86400.0])
def test_what_is_irregular_does_not_depend_on_the_unit_of_the_times(unit):
    times = np.append(T, T[-1] + 0.1) * unit
    late = ball(fall(np.append(T, 2.0)), times=times)
    assert [len(each) for each in late.clip_irregular()] == [30]
    (finding, *_) = late.check().findings
    assert finding == "ball, trial 1: irregular frame: `clip_irregular()` would keep 30 of 31 samples"


def test_what_is_odd_knows_its_trial_sample_and_column():
    late, values = fall(), fall()
    late[20], values[12] = np.nan, 80.0
    missing, jump, _ = ball(late, values).check().found
    assert (missing.object, missing.trial, missing.sample, missing.column) == ("ball", "1", 20, "x1")
    assert (jump.sample, jump.column) == (12, "x2")
    assert str(jump).startswith("ball, trial 1: x2 jumps by")


def test_trials_that_are_irregular_throughout_are_not_to_be_clipped():
    findings = ball([1.0, 3.0, 4.0, 7.0, 9.0], times=[118.0, 484.0, 664.0, 1004.0, 1231.0]).check().findings
    assert findings[0].startswith("ball, trial 1: irregular sampling: steps are up to 104 off their median 284")
    assert not any("clip" in finding for finding in findings)


@pytest.mark.parametrize("tolerance", [0, -1, float("nan")])
def test_a_tolerance_that_is_no_time_is_refused(drops, tolerance):
    with refused("step-tolerance", tolerance=tolerance):
        drops.clip_irregular(tolerance)


def test_the_check_has_the_figures_of_every_trial(drops):
    report = drops.check()
    row = next(each for each in report.trials if (each.object, each.trial) == ("Golf Ball", "1"))
    trial = drops.select(object="Golf Ball", trial=1)[0]
    assert (row.samples, row.clipped) == (43, 1)
    assert row.duration == trial.times[-1] - trial.times[0]
    assert row.median_step == pytest.approx(1 / 15)
    assert row.largest_deviation == pytest.approx(1 / 30, abs=1e-6)
    assert (row.first, row.last) == ({"Height": trial.states[0, 0]}, {"Height": trial.states[-1, 0]})
    assert "Golf Ball, trial 1: irregular frame: `clip_irregular()` would keep 42 of 43 samples" in report.findings
    assert [len(drops[i]) - row.clipped for i, row in enumerate(report.trials)] == [*map(len, drops.clip_irregular())]


def test_the_report_is_a_table_and_json(drops):
    report = drops.clip_irregular().check()
    frame = report.to_frame()
    assert len(frame) == 20
    assert {"object", "trial", "samples", "Height (first)", "Height (last)"} <= set(frame.columns)
    assert json.loads(json.dumps(report.to_dict(), allow_nan=False))["notes"] == list(report.notes)


def test_data_checks_find_nothing_in_good_trials():
    for start in (0.0, 1.7e9):
        trials = ball(fall(noise=0.01), times=start + T, names=["h"], units={"h": "m", "t": "s"})
        assert trials.check().findings == ()


def bumped(values, index, by):
    values = values.copy()
    values[index:] += by
    return values


@pytest.mark.parametrize(
    ("trials", "finding"),
    [
        (ball(fall(), np.full(30, 3.0)), "ball, trial 1: x2 is constant, 3 in every sample"),
        (ball(fall()[:3], times=T[:3]), "ball, trial 1: very short, 3 samples"),
        (ball(fall()[:1], times=T[:1]), "ball, trial 1: very short, 1 samples"),
        (
            ball(np.arange(20.0) ** 2, times=np.sort(np.random.default_rng(0).random(20)) / 100),
            "ball, trial 1: irregular sampling: steps are up to",
        ),
        (
            ball(fall(), times=1.7e9 + T / 100),
            "ball, trial 1: times are rounded to 2.4e-07, 0.00036 of a step, as they are so large: count them from",
        ),
        (ball(bumped(fall(noise=0.01), 12, 2.0)), "ball, trial 1: x jumps by 1.48 from sample 12 to sample 13"),
        (ball(bumped(3 * T, 29, 4.0)), "ball, trial 1: x jumps by 4.2 from sample 29 to sample 30"),
        (ball(bumped(3 * T, 1, -4.0)), "ball, trial 1: x jumps by -3.8 from sample 1 to sample 2"),
        (
            Trials.from_arrays([T, T[:10]], [fall(), fall()[:10]], object="ball"),
            "ball: trials of very different lengths, 10 to 30 samples",
        ),
        (ball(fall(), names=["h"], units={"t": "s"}), "no unit is known for h: write it in the header"),
        (ball(fall()), "no unit is known for t, x: "),
    ],
)
def test_what_data_checks_find_is_said_in_words(trials, finding):
    assert any(each.startswith(finding) for each in trials.check().findings), trials.check().findings


def test_a_value_out_of_line_is_named_at_its_sample():
    values = fall(noise=0.01)
    values[12] += 5.0
    assert any("from sample 12 to sample 13" in finding for finding in ball(values).check().findings)


@pytest.mark.parametrize(
    "values",
    [
        np.round(fall(), 1),
        np.floor(T * 7) / 4,
        np.sin(2 * np.pi * T),
        np.exp(3 * T),
        np.random.default_rng(1).standard_normal(30),
        5 + 0 * T + 1e-15 * np.arange(30),
    ],
)
def test_coarse_smooth_and_noisy_measurements_do_not_jump(values):
    assert not [finding for finding in ball(values).check().findings if "jumps" in finding]


def test_units_without_a_unit_column_are_only_missing_where_used():
    trials = ball(fall(), names=["h"], units={"h": "m", "t": "s"})
    assert (
        Trials(trials.trials, Schema(("h",), units={"h": "m"}))
        .check()
        .findings[0]
        .startswith("no unit is known for t:")
    )


@pytest.mark.parametrize("unit", ["cells", "individuals", "CFU", "OD", "IU", "counts", "people", "copies"])
def test_counts_are_units_without_a_dimension(unit):
    assert known_unit(unit).dimensionless
    trials = Trials.from_frame(pd.DataFrame({f"N [{unit}/mL]": [1.0, 2.0], "t [min]": [0.0, 1.0]}))
    assert trials.schema.states == ("N",)
    assert trials.schema.units == {"N": f"{unit}/mL", "t": "min"}


def test_counts_are_converted_as_numbers():
    assert registry().Quantity(1, "cells/mL").m_as("1/L") == pytest.approx(1000)
    assert registry().Quantity(0.01, "OD/min").m_as("OD/h") == pytest.approx(0.6)


@pytest.mark.parametrize(("unit", "name"), [("m", "meter"), ("cd", "candela"), ("pF", "picofarad"), ("P", "poise")])
def test_counts_take_no_unit_of_physics_away(unit, name):
    assert str(known_unit(unit)) == name


def test_units_can_be_compared_where_several_threads_use_them_first():
    program = (
        "from concurrent.futures import ThreadPoolExecutor as Pool; from commonlaw.trials.headers import registry;"
        "print(len({id(each) for each in Pool(8).map(lambda _: registry(), range(8))}))"
    )
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "1\n"


def test_limits_of_quantification_change_with_their_state():
    states, below = np.array([[3.0, 0.0], [np.nan, 1.0], [2.0, 1.0]]), np.full((3, 2), np.nan)
    below[1, 0] = 500.0
    trial = Trial("a", "1", [0.0, 1.0, 2.0], states, below=below)
    trials = Trials((trial,), Schema(("m", "v"), units={"m": "mg"}))
    assert in_units(trials, {"m": "g"})[0].below[1, 0] == pytest.approx(0.5)
    logarithmic = with_logarithms(trials, ["m"])
    assert logarithmic[0].below[1, 0] == pytest.approx(np.log(500))
    assert in_units(logarithmic, {"m": "g"})[0].below[1, 0] == pytest.approx(np.log(0.5))
    np.testing.assert_array_equal(without_rates(trials, {"m": "v"})[0].below, below[:, :1])
    assert with_starts(trials, {"s": 1.0}, -1.0)[0].below[2, 0] == 500.0


FRAME = pd.DataFrame({"t": np.arange(8.0), "x": np.exp(-np.arange(8.0))})


def law_of(*objects):
    terms, count = parse_library("terms:x").bind(Variables(("x",))), len(objects)
    rates = -np.arange(1.0, count + 1).reshape(-1, 1, 1)
    return Law(
        terms, Schema(("x",)), 1, objects, rates, uncertainty=Uncertainty(1e-4 * np.ones((count, 1, 1)), noise=[0.1])
    )


def test_an_object_is_nameless_where_neither_table_nor_user_names_it():
    assert Trials.from_frame(FRAME).nameless
    assert Trials.from_arrays(FRAME["t"], FRAME["x"]).nameless
    assert Trials.from_frame(FRAME)[[0]].nameless
    assert not Trials.from_frame(FRAME, object_name="cup").nameless
    assert Trials.from_frame(FRAME, object_name="cup").objects == ("cup",)
    assert not Trials.from_frame(FRAME.assign(object="cup")).nameless
    assert not Trials.from_arrays(FRAME["t"], FRAME["x"], object="cup").nameless
    with refused("object-column-and-name", column="object"):
        Trials.from_frame(FRAME.assign(object="cup"), object_name="cup")


def test_a_nameless_object_has_the_coefficients_of_the_only_one_and_their_accuracy():
    nameless, named = Trials.from_frame(FRAME), Trials.from_frame(FRAME, object_name="cup")
    forecast, expected = (law_of("cup").predict(each, return_std=True) for each in (nameless, named))
    np.testing.assert_array_equal(forecast.trajectories[0].states, expected.trajectories[0].states)
    np.testing.assert_array_equal(forecast.std[0], expected.std[0])
    assert forecast.trials.objects == ("object",)
    remark = "no object is named: object has the coefficients of cup, the only object of the law"
    assert forecast.trials.notes == (remark,)
    assert expected.trials.notes == ()
    assert law_of("object", "cup").predict(nameless).trials.notes == ()


def test_which_object_of_several_is_not_guessed():
    with refused("object-unnamed", objects="cup, pot"):
        law_of("cup", "pot").predict(Trials.from_frame(FRAME))
    with refused("unknown-name", kind="object of this law", name="mug"):
        law_of("cup").predict(Trials.from_frame(FRAME, object_name="mug"))


TIMES = np.array([0.0, 5.0, 12.0, 20.0, 35.0, 60.0, 90.0])
COUNTS = np.array([3, 2, 3, 1, 4, 2, 3])


def decay(start, k, times):
    return start / (1 + start * k * times)


def rows(seed=0, noise=0.02):
    """A table of second-order decay with one to four measurements at each time."""
    times = np.repeat(TIMES, COUNTS)
    return pd.DataFrame(
        {"t": times, "a": decay(2.0, 0.05, times) + noise * np.random.default_rng(seed).normal(size=18)}
    )


def read(frame, **roles):
    return cl.Trials.from_frame(frame, time="t", states=["a"], **roles)


def of_all_rows(frame):
    """Coefficients, standard errors and noise by least squares of all rows."""
    fit = least_squares(lambda p: decay(p[0], p[1], frame.t) - frame.a, [2.0, 0.05], xtol=1e-14, ftol=1e-14, gtol=1e-14)
    variance = 2 * fit.cost / (len(frame) - 2)
    return fit.x, np.sqrt(variance * np.diag(np.linalg.inv(fit.jac.T @ fit.jac))), np.sqrt(variance)


def test_a_law_is_fitted_to_all_rows():
    frame = rows()
    trials = read(frame)
    law = cl.fit("a' = -k a^2", trials, errors="white")
    (start, k), (_, error), noise = of_all_rows(frame)
    k_of_law = -law.coefficients[0][0, 0]
    assert k_of_law == pytest.approx(k, abs=0.1 * error)
    assert standard_errors(law)[0][0, 0] == pytest.approx(error, rel=0.1)
    assert law.uncertainty.noise[0] == pytest.approx(noise, rel=0.1)
    assert law.uncertainty.degrees_of_freedom[0] == 16
    assert law.predict(trials, start="all").trajectories[0].states[0, 0] == pytest.approx(start, rel=1e-3)
    assert "18 measurements" in str([step for step in law.history if step.stage == "coefficients"])


def test_arrays_and_tables_hold_the_same_means_counts_and_squares():
    frame = rows()
    of_table = read(frame)[0]
    of_arrays = cl.Trials.from_arrays(frame.t.to_numpy(), frame.a.to_numpy())
    groups = frame.groupby("t").a
    for trial in (of_table, of_arrays[0]):
        np.testing.assert_array_equal(trial.times, TIMES)
        np.testing.assert_allclose(trial.states[:, 0], groups.mean())
        np.testing.assert_array_equal(trial.counts[:, 0], COUNTS)
        np.testing.assert_allclose(trial.repeats.squares[:, 0], groups.apply(lambda a: np.sum((a - a.mean()) ** 2)))
        np.testing.assert_allclose(trial.std(np.array([0.3]))[:, 0], 0.3 / np.sqrt(COUNTS))
    assert of_arrays.notes == ("17 measurements at 6 times in 1 trial are averaged, weighted by their number",)
    assert of_arrays.notes == read(frame).notes


def test_measurements_with_standard_deviations_are_weighted_by_these():
    trial = Trial("a", "1", [0, 0, 1], [1.0, 2.0, 3.0], noise=np.array([1.0, 0.5, 1.0]))
    np.testing.assert_allclose(trial.states[:, 0], [(1 + 4 * 2) / 5, 3])
    np.testing.assert_allclose(trial.noise[:, 0], [5**-0.5, 1])
    np.testing.assert_allclose(trial.std(np.array([9.0])), trial.noise)


def test_a_value_that_is_missing_among_repeated_ones_does_not_count():
    trial = Trial("a", "1", [0, 0, 1, 1], np.array([[1.0, np.nan], [3.0, 5.0], [np.nan, 1.0], [np.nan, 2.0]]))
    np.testing.assert_array_equal(trial.counts, [[2, 1], [0, 2]])
    np.testing.assert_array_equal(trial.states, [[2, 5], [np.nan, 1.5]])
    np.testing.assert_array_equal(trial.rows(slice(1, None)).repeats.squares[:, 1], [0.5])


def test_units_and_logarithms_scale_the_scatter_of_repeated_measurements():
    trials = cl.Trials.from_arrays([0, 0, 1.0], [2.0, 4.0, 6.0], names=["a"])
    (logarithms,) = with_logarithms(trials, ["a"])
    np.testing.assert_allclose(logarithms.repeats.squares[0], 2 / 3**2)
    frame = pd.DataFrame({"t": [0, 0, 1.0, 2.0, 3.0], "x": [2.0, 4.0, 6.0, 7.0, 8.0]})
    metres = cl.Trials.from_frame(frame, time="t", states=["x"], units={"x": "m", "t": "s"})
    law = cl.Law.from_text("x' = a", {"a": 1.0}, units={"x": "cm", "t": "s"})
    forecast = law.predict(metres, start=1)
    np.testing.assert_allclose(forecast.trials[0].repeats.squares[0], 2 * 100**2)


def test_copies_of_rows_are_refused_and_a_column_that_separates_them_names_objects():
    frame = rows().drop_duplicates("t")
    with refused("copies"):
        read(pd.concat([frame, frame]).sort_values("t"))
    rigs = pd.concat([frame.assign(w=1), frame.assign(a=frame.a + 0.1, w=2)]).sort_values("t")
    assert read(rigs).objects == ("1", "2")


def test_rows_of_one_time_that_stand_apart_are_repeated_measurements_if_that_is_said():
    frame = rows().drop_duplicates("t")
    again = pd.concat([frame, frame.assign(a=frame.a + 0.1)])
    with refused("name-trials"):
        read(again)
    levels = pd.concat([rows().assign(dose=1), rows().assign(dose=2)])
    with refused("name-trials-by"):
        read(levels)
    np.testing.assert_allclose(read(again, restarts="sort")[0].states[:, 0], frame.a + 0.05)
