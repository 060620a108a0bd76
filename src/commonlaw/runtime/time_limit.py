"""A time limit: a search is stopped where a step begins, and goes on with the best that it has.

The first result is awaited, however long it takes; then `check` ends the work once the time is over, or an event is
set, see `stoppable`. Standard errors and the like are computed `unlimited`.
"""

import signal
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from threading import Event, current_thread, main_thread
from time import monotonic

DEFAULT_TIME_LIMIT = 60.0
"""Seconds of a search by the command or in the app."""


class OutOfTimeError(Exception):
    """The time is over, or the event of a stop is set: go on with what there is."""


class TimeLimit:
    """The time for some work, which begins now; it ends early if the event `stop` is set.

    Parameters
    ----------
    seconds
        How long it may take; None for as long as it takes.
    stop
        Is set if it is to end as soon as there is a result.
    clock
        Returns the present time in seconds.
    replays
        Whether the work begins with steps that were done before, see `end_replay`.
    """

    def __init__(
        self,
        seconds: float | None,
        stop: Event | None = None,
        clock: Callable[[], float] = monotonic,
        replays: bool = False,
    ):
        self._stop, self._clock, self._began, self._replays = stop, clock, clock(), replays
        self._seconds = float("inf") if seconds is None else float(seconds)
        self._kept, self._share = 0.0, 1.0
        self.has_result = False

    @property
    def elapsed(self) -> float:
        """The seconds since it began."""
        return self._clock() - self._began

    def await_result(self) -> None:
        """Let no time be over before there is a result."""
        self.has_result = False

    def take_result(self) -> None:
        """Take the first result: from now on the time counts.

        What is left to do for a result, such as its standard errors, takes about as long as the first one did; at most
        half of the limit is kept for it.
        """
        if not self.has_result:
            self.has_result = True
            self._kept = min(self.elapsed, self._seconds / 2)

    def end_replay(self) -> None:
        """Let the time begin, as the first new step is done: work that goes on does one, however short the time."""
        if self._replays:
            self._replays, self._began = False, self._clock()

    @property
    def is_over(self) -> bool:
        """Whether there is a result, and no more time."""
        if not self.has_result:
            return False
        is_asked = self._stop is not None and self._stop.is_set()
        is_late = not self._replays and self.elapsed > self._share * (self._seconds - self._kept)
        return is_asked or is_late

    @contextmanager
    def until(self, share: float) -> Iterator[None]:
        """Let what is within end at a share of the time for all."""
        before, self._share = self._share, share
        try:
            yield
        finally:
            self._share = before


_LIMIT = ContextVar[TimeLimit | None]("_LIMIT", default=None)
_STOP = ContextVar[Event | None]("_STOP", default=None)


def check() -> None:
    """Raise `OutOfTimeError` if the time for what goes on is over."""
    limit = _LIMIT.get()
    if limit is not None and limit.is_over:
        raise OutOfTimeError


def limit_of(seconds: float | None, replays: bool = False) -> TimeLimit | None:
    """Return a limit that begins now; None without seconds and outside of `stoppable`."""
    stop = _STOP.get()
    return None if seconds is None and stop is None else TimeLimit(seconds, stop, replays=replays)


@contextmanager
def limited(limit: TimeLimit | None) -> Iterator[None]:
    """Limit the time of what is within."""
    token = _LIMIT.set(limit)
    try:
        yield
    finally:
        _LIMIT.reset(token)


def current_limit() -> TimeLimit | None:
    """Return the limit of what goes on; None if there is none."""
    return _LIMIT.get()


def unlimited() -> AbstractContextManager[None]:
    """Let what is within end, however long it takes."""
    return limited(None)


@contextmanager
def stoppable(stop: Event) -> Iterator[None]:
    """Let searches within end with the best that they have when an event is set."""
    token = _STOP.set(stop)
    try:
        yield
    finally:
        _STOP.reset(token)


@contextmanager
def stopped_by_interrupts(say: Callable[[], None]) -> Iterator[None]:
    """Let the first Ctrl-C stop the searches within, see `stoppable`; `say` is called then. The second one ends all.

    Where Ctrl-C is ignored, as in a job in the background, or outside of the main thread, it stays as it is.
    """
    stop, before = Event(), signal.getsignal(signal.SIGINT)
    if current_thread() is not main_thread() or before not in (signal.SIG_DFL, signal.default_int_handler):
        yield
        return

    def tell(*_: object) -> None:
        signal.signal(signal.SIGINT, before)
        stop.set()
        say()

    signal.signal(signal.SIGINT, tell)
    try:
        with stoppable(stop):
            yield
    finally:
        signal.signal(signal.SIGINT, before)
