"""The examples of CONTRIBUTING.md: each change applies to the package, and its program runs with it."""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from commonlaw import CommonlawError

ROOT = Path(__file__).parents[2]
MAX_LINES = 60
SECTIONS = dict(
    re.findall(
        r"^## Add (?:an? )?(.+?)\n(.*?)(?=^## )", (ROOT / "CONTRIBUTING.md").read_text(), re.MULTILINE | re.DOTALL
    )
)
QUICK = ("solver", "method of integration", "message")
RUN = """
import sys
for program in sys.argv[1:]:
    exec(program, {})
"""


def blocks(kind: str, section: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```\n", SECTIONS[section], re.MULTILINE | re.DOTALL)


def test_there_is_an_example_for_each_extension() -> None:
    changed, with_program = ([name for name in SECTIONS if blocks(kind, name)] for kind in ("diff", "python"))
    assert with_program == [*changed[:4], "kind of parameter", *changed[4:]]
    assert changed == [
        "solver",
        "library of terms",
        "error model",
        "proposer",
        "method of integration",
        "option",
        "message",
    ]


@pytest.mark.parametrize(
    "sections", [QUICK, pytest.param([*SECTIONS], marks=pytest.mark.slow)], ids=["quick programs", "all programs"]
)
def test_the_changes_apply_and_their_programs_run_only_with_them(tmp_path: Path, sections: Sequence[str]) -> None:
    changes = [change for name in SECTIONS for change in blocks("diff", name)]
    programs = [(name, program) for name in sections for program in blocks("python", name)]
    assert max(change.count("\n") for change in changes) < MAX_LINES
    shutil.copytree(ROOT / "src" / "commonlaw", tmp_path / "src" / "commonlaw")

    for name, program in programs:
        if blocks("diff", name):
            with pytest.raises((CommonlawError, AssertionError, TypeError)):
                exec(program, {})
    for change in changes:
        subprocess.run(["git", "apply", "-C1", "-"], input=change, text=True, cwd=tmp_path, check=True)
    there = {"PYTHONPATH": str(tmp_path / "src"), "COMMONLAW_CACHE": "off"}
    command = [sys.executable, "-W", "error", "-c", RUN, *(program for _, program in programs)]
    subprocess.run(command, env=os.environ | there, cwd=tmp_path, check=True)
