"""The examples of CONTRIBUTING.md: each change applies to the package, and its program runs with it."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from commonlaw import CommonlawError

ROOT = Path(__file__).parents[2]
MAX_LINES = 40
EXAMPLES = dict(
    re.findall(
        r"^## Add (?:an? )?(.+?)\n.*?^(```diff\n.*?^```\n\n```python\n.*?)^```",
        (ROOT / "CONTRIBUTING.md").read_text(),
        re.MULTILINE | re.DOTALL,
    )
)
RUN = """
import sys
for program in sys.argv[1:]:
    exec(program, {})
"""


def test_there_is_an_example_for_each_extension() -> None:
    assert [*EXAMPLES] == ["solver", "library of terms", "error model", "proposer", "option", "message"]


def test_the_changes_apply_and_their_programs_run_only_with_them(tmp_path: Path) -> None:
    pairs = [re.findall(r"```\w+\n(.*?)(?:^```\n|\Z)", each, re.MULTILINE | re.DOTALL) for each in EXAMPLES.values()]
    changes, programs = zip(*pairs, strict=True)
    assert max(change.count("\n") for change in changes) < MAX_LINES
    shutil.copytree(ROOT / "src" / "commonlaw", tmp_path / "src" / "commonlaw")

    for program in programs:
        with pytest.raises((CommonlawError, AssertionError, TypeError)):
            exec(program, {})
    for change in changes:
        subprocess.run(["git", "apply", "-C1", "-"], input=change, text=True, cwd=tmp_path, check=True)
    there = {"PYTHONPATH": str(tmp_path / "src"), "COMMONLAW_CACHE": "off"}
    command = [sys.executable, "-W", "error", "-c", RUN, *programs]
    subprocess.run(command, env=os.environ | there, cwd=tmp_path, check=True)
