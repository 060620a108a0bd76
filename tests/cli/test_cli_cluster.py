"""`commonlaw discover --cluster`: files that workers read."""

from contextlib import nullcontext

import numpy as np
import pandas as pd
import pytest

import commonlaw as cl
from commonlaw.law import from_json

pytestmark = [
    pytest.mark.xdist_group("cluster"),
    pytest.mark.filterwarnings("default::ResourceWarning", "default::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(autouse=True)
def _workers(workers, monkeypatch):
    """Commands use the workers that are there, whatever the address."""
    monkeypatch.setattr("commonlaw.cli.source.connected", lambda _: nullcontext(workers))


def test_files_of_a_pattern_give_one_law(run, tmp_path):
    drops = cl.datasets.linear_drag(drag=(-0.2, -0.6), noise=0.001, trials=6)
    for name in drops.objects:
        drops.select(object=name).to_parquet(tmp_path / f"{name}.parquet")
    words = ["Ball *.parquet", "--order", "2", "--library", "poly:1", "--cluster", "local:2"]
    code, out, err = run("-v", "discover", *words, "--save", "law.json")
    assert code == 0, err
    assert "2 files with 2 objects" in out
    assert "Fit of 6 trials of the training data: " in out
    assert "2 of 2, on 2 workers" in err
    law = from_json((tmp_path / "law.json").read_text())
    expected = cl.discover(drops, order=2, library="poly:1", method=cl.DerivativeRegression())
    np.testing.assert_allclose(law.coefficients, expected.coefficients, rtol=1e-9)


@pytest.mark.slow
def test_a_law_in_mind_is_fitted_by_workers(done, fails, tmp_path):
    drops = cl.datasets.linear_drag(drag=(-0.2, -0.6), noise=0.01, trials=3)
    for name in drops.objects:
        drops.select(object=name).to_parquet(tmp_path / f"{name}.parquet")
    words = ["Ball *.parquet", "--noise", "x=0.01", "--set", "errors=white", "--cluster", "local:2"]
    assert "Forecasts of 2 held-out trials of 2 objects" in done(
        "fit", words[0], "x'' = -g - c v", *words[1:], "--hold-out", "trial=3", "--save", "law.json"
    )
    law = cl.Law.load(tmp_path / "law.json")
    expected = cl.fit("x'' = -g - c v", drops.select(trial=["1", "2"]), noise={"x": 0.01}, errors="white")
    np.testing.assert_allclose(law.coefficients, expected.coefficients, rtol=1e-7)
    done("refine", words[0], "law.json", *words[1:], "--save", "refined.json")
    refined, expected = cl.Law.load(tmp_path / "refined.json"), cl.refine(law, drops, noise={"x": 0.01}, errors="white")
    np.testing.assert_allclose(refined.coefficients, expected.coefficients, rtol=1e-7)
    assert "--initial-value with a stream of files: leave it out" in fails(
        "fit", words[0], "x'' = -g - c v", *words[1:], "--initial-value", "x=1", code=2
    )


def test_objects_of_many_files_are_shown_by_their_spread_and_written_as_a_table(done, tmp_path):
    drops = cl.datasets.linear_drag(drag=(*np.linspace(-0.2, -0.3, 59), -0.6), trials=1, noise=0.001)
    properties = {name: {"mass": float(i + 1)} for i, name in enumerate(drops.objects)}
    drops = cl.Trials(drops.trials, drops.schema, properties)
    for i in (0, 30):
        drops.select(object=list(drops.objects[i : i + 30])).to_parquet(tmp_path / f"{i}.parquet")
    words = ["*.parquet", "--order", "2", "--library", "terms:1,v", "--method", "derivative-regression"]
    out = done("discover", *words, "--cluster", "local:2", "--save", "r.csv", "--property", "mass")
    rows = [line.split() for line in out.splitlines()]
    medians = next(row for row in rows if row[:1] == ["median"])
    outlying = rows[next(i for i, row in enumerate(rows) if "farthest" in row and "by" in row) + 2]
    assert outlying[:2] == ["Ball", "60"]
    table = pd.read_csv(tmp_path / "r.csv")
    assert len(table) == 120
    assert float(medians[2]) == pytest.approx(table[table["term"] == "v"]["value"].median(), rel=1e-3)


@pytest.mark.slow
def test_a_law_of_each_file_is_found_by_workers(run, done, tmp_path):
    cl.datasets.linear_drag(drag=(-0.2,), noise=0.01, trials=2).to_csv(tmp_path / "0.csv")
    (tmp_path / "bad.csv").write_text("t,x\n0,1\n1,two\n")
    question = ["--order", "2", "--library", "poly:1", "--state", "x", "--set", "solver=stlsq:0.1"]
    words = ["0.csv", "bad.csv", "--each", *question]
    done("discover", *words, "--save", "here.parquet", "--set", "n_jobs=1")
    code, out, _ = run("discover", *words, "--save", "there.parquet", "--cluster", "local:2")
    assert (code, out.splitlines()[-2:]) == (0, ["1 law in 2 files", "Wrote there.parquet"])
    pd.testing.assert_frame_equal(pd.read_parquet("there.parquet"), pd.read_parquet("here.parquet"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["a.parquet", "--where", "trial=1", "--schema", "clip.toml"], "clip with a stream of files"),
        (["a.csv", "--each", "--set", "n_jobs=2"], "--set n_jobs is for this machine"),
    ],
)
def test_what_does_not_go_with_a_cluster_is_refused(run, tmp_path, words, said):
    (tmp_path / "clip.toml").write_text("clip = true")
    code, _, err = run("discover", *words, "--cluster", "local:2")
    assert (code, said in " ".join(err.split())) == (2, True)
