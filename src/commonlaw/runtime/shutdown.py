"""How a process ends on a signal: at once, but for what has to be put away first."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from threading import Thread, current_thread, main_thread
from time import sleep
from types import FrameType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from multiprocessing.connection import Connection
    from multiprocessing.process import BaseProcess

SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""What people and systems tell processes to end by: Ctrl-C, `kill`, a terminal that is closed."""


class EndedError(BaseException):
    """This process was asked to end."""


class Ending:
    """Whether this process was asked to end while something has to be put away first."""

    def __init__(self) -> None:
        self.told_by = 0
        """The signal; 0 if there was none."""
        self._is_waiting = False

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Let a signal break off what is within: for what takes long, and can be broken off at any point."""
        self._is_waiting = True
        try:
            self.check()
            yield
        finally:
            self._is_waiting = False

    def check(self) -> None:
        """Break off here if this process was asked to end."""
        if self.told_by:
            raise EndedError

    def tell(self, number: int, _: FrameType | None) -> None:
        """Take a signal."""
        if not self.told_by:
            self.told_by = number
            if "multiprocessing" in sys.modules:
                from multiprocessing import active_children

                for pid in filter(None, [process.pid for process in active_children()]):
                    with suppress(OSError):  # It has ended meanwhile
                        # Processes of joblib have no method for it; on Windows any signal ends them
                        os.kill(pid, getattr(signal, "SIGKILL", signal.SIGTERM))
            if self._is_waiting:
                raise EndedError


@contextmanager
def put_away_first() -> Iterator[Ending]:
    """Let what is within put away what it has before a signal ends this process, which it else does at once.

    So no half-written file and no other process is left. A signal is heard at the end of what is within, or where it
    waits or checks. Signals that somebody handles, as Python does Ctrl-C outside of the command line, are left to them,
    and so are all in other threads than the main one.
    """
    ending = Ending()
    is_main = current_thread() is main_thread()
    heard = [number for number in SIGNALS if is_main and signal.getsignal(number) is signal.SIG_DFL]
    try:
        for number in heard:
            signal.signal(number, ending.tell)
        yield ending
    except EndedError:
        if not ending.told_by:  # an outer one was
            raise
    finally:
        for number in heard:
            signal.signal(number, signal.SIG_DFL)
        if ending.told_by:
            signal.raise_signal(ending.told_by)


def end_at_once() -> None:
    """Let Ctrl-C end this process as other signals do: at once, whatever it is in, and without a traceback.

    Where it is ignored, as in a job in the background, it stays so.
    """
    if current_thread() is main_thread() and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)


@contextmanager
def ending_at_once() -> Iterator[None]:
    """Let Ctrl-C end this process at once, see `end_at_once`, while what is within goes on, such as imports."""
    before = signal.getsignal(signal.SIGINT)
    end_at_once()
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGINT) is not before:
            signal.signal(signal.SIGINT, before)


@contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Let processes that are started here hear no Ctrl-C: a terminal sends it to all, and this one ends them."""
    if sys.platform == "win32":
        yield
        return
    from multiprocessing import resource_tracker

    resource_tracker.ensure_running()  # which would undo this
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def begun(work: Callable[..., None], *given: Any) -> "tuple[BaseProcess, Connection]":
    """Begin a process that works with a connection to this one, which is returned too, and with what is given.

    It is spawned: a forked one would have the locks of this one's threads, and none of these.
    """
    from multiprocessing import get_context

    context = get_context("spawn")
    connection, far_end = context.Pipe()
    process = context.Process(target=work, args=(far_end, *given), daemon=True)
    with deaf_to_interrupts():
        process.start()
    far_end.close()
    return process, connection


@cache
def end_with_parent() -> None:
    """Let this process end when the one that started it has ended, however that came."""
    from multiprocessing import parent_process

    known = parent_process()
    parent = os.getppid() if known is None else known.pid  # which may have ended already

    def watch() -> None:
        # Where a process keeps the number of a parent that has ended (Windows), it notices when it has to answer
        while os.getppid() == parent:
            sleep(0.1)
        os._exit(1)

    Thread(target=watch, daemon=True).start()
