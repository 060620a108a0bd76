"""Irregular samples, and what else the check of trials finds."""

import json

import numpy as np
import pytest

from commonlaw.trials import Trials
from tests.refusals import refused

T = np.arange(30) / 15


def ball(*states, times=T, **keywords):
    return Trials.from_arrays(times, np.column_stack(states), object="ball", **keywords)


def fall(times=T, noise=0.0):
    return 50 - 4.9 * times**2 + noise * np.random.default_rng(0).standard_normal(len(times))


@pytest.fixture(scope="module")
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
    for before, after, stricter in zip(drops, clipped, drops.clip_irregular(0.005), strict=True):
        np.testing.assert_array_equal(stricter.times, after.times)
        np.testing.assert_array_equal(after.states, before.states[: len(after)])
        np.testing.assert_array_equal(after.times, before.times[: len(after)])
    assert "Volleyball" not in clipped.notes[-1]


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


@pytest.mark.parametrize("sample", [0, 1, 12, 29])
def test_a_stray_value_is_named_by_its_cell_however_large_it_is(sample):
    values = fall(noise=0.01)
    values[sample] = 1e30
    stray, *_ = ball(values, times=0.5 * T).check().found
    assert (stray.sample, stray.column) == (sample, "x")
    assert f"1e+30 at t = {0.5 * T[sample]:g} may be a stray value" in stray.text


@pytest.mark.parametrize("values", [np.where(T < 12, 0.0, 5.0) + np.sin(T), 10.0**T, 1.5**-T])
def test_steps_and_exponentials_are_not_stray_values(values):
    assert not [finding for finding in ball(values).check().findings if "stray" in finding]


def test_trials_that_are_irregular_throughout_are_not_to_be_clipped():
    findings = ball([1.0, 3.0, 4.0, 7.0, 9.0], times=[118.0, 484.0, 664.0, 1004.0, 1231.0]).check().findings
    assert findings[0].startswith("ball, trial 1: irregular sampling: steps are up to 104 off their median 284")
    assert not any("clip" in finding for finding in findings)


@pytest.mark.parametrize("tolerance", [0, -1, float("nan")])
def test_a_tolerance_that_is_no_time_is_refused(drops, tolerance):
    with refused("step-tolerance", tolerance=tolerance):
        drops.clip_irregular(tolerance)


def test_the_check_has_the_figures_of_every_trial_as_a_table_and_json(drops):
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
