"""What `import commonlaw` costs and offers."""

import subprocess
import sys
from operator import attrgetter

import pytest

import commonlaw

HEAVY = {"click", "dask", "distributed", "matplotlib", "pandas", "pint", "pyarrow", "rich", "scipy", "sympy"}


def test_importing_commonlaw_imports_nothing_heavy() -> None:
    loaded = subprocess.run(
        [sys.executable, "-c", "import sys, commonlaw; print(*sys.modules)"], check=True, capture_output=True, text=True
    ).stdout.split()
    assert "commonlaw" in loaded
    assert HEAVY.isdisjoint(loaded), sorted(HEAVY.intersection(loaded))


def test_public_names_are_given_once() -> None:
    assert len(set(dir(commonlaw))) == len(dir(commonlaw)) > 0


@pytest.mark.parametrize("name", dir(commonlaw))
def test_every_public_name_is_there_and_documented(name: str) -> None:
    text = getattr(commonlaw, name).__doc__
    assert text, f"{name} has no docstring"
    assert not text.startswith(f"{name}("), f"{name} has only the signature that dataclasses write"


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        attrgetter("no_such_name")(commonlaw)


@pytest.mark.parametrize(("old", "new"), vars(commonlaw)["RENAMED"].items())
def test_a_name_of_the_last_release_says_where_it_is_now(old: str, new: str) -> None:
    assert old not in dir(commonlaw)
    with pytest.warns(DeprecationWarning, match=new):
        assert attrgetter(old)(commonlaw) is attrgetter(new)(commonlaw)


def test_the_package_runs_as_the_command() -> None:
    shown = subprocess.run([sys.executable, "-m", "commonlaw", "--version"], capture_output=True, text=True, check=True)
    assert shown.stdout.startswith("commonlaw")
