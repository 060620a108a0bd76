"""Independent pieces of work in several threads.

The compiled kernel and linear algebra release the interpreter lock while they compute, so that threads suffice. Each
piece gives what it gives alone, whatever the number of threads.
"""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import partial
from numbers import Integral
from threading import Lock, Semaphore, Thread
from typing import Any, TypeVar

from commonlaw.errors import CommonlawError
from commonlaw.runtime.forking import ProcessLock
from commonlaw.runtime.time_limit import check

T = TypeVar("T")


class _GivenUpError(BaseException):
    """What this thread works for is not wanted any more."""


@contextmanager
def threads(n_jobs: int) -> Iterator[None]:
    """Let what is within be done by so many threads; where it stands within another, that decides.

    Raises `CommonlawError` if this is not a number of threads.

    Parameters
    ----------
    n_jobs
        How many threads; -1 for as many as other numerical libraries take: one for each core, or as many as the
        environment variable ``OMP_NUM_THREADS`` says.
    """
    check_n_jobs(n_jobs)
    if _TEAM.get() is not None:
        yield
        return
    token = _TEAM.set(_Team(cores() if n_jobs == -1 else int(n_jobs)))
    try:
        yield
    finally:
        _TEAM.reset(token)


def in_parallel(
    function: Callable[..., T], *columns: Iterable[Any], pays: bool = True, done: Callable[[int], None] = lambda _: None
) -> list[T]:
    """Return what a function gives for each row of some columns, in their order; `map` in threads, see `threads`.

    Parameters
    ----------
    function
        What is done with each row.
    *columns
        Its arguments, one row after the other; rows that take long had better come first.
    pays
        Whether the rows compute so much outside of Python that this is worth what threads cost.
    done
        Takes how many rows are done, in one thread at a time.

    Raises
    ------
    Exception
        What the first row raises that raises something.
    """
    team = (_TEAM.get() if pays else None) or _Team(1)
    return team.do([partial(function, *row) for row in zip(*columns, strict=True)], done)


def check_n_jobs(n_jobs: int) -> None:
    """Refuse what is no number of jobs."""
    if isinstance(n_jobs, bool) or not isinstance(n_jobs, Integral) or n_jobs < -1 or not n_jobs:
        raise CommonlawError("n-jobs", value=n_jobs)


def cores() -> int:
    """Return how many threads of numerical work this process is to have."""
    given = os.environ.get("OMP_NUM_THREADS", "")
    if given.isdecimal() and int(given):
        return int(given)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class _Team:
    """Threads that share work, also work within work: who is free helps."""

    def __init__(self, count: int) -> None:
        self._free = Semaphore(count - 1)
        self._is_given_up = False

    def do(self, pieces: Sequence[Callable[[], T]], done: Callable[[int], None]) -> list[T]:
        """Return what pieces of work give; this thread does its share of them."""
        results: dict[int, T] = {}
        failed: dict[int, Exception] = {}
        waiting, alone = deque(range(len(pieces))), Lock()

        def work() -> None:
            while waiting and not failed:
                if self._is_given_up:
                    raise _GivenUpError
                try:
                    number = waiting.popleft()
                except IndexError:  # Another thread was first
                    return
                try:
                    check()
                    given = pieces[number]()
                    with alone:
                        results[number] = given
                        done(len(results))
                except Exception as error:
                    failed[number] = error

        helpers = list[Thread]()
        while len(helpers) < len(pieces) - 1 and self._free.acquire(blocking=False):
            helpers.append(Thread(target=copy_context().run, args=(self._help, work), daemon=True))
            helpers[-1].start()
        try:
            work()
            for helper in helpers:
                helper.join()
        except BaseException:  # Ctrl-C: nobody waits for the others, who end where they begin their next piece
            self._is_given_up = True
            raise
        if failed:
            raise failed[min(failed)]
        return [results[number] for number in range(len(pieces))]

    def _help(self, work: Callable[[], None]) -> None:
        try:
            work()
        except _GivenUpError:
            pass
        finally:
            self._free.release()


_TEAM: ContextVar[_Team | None] = ContextVar("_TEAM", default=None)


class _Limit:
    """How many hold to the limit, and what the first of them has found."""

    lock = ProcessLock()
    users = 0
    first: Any = None


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Hold linear algebra to one thread, also where several threads of a program do so at once.

    The limit is one of the process: who comes while it holds takes it for what was there before, and so the last to
    leave puts back what the first has found. More threads would only get in each other's way on matrices of the size
    that laws have.
    """
    from threadpoolctl import threadpool_limits

    with _Limit.lock.held():
        limit = threadpool_limits(1, "blas")
        _Limit.first = _Limit.first if _Limit.users else limit
        _Limit.users += 1
    try:
        with limit:
            yield
    finally:
        with _Limit.lock.held():
            _Limit.users -= 1
            if not _Limit.users:
                with _Limit.first:
                    pass  # leaving puts back what was found
