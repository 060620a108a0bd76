"""The examples of CONTRIBUTING.md: each change applies to the package, and its program runs with it."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
MAX_LINES = 40
EXAMPLES = dict(
    re.findall(
        r"^## Add (?:an? )?(.+?)\n.*?^(```diff\n.*?^```\n\n```python\n.*?)^```",
        (ROOT / "CONTRIBUTING.md").read_text(),
        re.MULTILINE | re.DOTALL,
    )
)


def test_there_is_an_example_for_each_extension() -> None:
    assert [*EXAMPLES] == ["solver", "library of terms", "error model", "proposer", "option", "message"]


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_change_applies_and_its_program_runs_only_with_it(name: str, tmp_path: Path) -> None:
    change, program = re.findall(r"```\w+\n(.*?)(?:^```\n|\Z)", EXAMPLES[name], re.MULTILINE | re.DOTALL)
    assert change.count("\n") < MAX_LINES
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "src" / "commonlaw", tmp_path / "src" / "commonlaw", ignore=ignored)

    def runs() -> bool:
        there = {"PYTHONPATH": str(tmp_path / "src"), "COMMONLAW_CACHE": "off", "PYTHONDONTWRITEBYTECODE": "1"}
        command = [sys.executable, "-W", "error", "-c", program]
        return subprocess.run(command, env=os.environ | there, cwd=tmp_path, stderr=subprocess.DEVNULL).returncode == 0

    assert not runs()
    subprocess.run(["git", "apply", "-C1", "-"], input=change, text=True, cwd=tmp_path, check=True)
    assert runs()
