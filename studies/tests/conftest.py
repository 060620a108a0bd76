"""Fixtures of the tests of the study."""

from pathlib import Path

import pytest

import commonlaw as cl


@pytest.fixture(scope="session")
def drops(ball_drops_folder: Path) -> cl.Trials:
    """The measured drops."""
    return cl.datasets.ball_drops(ball_drops_folder)
