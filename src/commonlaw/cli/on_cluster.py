"""The option that has the workers of a cluster do the work, and what is brought here to check a law."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import TypeVar

from commonlaw.cli.options import option
from commonlaw.cli.source import Source
from commonlaw.runtime.cluster import connected, current_cluster, on_cluster
from commonlaw.runtime.progress import ProgressCallback
from commonlaw.trials import Schema, Trial, Trials, TrialStream

T = TypeVar("T")
R = TypeVar("R")

_TRIALS, _SAMPLES = 10, 2000
"""Trials that a law is checked by, and samples of each, from its start."""

with_cluster = option(
    "Cluster",
    "--cluster",
    metavar="ADDRESS",
    help="Have the workers of a dask cluster do the work: tcp://host:8786 or tls://host:8786, the address that its "
    "scheduler shows, or local:4 for four processes of this machine. They read the files themselves, so name them as "
    "the workers see them. Without it a folder or a pattern of Parquet files is gone through here, file by file.",
)
"""Adds the option to a command, which receives it as `cluster`."""


@contextmanager
def on_cluster_at(address: str | None, show: ProgressCallback) -> Iterator[None]:
    """Let what is within be done by the cluster at an address, if there is one."""
    if address is None:
        yield
        return
    show(f"connecting to {address}")
    with connected(address) as client, on_cluster(client):
        yield


def stream_of(source: Source, schema: Schema | None = None) -> TrialStream:
    """Return the trials of files as a stream; a worker lists them if there is one, as they need not be here.

    Names that no option gives are taken from `schema`.
    """
    source = source.named_like(schema)
    return _by_a_worker(Source.stream, replace(source, path=str(Path(str(source.path)).absolute())))


def few_trials(stream: TrialStream) -> Trials:
    """Return the first trials of the first file of a stream, read by a worker if there is one."""
    return Trials(_by_a_worker(_first, stream.parts[0]), stream.schema)


def _by_a_worker(function: Callable[[T], R], item: T) -> R:
    cluster = current_cluster()
    return function(item) if cluster is None else cluster.merged(function, [item], lambda found: found[0])


def _first(stream: TrialStream) -> tuple[Trial, ...]:
    return tuple(trial.cut(_SAMPLES) for trial in islice(stream, _TRIALS))
