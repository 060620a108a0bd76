"""What tests of the command line share."""

import pytest

from commonlaw.cli import main


@pytest.fixture
def run(monkeypatch, run):
    """Run the command, which says nothing of progress, however slow the machine."""
    monkeypatch.setattr(main, "INTERVAL", 1e6)
    return run
