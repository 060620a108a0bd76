import numpy as np
import pytest

import commonlaw as cl
from commonlaw.trials import stream


@pytest.mark.parametrize("rows", [7, 49, 173, 100_000])
def test_streamed_trials_are_those_of_the_file_wherever_batches_end(tmp_path, monkeypatch, rows):
    trials = cl.datasets.linear_drag(trials=3)
    trials.to_parquet(tmp_path / "drops.parquet")
    monkeypatch.setattr(stream, "_ROWS", rows)
    streamed = cl.TrialStream.from_parquet(tmp_path / "drops.parquet")
    assert streamed.schema.states == ("x",)
    assert streamed.schema.units["x"] == "m"
    for _ in range(2):
        for one, other in zip(streamed, trials, strict=True):
            assert one.label == other.label
            np.testing.assert_array_equal(one.times, other.times)
            np.testing.assert_array_equal(one.states, other.states)


def test_rows_of_a_trial_that_do_not_follow_each_other_are_refused(tmp_path, monkeypatch):
    frame = cl.datasets.linear_drag(drag=-0.1, trials=2).to_frame()
    frame.sort_values(["t", "trial"]).to_parquet(tmp_path / "drops.parquet")
    monkeypatch.setattr(stream, "_ROWS", 10)
    roles = {"object": "object", "trial": "trial", "time": "t", "states": ["x"]}
    with pytest.raises(cl.CommonlawError, match="the rows of Ball 1, trial 1 do not follow each other"):
        list(cl.TrialStream.from_parquet(tmp_path / "drops.parquet", **roles))


def test_a_stream_needs_its_roles_named_and_a_parquet_file(tmp_path):
    cl.datasets.linear_drag(drag=-0.1).to_frame().to_parquet(tmp_path / "drops.parquet")
    with pytest.raises(cl.CommonlawError, match="say which column is what for a stream: object, trial, time, states"):
        cl.TrialStream.from_parquet(tmp_path / "drops.parquet")
    (tmp_path / "drops.csv").write_text("t,x\n0,1\n")
    with pytest.raises(cl.CommonlawError, match=r"drops.csv is no Parquet file .* only Parquet can be streamed"):
        cl.TrialStream.from_parquet(tmp_path / "drops.csv")
    with pytest.raises(cl.CommonlawError, match=r"there is no file 'gone.parquet'"):
        cl.TrialStream.from_parquet(tmp_path / "gone.parquet")
