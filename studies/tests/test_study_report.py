"""The report of a study: verdicts, links to files, and files that come whole or not at all."""

import json
from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from commonlaw import datasets
from commonlaw.errors import CommonlawError
from commonlaw.plots import Figure, plot_trials
from commonlaw.report import Block, Fold, Gallery, Picture, Table, Text
from studies.falling_balls.report import Report, Section, Verdict, contents, to_json, write_report
from tests.refusals import refused

FRAME = pd.DataFrame({"ball": ["Golf <Ball>", None], "drag": [-0.123456789, np.nan], "printed": ["-0.120", ""]})


def heights() -> Figure:
    return plot_trials(datasets.linear_drag(noise=0.1, seed=1))


def report_of(*blocks: Block, **results: object) -> Report:
    section = Section("fall", "Fall & rise", blocks, (Verdict("differs", "by $2 \\sigma$"),), results)
    return Report("Falls <1>", "What *fell*", (section,))


def page_of(*blocks: Block) -> str:
    return contents(report_of(*blocks))["report.html"].decode()


def test_json_holds_plain_numbers_and_null_for_those_that_are_not_finite() -> None:
    document = {"a": np.array([1.0, np.nan]), 2: (np.float64(0.1), np.int64(3), np.bool_(True)), "c": {"d": np.inf}}
    assert json.loads(to_json(document)) == {"a": [1.0, None], "2": [0.1, 3, True], "c": {"d": None}}


def test_every_part_has_its_verdicts_its_caption_and_its_files() -> None:
    page = page_of(Picture("heights", "**Heights** of $x$", heights), Table("drags", "Drags", FRAME))
    assert "<title>Falls &lt;1&gt;</title>" in page
    assert page.count('<b class="differs">differs</b> by <math') == 2
    assert '<div role="img" aria-labelledby="heights_caption">' in page
    assert '<th scope="col" class="number">drag</th>' in page
    for path in ("figures/heights.svg", "figures/heights.png", "tables/drags.csv", "results.json"):
        assert f'href="{path}"' in page


def test_files_are_the_same_to_the_byte_every_time() -> None:
    report = report_of(
        Picture("heights", "Heights", heights), Table("drags", "Drags", FRAME), drag=FRAME["drag"].to_numpy()
    )
    assert contents(report) == contents(report)


def test_a_report_comes_with_its_pictures_tables_and_numbers(tmp_path: Path) -> None:
    drawn: list[str] = []
    report = report_of(Picture("heights", "Heights", heights), Table("drags", "Drags", FRAME), drag=0.1 + 0.2)
    written = write_report(report, tmp_path / "new" / "report", drawn.append)
    assert {str(path.relative_to(tmp_path / "new" / "report")) for path in written} == {
        "report.html", "results.json", "figures/heights.svg", "figures/heights.png", "tables/drags.csv",
    }  # fmt: skip
    assert drawn == ["heights"]
    assert written[0].name == "report.html"
    assert written[0].read_bytes() == contents(report)["report.html"]
    assert json.loads((written[0].parent / "results.json").read_bytes()) == {"drag": 0.1 + 0.2}
    table = pd.read_csv(BytesIO((written[0].parent / "tables" / "drags.csv").read_bytes()))
    assert table["drag"][0] == -0.123456789


def test_a_report_whose_picture_fails_leaves_the_old_one_as_it_was(tmp_path: Path) -> None:
    def fails() -> Figure:
        raise CommonlawError("other", text="cannot be drawn")

    write_report(report_of(Table("drags", "Drags", FRAME)), tmp_path)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with refused("other", text="cannot be drawn"):
        write_report(report_of(Table("drags", "Other", FRAME.head(1)), Picture("heights", "Heights", fails)), tmp_path)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_a_folder_that_cannot_be_made_is_named_before_anything_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    report = report_of(Picture("heights", "Heights", lambda: pytest.fail("drawn")))
    (tmp_path / "file").write_bytes(b"")
    for folder in (tmp_path / "file", tmp_path / "file" / "report"):
        with refused("folder-not-made"):
            write_report(report, folder)

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "mkdir", refuse)
    with refused("folder-not-made", reason="Permission denied"):
        write_report(report, tmp_path / "report")


def test_a_kind_of_verdict_is_one_of_five() -> None:
    with refused("unknown-name"):
        Verdict("reproducd", "")


def test_a_report_keeps_the_kinds_of_blocks_that_are_wanted_and_all_results() -> None:
    report = report_of(Text("text"), Picture("heights", "Heights", heights), Table("drags", "Drags", FRAME), drag=1)
    kept = report.keep(Text, Table)
    assert [type(block) for block in kept.sections[0].blocks] == [Text, Table]
    assert kept.sections[0].verdicts == report.sections[0].verdicts
    assert kept.results == {"drag": 1}
    assert set(contents(kept)) == {"report.html", "results.json", "tables/drags.csv"}


def test_folds_and_galleries_get_their_files_in_a_folder_too() -> None:
    gallery = Gallery((Picture("one", "One", heights),))
    files = contents(report_of(Fold("rest", (gallery, Table("drags", "Drags", FRAME)))))
    assert {"figures/one.svg", "figures/one.png", "tables/drags.csv"} <= {*files}


def test_results_of_the_same_name_are_refused() -> None:
    twins = (Section("one", "One", (), (), {"drag": 1}), Section("two", "Two", (), (), {"drag": 2}))
    with refused("report-name-twice", parts="results", name="drag"):
        contents(Report("Falls", "", twins))
