"""What a release says of itself agrees, and what forges are asked to run is there."""

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

import commonlaw

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
MAKEFILE = (ROOT / "Makefile").read_text()
FORGES = {name: yaml.safe_load((ROOT / name).read_text()) for name in (".github/workflows/tests.yml", ".gitlab-ci.yml")}
SYSTEMS = ("linux", "macos", "windows")


def steps(job):
    """Return the commands of a job on either forge."""
    github = [each["run"] for each in job.get("steps", ()) if "run" in each]
    return [*github, *job.get("before_script", ()), *job.get("script", ())]


def jobs(forge):
    return FORGES[forge].get("jobs", FORGES[forge])


def versions(job):
    """Return the Pythons that a job runs on."""
    if "strategy" in job:
        return job["strategy"]["matrix"]["python"]
    (matrix,) = job["parallel"]["matrix"]
    return matrix["VERSION"]


def recipe(target):
    """Return the commands of a target without the folder that programs are in."""
    lines = re.search(rf"^{target}:.*\n((?:\t.*\n)*)", MAKEFILE, flags=re.MULTILINE)[1]
    return lines.replace("\t", "").replace("$(BIN)/", "").splitlines()


def test_the_version_is_in_one_place_and_everything_shows_it() -> None:
    assert "version" in PROJECT["project"]["dynamic"]
    assert (ROOT / PROJECT["tool"]["hatch"]["version"]["path"]).samefile(commonlaw.__file__)
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"] == commonlaw.__version__
    shown = subprocess.run([sys.executable, "-m", "commonlaw", "--version"], capture_output=True, text=True, check=True)
    assert shown.stdout == f"commonlaw, version {commonlaw.__version__}\n"


@pytest.mark.parametrize("forge", FORGES)
def test_forges_run_what_the_project_runs(forge: str) -> None:
    asked = [line for line in (ROOT / ".ci" / "run").read_text().splitlines() if line.startswith("make ")]
    linux = [re.sub(" PYTHON=.*", "", each) for each in steps(jobs(forge)["linux"])]
    assert linux[-len(asked) :] == asked
    assert re.sub(" PYTHON=.*", "", steps(jobs(forge)["macos"])[-1]) == "make test"
    every = [each for target in ("lint", "types", "contracts", "unit") for each in recipe(target)]
    assert steps(jobs(forge)["windows"])[-len(every) :] == every


@pytest.mark.parametrize("forge", FORGES)
def test_forges_have_all_systems_and_all_pythons_and_no_target_that_is_gone(forge: str) -> None:
    pythons = [each.rpartition(" ")[2] for each in PROJECT["project"]["classifiers"] if re.search(r":: 3\.\d", each)]
    assert PROJECT["project"]["requires-python"] == f">={pythons[0]}"
    tried = {system: set(versions(jobs(forge)[system])) for system in SYSTEMS}
    assert set(pythons) <= tried["linux"]
    assert all(pythons[0] in each and max(tried["linux"], key=lambda v: int(v[2:])) in each for each in tried.values())
    targets = set(re.findall(r"^([a-z-]+):", MAKEFILE, flags=re.MULTILINE))
    words = [shlex.split(each) for name in (*SYSTEMS, "release") for each in steps(jobs(forge)[name])]
    made = [word for first, *rest in words if first == "make" for word in rest if "=" not in word]
    assert "release-check" in made
    assert set(made) <= targets


def test_packages_are_pinned_once_each_in_plain_lines() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    assert not [each for each in lines if not re.fullmatch(r"[\w.-]+==[\w.]+", each)]
    names = [re.sub(r"[-_.]+", "-", each.partition("==")[0]).lower() for each in lines]
    assert len(set(names)) == len(names)
    extras = PROJECT["project"]["optional-dependencies"].values()
    needed = [each for few in (PROJECT["project"]["dependencies"], *extras) for each in few]
    wanted = {re.sub(r"[-_.]+", "-", re.match(r"[\w.-]+", each)[0]).lower() for each in needed} - {"commonlaw"}
    assert wanted <= set(names)
