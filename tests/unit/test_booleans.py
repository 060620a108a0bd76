"""Booleans are the same numbers in a frame and in every file."""

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl

TIMES = np.linspace(0, 3, 12)
FRAME = pd.DataFrame(
    {
        "object": np.repeat(["a", "b"], 12),
        "t": np.tile(TIMES, 2),
        "x": np.round(np.concatenate([np.exp(-TIMES), np.exp(-2 * TIMES)]), 3),
        "pumped": np.tile(TIMES > 1.5, 2),
        "coated": np.repeat([True, False], 12),
    }
)


def same(one, other):
    """Whether two trials have the same samples, names and properties."""
    assert (one.schema, one.objects, one.properties) == (other.schema, other.objects, other.properties)
    for first, second in zip(one, other, strict=True):
        np.testing.assert_allclose(first.states, second.states)
        np.testing.assert_allclose(first.inputs, second.inputs)


@pytest.mark.parametrize("ending", ["csv", "parquet", "xlsx"])
def test_booleans_of_a_file_are_those_of_the_frame(tmp_path, ending):
    path = tmp_path / f"table.{ending}"
    {"csv": FRAME.to_csv, "parquet": FRAME.to_parquet, "xlsx": FRAME.to_excel}[ending](path, index=False)
    trials, read = cl.Trials.from_frame(FRAME), cl.Trials.read(path)
    same(trials, read)
    assert trials.properties == {"a": {"coated": 1.0}, "b": {"coated": 0.0}}
    assert trials.schema.inputs == ("pumped",)


@pytest.mark.parametrize("words", ["TRUE FALSE", "true false", "True False"])
def test_booleans_of_other_programs_are_read(tmp_path, words):
    frame = FRAME.assign(coated=np.repeat(words.split(), 12))
    frame.to_csv(tmp_path / "table.csv", index=False)
    same(cl.Trials.from_frame(FRAME), cl.Trials.read(tmp_path / "table.csv"))


def test_trials_with_booleans_come_back_from_csv(tmp_path):
    trials = cl.Trials.from_frame(FRAME)
    trials.to_csv(tmp_path / "trials.csv")
    same(trials, cl.Trials.read(tmp_path / "trials.csv"))


def test_a_boolean_state_and_a_missing_boolean_are_read(tmp_path):
    frame = FRAME[:12].assign(pumped=pd.Series([None, *(TIMES > 1.5)[1:]], dtype=object))
    frame.to_csv(tmp_path / "table.csv", index=False)
    names = {"states": ["x", "pumped"], "properties": ["coated"]}
    same(cl.Trials.from_frame(frame, **names), cl.Trials.read(tmp_path / "table.csv", **names))
