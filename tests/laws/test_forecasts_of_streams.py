"""Forecasts of all trials of a stream, and a report of few objects that stand for all."""

from importlib import import_module

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law import select_objects
from commonlaw.law.parameters import named_parameters
from commonlaw.law.script import Source, to_script
from commonlaw.law.tables import quantile_frame, spread_tables
from commonlaw.report.document import Picture, Table
from commonlaw.report.sections import all_objects
from commonlaw.stream import find_by_stream
from commonlaw.summary import Summary
from commonlaw.verdict import find
from tests.refusals import refused
from tests.streams import ROLES, drops_with_masses, write_files


@pytest.fixture(scope="module")
def drops():
    return drops_with_masses(30)


@pytest.fixture(scope="module")
def stream(tmp_path_factory, drops):
    folder = write_files(drops, tmp_path_factory.mktemp("runs"), 3)
    return cl.TrialStream.from_parquet(folder, **ROLES, properties=["mass"])


@pytest.fixture(scope="module")
def law(drops):
    return cl.fit("x'' = -g - c v", drops, errors="white")


def test_errors_are_those_of_forecasts_of_all_trials(law, stream, drops, tmp_path):
    found = cl.forecast_stream(law, stream, folder=tmp_path / "forecasts")
    whole = law.predict(drops, return_std=True)
    pd.testing.assert_frame_equal(found[list(whole.errors())], whole.errors())
    assert found["samples"].tolist() == [len(drop) for drop in drops]
    assert found["samples"].dtype == int
    np.testing.assert_allclose(found["spread"], [drop.states.std() for drop in drops])
    frame = whole.to_frame()
    inside = (frame["x measured low"] <= frame["x"]) & (frame["x"] <= frame["x measured high"])
    np.testing.assert_allclose(
        found["within 95 % band"], inside.groupby([frame["object"], frame["trial"]], sort=False).mean()
    )
    written = [pd.read_parquet(tmp_path / "forecasts" / f"forecast-00000{i}.parquet") for i in (1, 2, 3)]
    pd.testing.assert_frame_equal(pd.concat(written, ignore_index=True), frame, check_dtype=False)


@pytest.fixture(scope="module")
def explained(drops):
    """The law of half of the balls, whose drag follows from the mass."""
    seen = drops.objects[:15]
    half = drops.select(object=list(seen))
    trials = cl.Trials(half.trials, half.schema, {n: drops.properties[n] for n in seen})
    return cl.fit("x'' = -g - c v", trials, errors="white").explain()


def test_objects_that_the_law_has_not_seen_are_forecast_by_their_properties(explained, law, drops, stream):
    with refused("object-unknown", object="Ball 16"):
        cl.forecast_stream(select_objects(law, list(drops.objects[:15])), stream)
    expected = explained.predict(drops, return_std=True).errors()
    np.testing.assert_allclose(cl.forecast_stream(explained, stream)["rms error"], expected["rms error"], rtol=1e-6)


def test_objects_whose_properties_are_not_known_are_refused(explained, drops, tmp_path):
    cl.Trials(drops.select(object="Ball 16").trials, drops.schema).to_parquet(tmp_path / "16.parquet")
    stream = cl.TrialStream.from_parquet(tmp_path, **ROLES)
    with refused("object-without-properties", object="Ball 16"):
        cl.forecast_stream(explained, stream)


@pytest.mark.parametrize("first", [14, 15])
def test_a_law_is_judged_by_objects_of_which_it_knows_one_or_none(explained, drops, tmp_path, first):
    some = drops.select(object=list(drops.objects[first:18]))
    some.to_parquet(tmp_path / "some.parquet")
    found = find_by_stream(explained, cl.TrialStream.from_parquet(tmp_path, **ROLES, properties=["mass"]), str)
    assert found.score == pytest.approx(explained.predict(some).score(), abs=1e-9)
    shown = explained.predict(some, start=found.few.start)
    assert found.few.forecast.score() == pytest.approx(shown.score(), abs=1e-9)


def test_files_without_samples_on_both_sides_of_a_time_are_left_out(tmp_path):
    for name, end in (("a", 10.0), ("b", 1.0), ("c", 8.0)):
        times = np.linspace(0, end, 20)
        trials = cl.Trials.from_arrays([times], [np.exp(-0.3 * times)], object=[name], names=["x"])
        trials.to_parquet(tmp_path / f"{name}.parquet")
    stream = cl.TrialStream.from_parquet(tmp_path, **ROLES)
    law = cl.Law.from_text("x' = -k x", {"k": dict.fromkeys("abc", 0.3)})
    assert cl.forecast_stream(law, stream, from_time=5.0)["object"].tolist() == ["a", "c"]
    with refused("forecast-no-trial-from", from_time=20.0):
        cl.forecast_stream(law, stream, from_time=20.0)
    with refused("forecast-not-a-stream", type="Trials"):
        cl.forecast_stream(law, stream.read())


@pytest.mark.parametrize(
    "part",
    [
        pytest.param(lambda trials: (trials, trials.until(1.0)), marks=pytest.mark.slow),
        lambda trials: trials.split(object=["Ball 1", "Ball 25"], trial=1),
    ],
)
def test_what_was_held_out_of_a_stream_judges_the_law_as_in_memory(part, stream, drops):
    held_out, learned = part(stream)
    trials, training = part(drops)
    method = cl.DerivativeRegression(differentiation="savgol:15:3", solver="group-stlsq:1.5")
    law = cl.discover(learned, order=2, library="poly:1", method=method)
    together = cl.discover(training, order=2, library="poly:1", method=method)
    np.testing.assert_allclose(law.coefficients, together.coefficients, rtol=1e-8)
    found = find_by_stream(law, held_out, str, learned)
    expected = together.predict(trials)
    assert found.score == pytest.approx(expected.score(), abs=1e-8)
    assert found.trials == len(trials)
    some = [*found.few.law.objects]
    judged = find(select_objects(law, some), drops.select(object=some), training.select(object=some))
    assert found.few.sentences == judged.sentences
    assert found.few.is_held_out == judged.is_held_out


@pytest.fixture(scope="module")
def found(law, stream):
    return find_by_stream(law, stream, lambda _: None)


def test_few_objects_stand_for_all_and_all_are_counted(found, law, drops):
    whole = law.predict(drops, return_std=True)
    assert found.score == pytest.approx(whole.score(), abs=1e-12)
    assert (found.trials, found.diverged) == (60, 0)
    assert 0.9 < found.coverage < 1
    few = found.few.trials.objects
    assert len(few) == 24
    assert {found.relative.index[0], found.relative.index[-1]} <= {*few}
    assert found.few.law.objects == few
    assert found.few.trials.properties[few[0]] == drops.properties[few[0]]


def test_what_a_page_has_no_use_for_is_refused(law, drops, stream):
    with refused("learned-not-a-stream"):
        law.report(stream, drops)
    with refused("learned-not-in-memory"):
        law.report(drops, stream)
    with refused("cluster-client-without-files"):
        law.report(drops, client=object())


def test_the_page_tells_of_all_objects(law, found, monkeypatch):
    monkeypatch.setattr(import_module("commonlaw.report.sections"), "MANY", 20)
    first, *blocks = all_objects(Summary(found.few, found))
    assert "Forecasts of 60 trials of 30 objects" in first.text
    tables = {block.name: block.frame for block in blocks if isinstance(block, Table)}
    assert tables["worst"]["object"].tolist() == found.relative.index[:-11:-1].tolist()
    quantiles = tables["spread"].set_index("of 30 objects")
    assert quantiles.loc["median", "c (1/s)"] == pytest.approx(np.median(named_parameters(law).values[:, 1]))
    assert [block.name for block in blocks if isinstance(block, Picture)] == ["coefficients-of-all"]


def test_the_program_on_the_page_reads_the_stream(law, tmp_path, drops):
    drops.to_frame()[["object", "trial", "t", "x"]].to_parquet(tmp_path / "drops.parquet")
    program = to_script(law, Source(str(tmp_path), stream=True))
    names: dict[str, cl.TrialStream] = {}
    exec(program.partition("law = ")[0], names)
    assert names["trials"].read().objects == drops.objects


def test_letter_values_are_quantiles_and_the_strangest_is_the_farthest():
    values = np.random.default_rng(0).normal(size=(200, 2))
    values[17, 1] = 9.0
    table = quantile_frame({"a": values[:, 0], "b": values[:, 1]}, "object").set_index("of 200 objects")
    assert table.loc["lower eighth", "a"] == pytest.approx(np.quantile(values[:, 0], 0.125))
    assert table.loc["largest", "b"] == 9.0
    by_object = [{f"Ball {i}": value for i, value in enumerate(column)} for column in values.T.tolist()]
    spread, farthest = spread_tables(cl.Law.from_text("x' = a - b x", dict(zip("ab", by_object, strict=True))), 3)
    np.testing.assert_array_equal(spread["b"], table["b"])
    low, middle, high = np.quantile(values[:, 1], [0.25, 0.5, 0.75])
    assert farthest.loc[0, ["object", "farthest in"]].tolist() == ["Ball 17", "b"]
    assert farthest.loc[0, "by"] == pytest.approx((9 - middle) / ((high - low) / 1.349))


def test_a_law_of_many_objects_is_printed_with_the_first_of_them():
    law = cl.Law.from_text("x'' = -g - c v", {name: {f"Ball {i}": 0.5 for i in range(60)} for name in "gc"})
    lines = str(law).splitlines()
    assert sum(line.startswith("Ball") for line in lines) == 50
    assert "and 10 more objects" in lines
    assert repr(law) == "<Law of 60 objects: x'' = -g - c v>"
