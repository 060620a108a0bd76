"""The study of the falling balls, as `make study` runs it: every file, every printed number, the same bytes again."""

import csv
import json
from runpy import run_module

import pytest

# One worker does it all, so that the study runs no more often than it must
pytestmark = pytest.mark.xdist_group("study")


@pytest.fixture(scope="module")
def results(finished_study):
    return json.loads((finished_study[0] / "report" / "results.json").read_text())


def test_it_says_how_far_it_is_and_what_came_out(finished_study):
    folder, run = finished_study
    assert "Part 14 of 14: Findings" in run.stderr
    assert "Learned terms: reproduced" in run.stdout
    assert f"Wrote {folder / 'report' / 'report.html'}" in run.stdout
    assert (folder / "all.json").read_bytes() == (folder / "report" / "results.json").read_bytes()


def test_the_page_opens_in_a_browser_without_a_fault(finished_study, check_page):
    check_page(finished_study[0] / "report" / "report.html")


def test_every_part_has_a_verdict(finished_study):
    page = (finished_study[0] / "report" / "report.html").read_text()
    sections = page.split("<section")[1:]
    assert len(sections) == 14
    assert all('class="verdict"' in section for section in sections)
    assert 'class="left-out"' not in page


def test_no_printed_number_moves(finished_study):
    # The verdicts that are not "reproduced" are known; a number that moves changes one of these counts
    stdout = finished_study[1].stdout
    assert stdout.count(": differs") == 3
    assert stdout.count(": reproduced with correction") == 9
    assert stdout.count(": reproduced\n") == 15
    assert stdout.count(": beyond the paper") == 5


def test_there_are_eighty_prediction_errors_and_model_four_has_one_for_each_ball(results):
    errors = results["prediction_error"]
    assert {model: {drop: len(balls) for drop, balls in drops.items()} for model, drops in errors.items()} == {
        model: {"1": 10, "2": 10} for model in "1234"
    }
    assert all(value > 0 for drops in errors.values() for balls in drops.values() for value in balls.values())
    assert len(set(errors["4"]["1"].values())) == 10


def test_figures_come_as_svg_and_png_and_tables_with_all_digits(finished_study):
    folder = finished_study[0] / "report"
    vectors = sorted(path.stem for path in (folder / "figures").glob("*.svg"))
    assert vectors == sorted(path.stem for path in (folder / "figures").glob("*.png"))
    assert len(vectors) > 20
    with (folder / "tables" / "learned-models.csv").open() as lines:
        rows = list(csv.DictReader(lines))
    assert len(rows) == 20
    assert {row["agrees"] for row in rows} == {"True"}


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(finished_study, ball_drops_folder, run_study, tmp_path):
    run_study(tmp_path / "report", "--data", ball_drops_folder)
    first = finished_study[0] / "report"
    names = sorted(path.relative_to(first) for path in first.rglob("*.*"))
    assert names == sorted(path.relative_to(tmp_path / "report") for path in (tmp_path / "report").rglob("*.*"))
    different = [name for name in names if (first / name).read_bytes() != (tmp_path / "report" / name).read_bytes()]
    assert different == []


@pytest.mark.slow
def test_without_the_measured_drops_the_simulated_parts_are_done(run_study, tmp_path, check_page):
    run = run_study(tmp_path / "report", "--only", "simulated")
    assert run.stdout.count("left out") >= 6
    assert "Simulated drops with linear drag: reproduced" in run.stdout
    page = (tmp_path / "report" / "report.html").read_text()
    assert "they were left out as asked" in page
    results = json.loads((tmp_path / "report" / "results.json").read_text())
    assert "linear_drag_averages" in results
    assert "prediction_error" not in results
    check_page(tmp_path / "report" / "report.html")


def test_a_folder_without_the_drops_is_an_error(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["", "--out", str(tmp_path / "out"), "--data", str(tmp_path)])
    with pytest.raises(SystemExit) as ended:
        run_module("studies.falling_balls", run_name="__main__")
    assert ended.value.code == 1
    assert "Ball_drops_data.xls" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
