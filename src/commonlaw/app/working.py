"""Work in processes of its own: the page stays alive, and what is cancelled ends at once."""

import pickle
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from multiprocessing import get_context
from multiprocessing.connection import Connection
from threading import Lock
from time import time
from typing import Any, Generic, TypeVar

from commonlaw.app.words import in_page
from commonlaw.errors import CommonlawError

T = TypeVar("T")

Task = Callable[[Callable[[str], None]], Iterator[T]]
"""Work that tells its stages and yields what it has made so far; it must be possible to pickle it."""

_CONTEXT = get_context("spawn")
"""A forked process would have the threads' locks of this one, and none of its threads."""


@dataclass
class Work(Generic[T]):
    """Work that goes on or has ended.

    Parameters
    ----------
    task
        What is done.
    """

    task: Task[T]
    stages: list[tuple[str, float]] = field(default_factory=list)
    """What was done, and when it began, in seconds by the clock."""
    failure: str = ""
    made: T | None = None
    """What it has made so far."""
    times_made: int = 0

    def __post_init__(self) -> None:
        self._take("stage", ("starting", time()))
        self._lock = Lock()
        self._connection, other = _CONTEXT.Pipe(duplex=False)
        self._process = _CONTEXT.Process(target=_work, args=(other, self.task), daemon=True)
        self._process.start()
        other.close()

    @property
    def is_running(self) -> bool:
        """Whether it goes on; takes in what the process has said."""
        with self._lock:
            while self._is_open and self._connection.poll():
                self._take(*self._said())
            return self._is_open

    def cancel(self) -> None:
        """End it now, if it goes on."""
        if self.is_running:
            with self._lock:
                self._process.kill()
                self._take("end", "cancelled")

    def state(self) -> dict[str, Any]:
        """Return what the page is told: whether it goes on, its stages with the seconds that they took, what failed.

        And how often it has made something.
        """
        running = self.is_running
        begun = [when for _, when in self.stages]
        ends = [*begun[1:], time()]
        stages = [(what, round(end - when, 1)) for (what, when), end in zip(self.stages, ends, strict=True)]
        return {"running": running, "stages": stages, "failure": self.failure, "made": self.times_made}

    @property
    def _is_open(self) -> bool:
        return not self._connection.closed

    def _said(self) -> tuple[str, Any]:
        try:
            kind, value = self._connection.recv()
        except (EOFError, pickle.UnpicklingError):
            self._process.join(1)
            code = self._process.exitcode
            return "end", f"the work ended by itself, with code {code}: there may be too little memory"
        return kind, value

    def _take(self, kind: str, value: Any) -> None:
        if kind == "stage":
            self.stages.append(value)
        elif kind == "made":
            self.made, self.times_made = value, self.times_made + 1
        else:
            self.failure = value
            self._connection.close()


def _work(connection: Connection, task: Task[Any]) -> None:
    """Work, and say how far it has come; the main function of the process."""

    def show(stage: str) -> None:
        connection.send(("stage", (stage, time())))

    warnings.showwarning = lambda message, *_, **__: show(in_page(str(message)))
    try:
        for made in task(show):
            connection.send(("made", made))
        connection.send(("end", ""))
    except CommonlawError as error:
        connection.send(("end", in_page(str(error))))
    except MemoryError:
        connection.send(("end", "there is not enough memory for this: take fewer trials or a smaller library"))
