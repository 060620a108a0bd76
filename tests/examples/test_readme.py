"""The README's tour, line by line, and what the choices in the documentation go on with."""

import re
import shlex
from pathlib import Path

import pytest

from commonlaw.cli import main

ROOT = Path(__file__).parents[2]


def blocks(language, name="README.md"):
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / name).read_text(), flags=re.DOTALL)


def test_the_commands_run_one_after_the_other(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    tour, study = blocks("sh")
    assert study.strip() == "make study"  # Which a test of its own runs
    for line in tour.splitlines():
        monkeypatch.setattr("sys.argv", shlex.split(line))
        with pytest.raises(SystemExit) as ended:
            main()
        assert ended.value.code == 0, line
    written = {"drops.csv", "law.json", "law.png", "forecast.csv", "report.html"}
    assert {path.name for path in tmp_path.iterdir()} == written


def test_the_python_runs_and_says_what_its_comments_say(monkeypatch, tmp_path, ball_drops_folder):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COMMONLAW_DATA", str(ball_drops_folder))
    names = {}
    for name in ("README.md", "docs/choices.md"):
        for block in blocks("python", name):
            exec(compile(block, name, "exec"), names)
    assert len(names["drops"]) == 20
    assert len(names["drops"].objects) == 10
    assert str(names["law"]).startswith("x'' = a + b v\n")
    assert names["search"].best_score_ > 0.97
