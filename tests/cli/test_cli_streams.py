"""Folders and patterns of Parquet files in commands, gone through here file by file."""

import json
from shutil import copytree

import pandas as pd
import pytest

import commonlaw as cl


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("streams")
    drops = cl.datasets.linear_drag(drag=(-0.2, -0.6), noise=0.001, trials=3)
    for name in drops.objects:
        drops.select(object=name).to_parquet(folder / f"{name}.parquet")
    cl.fit("x'' = -g - c v", drops).save(folder / "law.parquet")
    return folder


@pytest.fixture(autouse=True)
def _files(folder, tmp_path):
    copytree(folder, tmp_path, dirs_exist_ok=True)


def test_a_pattern_is_a_stream(done, tmp_path):
    words = ["Ball *.parquet", "--order", "2", "--library", "poly:1", "--save", "found.json", "--save", "values.csv"]
    assert "2 files with 2 objects" in done("discover", *words)
    assert pd.read_csv(tmp_path / "values.csv")["object"].nunique() == 2


def test_forecasts_of_a_pattern_are_written_file_by_file(done, tmp_path):
    assert "of 6 trials" in done(
        "predict", "Ball *.parquet", "law.parquet", "--folder", "f", "--save", "errors.parquet"
    )
    assert len(pd.read_parquet(tmp_path / "errors.parquet")) == 6
    assert sorted(each.name for each in (tmp_path / "f").iterdir()) == [f"forecast-00000{i}.parquet" for i in (1, 2)]


@pytest.mark.slow
def test_forecasts_that_all_run_away_are_listed(done):
    cl.Law.from_text("x' = k x^3", {"k": {"Ball 1": 50.0, "Ball 2": 50.0}}).save("wrong.json")
    out = done("predict", "Ball *.parquet", "wrong.json")
    assert "The worst" in out
    assert "by trial" not in out


def test_a_law_of_many_objects_without_coefficients_is_shown(done, tmp_path):
    cl.datasets.linear_drag(drag=(0.0,) * 51, noise=0.01, trials=1, samples=8).to_csv(tmp_path / "drops.csv")
    assert "51 objects" in done("fit", "drops.csv", "x'' = -9.81")


def test_residuals_of_a_pattern_are_checked_file_by_file(done, fails, tmp_path):
    out = done("check", "Ball *.parquet", "law.parquet", "--save", "objects.csv")
    assert "trend with v" in out
    assert "of 2 objects" in out
    found = pd.read_csv(tmp_path / "objects.csv")
    assert found["object"].tolist() == ["Ball 1", "Ball 2"]
    out = done("check", "Ball *.parquet", "law.parquet", "--where", "object=Ball 2", "--json")
    (own,) = json.loads(out)["objects"]
    assert own["RMS over noise"] == pytest.approx(found["RMS over noise"][1])
    assert "--save residuals.png with a stream of files" in fails(
        "check", "Ball *.parquet", "law.parquet", "--save", "residuals.png", code=2
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["data", "check", "Ball *.parquet"], "6 trials of 2 objects"),
        (["data", "check", "Ball*", "--where", "object=Ball 2"], "3 trials of 1 object"),
        (
            ["discrepancy", "Ball *.parquet", "law.parquet", "--where", "object=Ball 2", "--of", "v"],
            "No strong evidence for a discrepancy",
        ),
        (["refine", "Ball *.parquet", "law.parquet", "--where", "trial=1"], "Ball 2 9.7995 ± 0.0030"),
        (["fit", "Ball *.parquet", "x'' = -g - c v", "--hold-out", "trial=1"], "Forecasts of 2 held-out trials"),
    ],
)
def test_what_needs_all_trials_at_once_reads_the_files_of_a_pattern(done, words, said):
    out = done(*words)
    assert said in " ".join(out.split())


@pytest.mark.parametrize(
    ("words", "trials"),
    [
        (["--hold-out", "trial=3"], "2 held-out trials of 2 objects"),
        pytest.param(
            ["--exclude", "trial=2", "--hold-out", "object=Ball 2"],
            "2 held-out trials of 1 object",
            marks=pytest.mark.slow,
        ),
        pytest.param(["--learn-until", "1"], "6 trials of 2 objects", marks=pytest.mark.slow),
    ],
)
def test_what_is_held_out_of_a_pattern_is_forecast(run, words, trials):
    asked = ["Ball *.parquet", "--order", "2", "--library", "poly:1", "--method", "trajectory-likelihood", *words]
    code, out, err = run("discover", *asked, "--save", "found.json")
    assert code == 0, err
    if "Ball 2" in words[-1]:  # Nothing says what coefficients it has
        assert "the law was not checked: unknown object of this law 'Ball 2'" in " ".join(err.split())
        return
    assert f"Forecasts of {trials}: R^2 " in out
    assert "This law can be used for forecasts" in out


@pytest.mark.usefixtures("undrawn")
def test_the_report_of_a_pattern_is_a_page(done, tmp_path):
    cl.Law.from_text("x'' = -g - c v", {"g": 9.8, "c": {"Ball 1": 0.2, "Ball 2": 0.6}}).save(tmp_path / "law.json")
    done("report", "Ball *.parquet", "law.json", "--hold-out", "trial=3")
    page = (tmp_path / "report.html").read_text()
    assert "Forecasts of 2 held-out trials of 2 objects" in page
    assert "In Python, which uses all trials of the table:" in page


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["Ball *.parquet", "law.parquet", "--save", "f.png", "--step", "1"], "--save f.png, --step with a stream"),
        (["Ball *.parquet", "law.parquet", "--schema", "clip.toml"], "clip with a stream of files"),
        (["Ball *.parquet", "law.parquet", "--where", "mass=1"], "say which trials by object or trial"),
        (["Ball 1.parquet", "law.parquet", "--folder", "f"], "--folder is for a folder or a pattern"),
    ],
)
def test_what_does_not_go_with_a_stream_is_refused(run, tmp_path, words, said):
    (tmp_path / "clip.toml").write_text("clip = true")
    code, _, err = run("predict", *words)
    assert (code, said in " ".join(err.split())) == (2, True)
