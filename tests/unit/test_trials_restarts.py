"""Rows whose times go back: refused, sorted, or trials of their own."""

import numpy as np
import pandas as pd
import pytest

from commonlaw.errors import CommonlawError
from commonlaw.trials import Trials, TrialStream
from tests.refusals import refused

T = np.arange(10.0)
RUNS = pd.DataFrame({"t": [*T, *(T + 0.5)], "x": [*np.exp(-T), *np.exp(-3 * T)]})


def test_times_that_start_again_are_refused_with_the_rows_and_what_to_do():
    with pytest.raises(CommonlawError) as refused:
        Trials.from_frame(RUNS)
    assert str(refused.value) == (
        "the frame: object, trial 1: the time decreases from 9 in row 10 to 0.5 in row 11; name the columns of "
        "trials and objects, trial=... and object=..., or use restarts='trials' if the rows of trials follow one "
        "another, or restarts='sort' if all rows are of one trial [time-decreases]"
    )


@pytest.mark.parametrize("samples", [3, 4, 40])
@pytest.mark.parametrize("runs", [2, 7])
@pytest.mark.parametrize("end", [0.1, 0.9])
def test_runs_below_each_other_are_never_interleaved(samples, runs, end):
    times = np.concatenate([np.arange(samples) + end * (samples - 1) * shift / runs for shift in range(runs)])
    with refused("name-trials"):
        Trials.from_frame(pd.DataFrame({"t": times, "x": times}))


def test_the_column_of_numbers_that_separates_trials_names_objects_unless_it_is_said_to_be_of_trials():
    frame = RUNS.assign(w=[1] * 10 + [2] * 10, y=np.arange(20) % 3)
    for times in (RUNS["t"], [*T, *T]):
        assert Trials.from_frame(frame.assign(t=times)).objects == ("1", "2")
    with refused("name-trials-by"):  # Too many numbers for names
        Trials.from_frame(frame.assign(w=np.arange(20) // 2))
    assert len(Trials.from_frame(frame, trial="w")) == 2
    assert Trials.from_frame(frame.rename(columns={"w": "run"})).schema.trial == "run"


def test_times_that_start_again_become_trials_or_one_where_this_is_asked():
    for frame in (RUNS, RUNS.assign(t=[*T, *T])):
        trials = Trials.from_frame(frame, restarts="trials")
        assert [trial.name for trial in trials] == ["1", "2"]
        assert [trial.states[:, 0].tolist() for trial in trials] == [np.exp(-T).tolist(), np.exp(-3 * T).tolist()]
        assert trials.notes == ("a trial begins wherever the time goes back: object, trial 1",)
    frame = pd.concat([RUNS.assign(trial="A"), RUNS[:10].assign(trial="B")])
    assert [each.name for each in Trials.from_frame(frame, restarts="trials")] == ["A-1", "A-2", "B"]
    (trial,) = Trials.from_frame(RUNS, restarts="sort")
    assert trial.times.tolist() == sorted(RUNS["t"])
    with refused("unknown-name", kind="restarts", name="split"):
        Trials.from_frame(RUNS, restarts="split")


@pytest.mark.parametrize("seed", range(3))
def test_rows_of_a_shuffled_table_are_sorted(seed):
    frame = pd.concat([RUNS[:10].assign(object=name) for name in "abcdefgh"])
    trials = Trials.from_frame(frame.sample(frac=1, random_state=seed))
    assert all(trial.times.tolist() == T.tolist() for trial in trials)


@pytest.mark.parametrize(
    "order", [[0, 1, 8, 3, 4, 5, 6, 7, 2, 9], [1, 0, 2, 3, 4, 7, 6], [0, 2, 3, 4, 5, 1], [3, 2, 1, 0]]
)
def test_single_rows_out_of_place_and_rows_in_reverse_order_are_sorted(order):
    (trial,) = Trials.from_frame(RUNS.iloc[order])
    assert trial.times.tolist() == sorted(order)


def test_a_stream_which_sees_a_part_of_the_rows_takes_no_restarts(tmp_path):
    RUNS.assign(object="a", trial="1").to_parquet(tmp_path / "a.parquet")
    with refused("unknown-name", kind="keyword", name="restarts"):
        TrialStream.from_parquet(tmp_path / "a.parquet", **{"states": "x", "restarts": "trials"})
