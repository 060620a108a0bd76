"""What tests of the command line share."""

from importlib import import_module

import pytest


@pytest.fixture
def run(monkeypatch, run):
    """Run the command, which says nothing of progress, however slow the machine."""
    monkeypatch.setattr(import_module("commonlaw.cli.main"), "INTERVAL", 1e6)
    return run
