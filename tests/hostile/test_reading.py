"""What is no regular file is not read, and nobody waits for it."""

import json
import os
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import commonlaw as cl
from commonlaw.runtime.reading import read_file
from tests.refusals import refused

FRAME = pd.DataFrame({"t": [0.0, 1.0, 2.0], "x": [0.0, 1.0, 4.0]})


@pytest.fixture
def pipe(tmp_path: Path) -> Path:
    """A pipe that nothing writes to."""
    os.mkfifo(tmp_path / "pipe")
    return tmp_path / "pipe"


def test_pipes_and_devices_are_refused(pipe: Path) -> None:
    for path in (pipe, Path("/dev/zero")):
        with refused("file-is-device"):
            read_file(path)


def test_a_pipe_that_a_parquet_file_names_is_not_opened(pipe: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(pipe.parent)
    kept = json.dumps({"roles": {"properties": pipe.name}}).encode()
    pq.write_table(pa.Table.from_pandas(FRAME).replace_schema_metadata({b"commonlaw": kept}), "drops.parquet")
    for read in (cl.Trials.read, cl.TrialStream.from_parquet):
        with refused("json-syntax"):
            read(Path("drops.parquet"))
