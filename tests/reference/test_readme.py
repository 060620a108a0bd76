"""The README's tour, line by line, and what the choices in the documentation go on with."""

import re
import shlex
from pathlib import Path

import pytest

from commonlaw import Trials
from commonlaw.cli import main
from commonlaw.law import select_objects

ROOT = Path(__file__).parents[2]


def blocks(language, name="README.md"):
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / name).read_text(), flags=re.DOTALL)


def numbers(text):
    return [float(each) for each in re.findall(r"[-+]?\d+\.\d+", text)]


@pytest.mark.usefixtures("undrawn")  # The page of the report has its figures in tests of a browser
def test_the_tour_runs_without_a_network_and_prints_what_stands_below_it(monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("pooch.retrieve", lambda *_, **__: pytest.fail("a download"))
    tour, study = blocks("sh")
    assert study.strip() == "make study"  # Which a test of its own runs
    two = ["Ball 1", "Ball 2"]  # Which do for commands and for a report
    for line in tour.splitlines():
        monkeypatch.setattr("sys.argv", shlex.split(line))
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 0, line
        if "data export" in line:
            Trials.read("drops.csv").select(object=two).to_csv("drops.csv")
    written = {"drops.csv", "law.json", "law.png", "forecast.csv", "report.html"}
    assert {path.name for path in tmp_path.iterdir()} == written
    capsys.readouterr()
    names = {}
    (first, *others), shown = blocks("python"), blocks("text")[0]
    exec(compile(first, "README.md", "exec"), names)
    drops = names["drops"]
    names |= {"law": select_objects(names["law"], two), "drops": drops.select(object=two)}
    for block in others:
        exec(compile(block, "README.md", "exec"), names)
    names["drops"] = drops
    for block in blocks("python", "docs/choices.md"):
        exec(compile(block, "docs/choices.md", "exec"), names)
    printed = capsys.readouterr().out[: len(shown)]
    assert re.sub(r"\d", "0", printed) == re.sub(r"\d", "0", shown)
    assert numbers(printed) == pytest.approx(numbers(shown), rel=0.02)
    assert first in blocks("python", "docs/index.md")
    assert shown.startswith(blocks("text", "docs/index.md")[0])
    assert names["search"].best_score_ > 0.97
