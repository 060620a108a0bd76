"""What tests of several rooms share."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def ball_drops_folder() -> Path:
    """The folder of the measured ball drops: COMMONLAW_DATA, or shared/data/ball_drops beside the repository."""
    beside = Path(__file__).resolve().parents[2] / "shared" / "data" / "ball_drops"
    folder = Path(os.environ.get("COMMONLAW_DATA") or beside)
    if not (folder / "Ball_drops_data.xls").is_file():
        pytest.fail(f"there is no Ball_drops_data.xls in {folder}: name its folder in COMMONLAW_DATA")
    return folder
