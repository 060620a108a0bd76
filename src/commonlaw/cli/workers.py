"""Many pieces of work at the same time, in processes of their own: what one of them does harms no other."""

import warnings
from collections.abc import Callable, Generator, Sequence
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

from commonlaw.diagnostics import marked
from commonlaw.errors import CommonlawError
from commonlaw.runtime.parallel import threads
from commonlaw.runtime.shutdown import deaf_to_interrupts, end_with_parent

T = TypeVar("T")
R = TypeVar("R")

_CONTEXT = get_context("spawn")
"""A forked process would have the locks of this one's threads, and none of these."""


class _Worker:
    """A process that does one piece of work after the other: what the first of them loads, the others have."""

    def __init__(self, work: Callable[[Any], object]) -> None:
        self.connection, other = _CONTEXT.Pipe()
        self._process = _CONTEXT.Process(target=_serve, args=(other, work), daemon=True)
        with deaf_to_interrupts():
            self._process.start()
        other.close()
        self.number = -1

    def take(self, number: int, piece: object) -> None:
        """Begin a piece of work; it is told by `answer` if that cannot be."""
        self.number = number
        try:
            self.connection.send(piece)
        except OSError:  # Its process has ended
            return

    def answer(self) -> tuple[Any, str]:
        """Return what the piece gave, or why there is nothing."""
        try:
            found: tuple[Any, str] = self.connection.recv()
        except (EOFError, OSError):
            self.end()
            return None, f"its process ended by itself, with code {self._process.exitcode}: is there enough memory?"
        return found

    @property
    def is_alive(self) -> bool:
        """Whether it takes more work."""
        return not self.connection.closed

    def end(self) -> None:
        """End it, whatever it does."""
        self._process.kill()
        self._process.join()
        self.connection.close()


def in_processes(
    work: Callable[[T], R], pieces: Sequence[T], at_once: int
) -> Generator[tuple[int, R | None, str], None, None]:
    """Yield the number of each piece of work as soon as it is done, with what it gave or why there is nothing.

    All processes end with this one, and when the generator is closed.

    Parameters
    ----------
    work
        What is done; it and the pieces must be possible to pickle.
    pieces
        What it is done with.
    at_once
        How many of them at the same time.
    """
    waiting = list(enumerate(pieces))[::-1]
    idle: list[_Worker] = []
    busy: dict[object, _Worker] = {}
    try:
        while waiting or busy:
            while waiting and len(busy) < at_once:
                worker = idle.pop() if idle else _Worker(work)
                busy[worker.connection] = worker
                worker.take(*waiting.pop())
            for connection in wait([each.connection for each in busy.values()]):
                worker = busy.pop(connection)
                result, failure = worker.answer()
                idle += [worker] if worker.is_alive else []
                yield worker.number, result, failure
    finally:
        for worker in (*idle, *busy.values()):
            worker.end()


def _serve(connection: Connection, work: Callable[[Any], object]) -> None:
    """Do pieces of work as they come; the main function of a process."""
    end_with_parent()
    warnings.simplefilter("ignore")
    with threads(1):  # The other processes have the other cores
        while True:
            try:
                connection.send(_done(work, connection.recv()))
            except (EOFError, OSError):
                return


def _done(work: Callable[[Any], object], piece: object) -> tuple[object, str]:
    try:
        return work(piece), ""
    except Exception as error:  # A fault of ours or of others is no reason to lose what the others find
        return None, in_words(error)


def in_words(error: Exception) -> str:
    """Return why a piece of work gave nothing."""
    if isinstance(error, CommonlawError):
        return error.sentence(marked)
    if isinstance(error, MemoryError):
        return "there is not enough memory for this: take fewer trials or a smaller library"
    return f"{type(error).__name__}: {error}"
