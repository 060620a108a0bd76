"""What tests of the command line share."""

from importlib import import_module

import pytest


@pytest.fixture
def run(monkeypatch, run):
    """Run the command, which says nothing of progress, however slow the machine."""
    for name in ("INTERVAL", "SECONDS_UNTIL_SHOWN"):
        monkeypatch.setattr(import_module("commonlaw.cli.main"), name, 1e6)
    return run


@pytest.fixture
def done(run):
    """Run a command that succeeds; return what it prints."""

    def call(*words):
        code, out, err = run(*words)
        assert code == 0, err
        return out

    return call


@pytest.fixture
def fails(run, tmp_path):
    """Run a command that is refused, for its usage with code 2, and changes no file; return what it says."""

    def files():
        return {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def call(*words, code=1):
        before = files()
        ended, out, err = run(*words)
        assert (ended, out, files()) == (code, "", before), err
        assert "Traceback" not in err
        return " ".join(err.split()) if code == 2 else err

    return call
