"""Work on a dask cluster: workers compute where their data are, and only results travel."""

import logging
import os
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import closing, contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar, cast

from commonlaw.errors import CommonlawError
from commonlaw.runtime.packages import optional_import
from commonlaw.runtime.parallel import threads
from commonlaw.runtime.progress import ProgressCallback, Stage
from commonlaw.text import counted

if TYPE_CHECKING:
    from distributed import Client


T = TypeVar("T")
R = TypeVar("R")

_SAME = ("commonlaw", "numpy", "scipy", "pandas", "pyarrow", "dask", "distributed")
"""Packages that must be of the same version here and on the workers, as must the first two numbers of Python's."""


_ANSWER = 10.0
"""Seconds to wait for the scheduler, which runs already where its address is known."""
_PATIENCE = 30.0
"""Seconds to wait for the first worker, which a queue may start, and for all to end."""


@dataclass(frozen=True, eq=False)
class Cluster:
    """The workers of a dask client.

    A worker that ends is made up for by the others, or by the one that its nanny starts in its place.

    Parameters
    ----------
    client
        Connected to a scheduler.
    """

    client: Any

    def __str__(self) -> str:
        """Return how many workers there are, with how much memory, and where dask shows what they do."""
        workers = self.client.scheduler_info(n_workers=-1)["workers"].values()
        limits = [worker["memory_limit"] for worker in workers if worker["memory_limit"]]
        memory = f" of {min(limits) / 1e9:.1f} GB" if limits else ""
        return f"{counted(len(workers), 'worker')}{memory}, dashboard {self.client.dashboard_link}"

    def check(self) -> None:
        """Refuse a client that is closed, a cluster without a worker, and workers of other versions."""
        if self.client.status != "running":
            raise CommonlawError("cluster-client", status=self.client.status)
        with self._lost_in_words():
            try:
                self.client.wait_for_workers(1, timeout=_PATIENCE)
            except TimeoutError:
                raise CommonlawError("cluster-without-workers", address=self._address, seconds=_PATIENCE) from None
            versions = self.client.run(_versions, on_error="return")
        here = _versions()
        for address, there in versions.items():
            if isinstance(there, Exception):
                raise CommonlawError("cluster-worker-cannot-load", address=address, reason=there)
            if there != here:
                differ = ", ".join(
                    f"{name} {there[name]} (here {version})" for name, version in here.items() if version != there[name]
                )
                raise CommonlawError("cluster-worker-versions", address=address, versions=differ)

    def each(
        self, function: Callable[[T], R], items: Sequence[T]
    ) -> Generator[tuple[int, R | None, Exception | None], None, None]:
        """Yield the index of each item as soon as it is done, with what the function gave or raised.

        What is not done yet is cancelled when the generator is closed.

        Raises `CommonlawError` if the connection is lost.
        """
        futures = self._submitted(function, items)
        indices = {future.key: index for index, future in enumerate(futures)}
        with self._cancelling(futures):
            for future in self._as_completed(futures):
                failure = self._failure(future)
                if failure is None:
                    yield indices[future.key], future.result(), None
                else:
                    yield indices[future.key], None, failure
                future.release()

    def merged(
        self,
        function: Callable[[T], R],
        items: Sequence[T],
        merge: Callable[[Sequence[R]], R],
        done: Callable[[int], None] = lambda _: None,
    ) -> R:
        """Return what a function gives for items, merged on the workers in a tree.

        Raises `CommonlawError` if the connection is lost, or a worker ends each time that it works on one of the items.

        Parameters
        ----------
        function
            What is done with each item.
        items
            At least one.
        merge
            Merges a few results that follow each other.
        done
            Takes how many items are done.
        Exception
            What the function raises.
        """
        leaves = self._submitted(function, items)
        level = leaves
        while len(level) > 1:
            level = [
                # Eight at a time: the tree is the same whatever the number of workers, and so is its rounding
                self.client.submit(_OneThread(merge), level[i : i + 8], pure=False)
                for i in range(0, len(level), 8)
            ]
        (root,) = level
        with self._cancelling([root]):
            watched = self._as_completed(leaves)
            del leaves, level  # Whatever nobody holds is freed on the workers as soon as it is merged
            for count, future in enumerate(watched, start=1):
                if (failure := self._failure(future)) is not None:
                    raise failure
                done(count)
                del future
            with self._lost_in_words():
                result: R = root.result()
                return result

    @property
    def _address(self) -> str:
        return str(self.client.scheduler.address if self.client.scheduler else "an unknown address")

    def _submitted(self, function: Callable[[T], R], items: Sequence[T]) -> list[Any]:
        with self._lost_in_words():
            futures: list[Any] = self.client.map(_OneThread(function), items, pure=False)
            return futures

    def _as_completed(self, futures: Sequence[Any]) -> Iterator[Any]:
        import distributed

        completed: Any = distributed.as_completed
        return iter(completed(futures, loop=self.client.loop))

    @contextmanager
    def _cancelling(self, futures: Sequence[Any]) -> Iterator[None]:
        """Cancel what is left of some work when it is broken off."""
        try:
            yield
        except BaseException:
            with suppress(Exception):  # There may be no connection any more
                self.client.cancel(futures, force=True)
            raise

    @contextmanager
    def _lost_in_words(self) -> Iterator[None]:
        try:
            yield
        except (OSError, CancelledError) as error:
            raise self._lost() from error

    def _lost(self) -> CommonlawError:
        return CommonlawError("cluster-lost", address=self._address)

    def _failure(self, future: Any) -> Exception | None:
        """Return what a piece of work raised, if it did; or that a worker ended."""
        from distributed.scheduler import KilledWorker

        if future.status in ("cancelled", "lost"):
            raise self._lost()
        failure: Exception | None = future.exception()
        if isinstance(failure, KilledWorker):
            return CommonlawError("cluster-workers-died")
        return failure


@dataclass(frozen=True)
class _OneThread:
    """A function as a worker calls it: with one thread, as its others have work too."""

    function: Callable[[Any], Any]

    def __call__(self, item: Any) -> Any:
        with threads(1):
            return self.function(item)


@contextmanager
def on_cluster(client: "Client | None") -> Iterator[None]:
    """Let what is within be done by the workers of a dask client, where it is done in pieces; here, if there is none.

    Raises `CommonlawError` if it is not connected, or a worker has other versions than this process.
    """
    if client is None:
        yield
        return
    if not hasattr(client, "scheduler_info"):
        raise CommonlawError("argument-type", name="client", kind=type(client).__name__, expected="a dask client")
    cluster = Cluster(client)
    cluster.check()
    token = _CLUSTER.set(cluster)
    try:
        yield
    finally:
        _CLUSTER.reset(token)


def refuse_client(client: "Client | None") -> None:
    """Refuse a dask client where there are no files for its workers to read."""
    if client is not None:
        raise CommonlawError("cluster-client-without-files")


def current_cluster() -> Cluster | None:
    """Return the cluster that work is done by, see `on_cluster`; None if it is done here."""
    return _CLUSTER.get()


@contextmanager
def connected(address: str) -> Iterator["Client"]:
    """Connect to a scheduler, ``"tcp://host:8786"`` or ``"tls://host:8786"``, or start workers here, ``"local:4"``.

    TLS, limits of time and all else is set as dask's configuration says. Workers that are started here have one thread
    each, their share of the memory, and talk by TLS with a key of this process, so that nobody else can use them.

    Raises `CommonlawError` if no scheduler answers there, more processes are asked for than this machine has use for,
    or dask is not installed.
    """
    import asyncio

    distributed, started = optional_import("distributed", "work on a cluster", "cluster"), None
    logger = logging.getLogger("distributed")
    before = logger.level
    logger.setLevel(logging.CRITICAL)  # What dask says of connections that break is said in one line
    try:
        try:
            if address.startswith("local:"):
                started = _started(distributed, address.removeprefix("local:"))
            else:
                asyncio.run(asyncio.wait_for(_greeted(distributed, address), _ANSWER))
            client = distributed.Client(
                started or address, timeout=_PATIENCE if started else _ANSWER, set_as_default=False
            )
        except CommonlawError:
            raise
        except (OSError, ValueError, RuntimeError, TypeError) as error:
            raise CommonlawError(
                "cluster-not-found", address=address, reason=str(error) or f"no scheduler answers in {_ANSWER:g} s"
            ) from None
        try:
            yield client
        finally:
            patience = _PATIENCE if client.status == "running" else 1.0
            for resource in (client, started):
                with suppress(TimeoutError):  # Of a scheduler that is not there any more
                    if resource is not None:
                        resource.close(timeout=patience)
    finally:
        logger.setLevel(before)


async def _greeted(distributed: Any, address: str) -> None:
    """Shake hands with a scheduler: a client waits for that without end."""
    settings = distributed.Security().get_connection_args("client")
    try:
        comm = await distributed.comm.connect(address, timeout=_ANSWER, **settings)
    except (MemoryError, EOFError, LookupError, AttributeError) as error:  # Of bytes that are read as a greeting
        raise OSError("what answers there is no scheduler") from error
    await comm.close()


def _started(distributed: Any, count: str) -> Any:
    """Return workers on this machine."""
    if not count.isdecimal() or not int(count):
        raise ValueError(f"{count!r} is no number of workers")
    cores, per_core = os.cpu_count() or 1, 4  # Some compute while others wait for files, and each takes memory
    if int(count) > per_core * cores:
        raise CommonlawError(
            "cluster-too-many-processes", count=count, limit=per_core * cores, cores=cores, per_core=per_core
        )
    import dask.config

    # Of an hour of work the profiler keeps call trees of 200 MB in each worker
    with dask.config.set({"distributed.worker.profile.enabled": False}):
        return distributed.LocalCluster(
            n_workers=int(count),
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            security=True,
            silence_logs=logging.CRITICAL,
        )


def done_in_parts(
    function: Callable[[T], R], items: Sequence[T], what: str, progress: ProgressCallback = lambda _: None
) -> list[R]:
    """Return what a function gives for each item, in their order: by workers, or here one by one.

    Raises
    ------
    Exception
        What the function raises; all else is cancelled.
    """
    cluster, outcomes = current_cluster(), dict[int, R]()
    if cluster is None:
        for index, item in enumerate(items):
            progress(Stage(f"{what}, {index} of {len(items)}", index / len(items)))
            outcomes[index] = function(item)
        return list(outcomes.values())
    done = counting(progress, what, len(items), cluster)
    with closing(cluster.each(function, items)) as results:
        for count, (index, result, failure) in enumerate(results, start=1):
            if failure is not None:
                raise failure
            outcomes[index] = cast(R, result)
            done(count)
    return [outcomes[i] for i in range(len(items))]


def counting(progress: ProgressCallback, what: str, total: int, cluster: Cluster) -> Callable[[int], None]:
    """Return what takes how many of all pieces are done, and tells it."""
    where = str(cluster)
    progress(Stage(f"{what} on {where}", 0.0))
    return lambda done: progress(Stage(f"{what}, {done} of {total}, on {where}", done / total))


def _versions() -> dict[str, str]:
    """Return the versions of this process."""
    modules = {name: import_module(name) for name in _SAME}
    return {"Python": "{}.{}".format(*sys.version_info)} | {
        name: str(module.__version__) for name, module in modules.items()
    }


_CLUSTER: ContextVar[Cluster | None] = ContextVar("_CLUSTER", default=None)
