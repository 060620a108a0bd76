import pickle
from itertools import pairwise
from operator import attrgetter

import numpy as np
import pytest

import commonlaw as cl
from commonlaw.formulation import MAX_GROUPS, law_variables, merged_rows, rows_by_object
from commonlaw.inference import bounds
from commonlaw.trials import stream
from tests.refusals import message, refused


@pytest.mark.parametrize("rows", [7, 49, 173, 100_000])
def test_streamed_trials_are_those_of_the_file_wherever_batches_end(tmp_path, monkeypatch, rows):
    trials = cl.datasets.linear_drag(drag=(-0.1, -0.3), trials=3)
    trials.to_parquet(tmp_path / "drops.parquet")
    monkeypatch.setattr(stream, "_ROWS", rows)
    streamed = cl.TrialStream.from_parquet(tmp_path / "drops.parquet")
    assert streamed.schema.states == ("x",)
    assert streamed.schema.units["x"] == "m"
    for _ in range(2):
        for one, trial in zip(streamed, trials, strict=True):
            assert one.label == trial.label
            np.testing.assert_array_equal(one.times, trial.times)
            np.testing.assert_array_equal(one.states, trial.states)


DROPS = cl.datasets.linear_drag(noise=0.01)


@pytest.fixture(scope="module")
def law():
    return cl.fit("x'' = -g - c v", DROPS, errors="white")


@pytest.mark.parametrize(
    "use",
    [
        lambda law, trials: law.predict(trials),
        lambda law, trials: law.assess(trials),
        lambda law, trials: law.residuals(trials),
        lambda law, trials: law.discrepancy(trials),
        lambda law, trials: law.update(trials),
        lambda law, trials: bounds(law, trials, ["v^2"]),
        lambda law, trials: law.predict(trials).score(),
        lambda _, trials: cl.plots.plot_trials(trials),
        lambda _, trials: trials.check(),
        lambda _, trials: trials.clip_irregular(),
    ],
)
def test_what_needs_trials_in_memory_refuses_a_stream_in_words(use, law):
    with refused("not-in-memory"):
        use(law, cl.TrialStream(law.schema, lambda: DROPS))


@pytest.mark.parametrize(
    ("code", "use"),
    [
        ("derivatives-of-stream", lambda stream: cl.discover(stream, order=2, x_dot={"x": "v"})),
        ("known-of-stream", lambda stream: cl.discover(stream, order=2, known=lambda x: x)),
        ("not-for-streams", lambda stream: cl.discover(stream, order=1, observe={"y": "2*x"})),
        (
            "not-refined-file-by-file",
            lambda stream: cl.refine(cl.Law.from_text("x'' = -x/(1 + x/K)", {"K": 1}), stream),
        ),
        ("no-trial-fits", lambda stream: stream.select(object="Ball 1", trial=2)),
    ],
)
def test_what_a_stream_cannot_be_used_for_is_refused(code, use):
    trials = DROPS.with_trials([trial for trial in DROPS if (trial.object, trial.name) != ("Ball 1", "2")])
    with refused(code):
        use(cl.TrialStream(trials.schema, lambda: trials))


def test_a_stream_has_what_it_has():
    stream = cl.TrialStream(cl.Schema(("x",)), lambda: ())
    assert not hasattr(stream, "objects")
    with pytest.raises(AttributeError, match="no attribute 'object_names'"):
        attrgetter("object_names")(stream)


def test_a_stream_needs_roles_and_rows_of_trials_in_parquet_files(tmp_path, monkeypatch):
    frame = cl.datasets.linear_drag(drag=-0.1, trials=2).to_frame()
    frame.sort_values(["t", "trial"]).to_parquet(tmp_path / "drops.parquet")
    monkeypatch.setattr(stream, "_ROWS", 10)
    roles = {"object": "object", "trial": "trial", "time": "t", "states": ["x"]}
    with refused("stream-unsorted", trial="Ball 1, trial 1"):
        list(cl.TrialStream.from_parquet(tmp_path / "drops.parquet", **roles))
    cl.datasets.linear_drag(drag=-0.1).to_frame().to_parquet(tmp_path / "drops.parquet")
    with refused("stream-roles-missing"):
        cl.TrialStream.from_parquet(tmp_path / "drops.parquet")
    (tmp_path / "drops.csv").write_text("t,x\n0,1\n")
    with refused("not-parquet"):
        cl.TrialStream.from_parquet(tmp_path / "drops.csv")
    with refused("file-missing", file="gone.parquet"):
        cl.TrialStream.from_parquet(tmp_path / "gone.parquet")


@pytest.fixture
def drops(tmp_path):
    """Drops in a file, and the same in files of folders that name the objects."""
    frame = cl.datasets.linear_drag(drag=(-0.1, -0.3), trials=4).to_frame()
    frame.to_parquet(tmp_path / "all.parquet")
    for (name, trial), own in frame.groupby(["object", "trial"]):
        folder = tmp_path / "runs" / f"object={str(name).replace(' ', '%20')}"
        folder.mkdir(parents=True, exist_ok=True)
        own.drop(columns="object").to_parquet(folder / f"{trial}.parquet")
    return tmp_path


@pytest.mark.parametrize("name", ["runs", "runs/*/*.parquet", "runs/**/*.parquet"])
def test_files_in_folders_are_one_stream_and_each_can_be_sent(drops, monkeypatch, name):
    monkeypatch.chdir(drops)
    roles = {"object": "object", "trial": "trial", "time": "t", "states": ["x"]}
    whole = list(cl.TrialStream.from_parquet("all.parquet", **roles))
    stream = cl.TrialStream.from_parquet(name, **roles)
    assert repr(stream) == "<TrialStream: 8 parts, x>"
    sent = [trial for part in pickle.loads(pickle.dumps(stream.parts)) for trial in part]
    for one, other, there in zip(whole, stream, sent, strict=True):
        assert one.label == other.label == there.label
        np.testing.assert_array_equal(one.states, other.states)
        np.testing.assert_array_equal(one.states, there.states)


def test_a_pattern_that_names_no_file_is_refused(drops):
    with refused("no-parquet-file"):
        cl.TrialStream.from_parquet(drops / "*.csv")


@pytest.mark.parametrize("cuts", [[1], [40], [3, 35, 36, 70]])
def test_rows_of_an_object_are_the_same_however_its_trials_are_divided(cuts):
    trials = cl.datasets.linear_drag(drag=(-0.2,), trials=80)
    form, terms = (
        cl.formulation.StrongForm(cl.differentiation.FiniteDifference(), 2),
        cl.library.PolynomialLibrary(1).bind(law_variables(trials.schema, 2)),
    )
    whole = rows_by_object(trials, form, terms, segments=2, sampled=True)["Ball 1"]
    edges = [0, *cuts, len(trials)]
    parts = [rows_by_object(trials[a:b], form, terms, segments=2, sampled=True) for a, b in pairwise(edges)]
    divided = merged_rows(parts)["Ball 1"]
    assert (divided.count, len(divided.groups)) == (whole.count, MAX_GROUPS) == (80, 32)
    np.testing.assert_array_equal(divided.extremes, whole.extremes)
    assert [trial.name for trial in divided.samples] == ["1", "2", "3", "4"]
    for group, other in zip(divided.groups, whole.groups, strict=True):
        for mine, theirs in zip(group, other, strict=True):
            assert mine.rows == theirs.rows
            np.testing.assert_allclose(mine.factor.T @ mine.factor, theirs.factor.T @ theirs.factor, rtol=1e-12)


@pytest.fixture
def balls(tmp_path):
    """Two balls in a file each, with masses, and both."""
    made = cl.datasets.linear_drag(drag=(-0.2, -0.6), trials=3)
    whole = cl.Trials(made.trials, made.schema, {"Ball 1": {"mass": 1.0}, "Ball 2": {"mass": 2.0}})
    for name in whole.objects:
        whole.select(object=name).to_parquet(tmp_path / f"{name}.parquet")
    return cl.TrialStream.from_parquet(tmp_path), whole


def same(stream, trials):
    read = stream.read()
    assert [each.label for each in stream] == [each.label for each in read] == [trial.label for trial in trials]
    assert all(np.array_equal(own.states, trial.states) for own, trial in zip(read, trials, strict=True))
    assert read.properties == trials.properties
    assert len(stream.parts) == len(trials.objects)


@pytest.mark.parametrize("conditions", [{"trial": 2}, {"object": "Ball 2"}, {"object": "Ball 1", "trial": [1, "3"]}])
def test_a_stream_is_divided_as_trials_in_memory_are(conditions, balls):
    stream, whole = balls
    same(stream, whole)
    for own, expected in zip(stream.split(**conditions), whole.split(**conditions), strict=True):
        same(own, expected)
    same(stream.select(**conditions).until(0.5), whole.select(**conditions).until(0.5))
    chosen, rest = stream.split(**conditions)
    assert len([*chosen.joined(rest)]) == len(whole)
    assert [each.label for each in pickle.loads(pickle.dumps(rest.parts[0]))] == [each.label for each in rest.parts[0]]


def test_more_than_memory_is_to_hold_is_refused(balls, monkeypatch):
    monkeypatch.setattr("commonlaw.runtime.progress.MOST_MEMORY", 3000)
    with refused("too-much-memory", task="2 files"):
        balls[0].read()


def test_a_division_of_a_stream_that_says_nothing_is_refused(balls):
    stream, whole = balls
    for use, said in [
        (lambda: stream.split(trial=7), message("stream-without-role", role="trial", name="7")),
        (lambda: stream.split(trial=[1, 2, 3]), "split-one-sided"),
        (lambda: stream.until(-1.0), message("trials-begin-later", time_name="t", time=-1.0)),
        (lambda: stream.select(object="Ball 1").select(object="Ball 2"), message("stream-without-role", role="object")),
        (
            lambda: cl.TrialStream(whole.schema, lambda: whole).split(trial="x"),
            message("stream-without-role", role="trial", name="x"),
        ),
    ]:
        with refused(said):
            use()
