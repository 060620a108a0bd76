"""What tests of several rooms share."""

import os
from pathlib import Path

import pooch
import pytest

import commonlaw as cl


@pytest.fixture(scope="session")
def ball_drops_folder() -> Path:
    """The folder of the measured drops: COMMONLAW_DATA, shared/data/ball_drops beside the checkout, or a download."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data" / "ball_drops"
    named = os.environ.get("COMMONLAW_DATA") or (beside if beside.is_dir() else None)
    try:
        cl.datasets.ball_drops(named)
    except cl.CommonlawError as error:
        pytest.fail(str(error))
    return Path(named or pooch.os_cache("commonlaw"))
