"""Work in processes of its own: the page stays alive, and what is cancelled ends at once."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from threading import Event, Lock, Thread
from time import time
from typing import Any, Generic, TypeVar

from commonlaw.app.question import fault, message, text_in_page
from commonlaw.errors import CommonlawError
from commonlaw.runtime.progress import Interim
from commonlaw.runtime.shutdown import begun, end_with_parent
from commonlaw.runtime.time_limit import stoppable

T = TypeVar("T")

Task = Callable[[Callable[[str], None]], Iterator[T]]
"""Work that tells its stages and yields what it has made so far; it must be possible to pickle it."""

_SECONDS_TO_END = 1.0
"""Time for a process to end by itself after its last message."""

_HEAVY = (
    "commonlaw.app.sessions", "commonlaw.app.result", "commonlaw.discovery", "commonlaw.integration.lsoda", "pint",
    "heyoka",
)  # fmt: skip
"""What takes most of the time until a law is sought."""

Begun = tuple[BaseProcess, Connection]
"""A process that takes a task, and the connection to it."""


class _Ready:
    """A process that waits for the next task: one that was prepared, or has done its task; it need not import again."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._waiting: Begun | None = None

    def prepare(self) -> None:
        """Begin a process, unless one waits."""
        with self._lock:
            if self._waiting is None or not self._waiting[0].is_alive():
                self._waiting = begun(_work, *_HEAVY)

    def keep(self, process: Begun) -> bool:
        """Let a process that has done its task wait for the next one; return False if another one waits."""
        with self._lock:
            if self._waiting is not None and self._waiting[0].is_alive():
                return False
            self._waiting = process
            return True

    def taken(self) -> Begun:
        """Return the process that waits, and let none wait; a new one if there is none."""
        with self._lock:
            ready, self._waiting = self._waiting, None
        return ready if ready is not None and ready[0].is_alive() else begun(_work)


_READY = _Ready()
prepare = _READY.prepare


@dataclass(eq=False)
class Work(Generic[T]):
    """A task that goes on or has ended; a thread takes in what its process says, and then keeps it or sees it off."""

    task: Task[T]
    stages: list[tuple[str, float]] = field(default_factory=list)
    """What was done, and when it began, in seconds by the clock."""
    failure: str = ""
    made: T | None = None
    """What it has made so far."""
    times_made: int = 0
    is_running: bool = True
    interim: str = ""
    """What it has found so far, in a line; with it, it can be stopped."""
    done: float | None = None
    """The largest share of the whole that was done when a stage began; None until one says it."""

    def __post_init__(self) -> None:
        self.stages.append(("starting", time()))
        self._lock = Lock()
        self._is_process_intact = True
        self._process, self._connection = _READY.taken()
        self._listener = Thread(target=self._listen, daemon=True)
        self._listener.start()

    def stop(self) -> None:
        """Let it go on with what it has found so far, and end soon."""
        with self._lock, suppress(OSError):  # Its process may have ended
            if self.is_running:
                self._connection.send(_STOP)

    def cancel(self) -> None:
        """End it now, if it goes on."""
        with self._lock:
            if self.is_running:
                self._process.kill()  # before its connection is closed, of which it would complain
                self.failure, self.is_running, self._is_process_intact = "cancelled", False, False

    def close(self) -> None:
        """End it now, and wait until its process is gone."""
        self.cancel()
        self._listener.join(_SECONDS_TO_END)

    def state(self) -> dict[str, Any]:
        """Return what is sent to the page: whether it goes on, its stages with the seconds that they took, what failed.

        And what it has found so far in a line, how often it has made something, and the share of the whole that is
        done, null where it is not known.
        """
        with self._lock:
            begun = [when for _, when in self.stages]
            ends = [*begun[1:], time()]
            stages = [(what, round(end - when, 1)) for (what, when), end in zip(self.stages, ends, strict=True)]
            steps = {"stages": stages, "interim": self.interim, "done": self.done, "made": self.times_made}
            return {"running": self.is_running, "failure": self.failure} | steps

    def _listen(self) -> None:
        try:
            self._connection.send(self.task)
            while self.is_running:
                self._take(*self._connection.recv())
        except (EOFError, OSError):  # The process has ended
            self._process.join(_SECONDS_TO_END)
            self._fail(CommonlawError("work-ended", code=self._process.exitcode))
        except Exception as error:  # The task cannot be sent, or what was sent cannot be read
            self._fail(fault(error))
        if self._is_process_intact and _READY.keep((self._process, self._connection)):
            return
        self._connection.close()
        self._process.join(_SECONDS_TO_END)
        self._process.kill()
        self._process.join()

    def _fail(self, error: CommonlawError) -> None:
        self._is_process_intact = False
        self._take("end", message(error))

    def _take(self, kind: str, value: Any) -> None:
        with self._lock:
            if not self.is_running:
                return
            if kind == "stage":
                text, when, done = value
                self.stages.append((text, when))
                self.done = done if self.done is None else max(self.done, done or 0.0)
            elif kind == "interim":
                self.interim = value
            elif kind == "made":
                self.made, self.times_made = value, self.times_made + 1
            else:
                self.failure, self.is_running = value, False


def _work(connection: Connection, *modules: str) -> None:
    """Import modules, and do tasks as they come; the main function of the process."""
    end_with_parent()
    for module in modules:
        if find_spec(module) is not None:
            import_module(module)
    try:
        while True:
            received = connection.recv()
            if received != _STOP:  # Of a task that has ended since
                _do(received, connection)
    except (EOFError, ConnectionError):  # the app has ended
        pass


_STOP = "stop"
"""What is sent to a process whose task is to end with what it has found."""


@contextmanager
def _stopped_from(connection: Connection) -> Iterator[None]:
    """Let a search within end with its best law once that is asked for over a connection."""
    stop, ended = Event(), Event()

    def listen() -> None:
        with suppress(EOFError, OSError):
            while not ended.wait(0.1):
                if connection.poll():
                    connection.recv()
                    stop.set()

    listener = Thread(target=listen, daemon=True)
    listener.start()
    try:
        with stoppable(stop):
            yield
    finally:
        ended.set()
        listener.join()


def _do(task: Task[Any], connection: Connection) -> None:
    """Do a task, and say how far it has come, what it has made, and its end."""

    def show(stage: str) -> None:
        if isinstance(stage, Interim):
            connection.send(("interim", str(stage)))
        else:
            connection.send(("stage", (str(stage), time(), getattr(stage, "done", None))))

    # Each task has all its warnings: what was shown of another one is forgotten
    with _stopped_from(connection), warnings.catch_warnings():
        warnings.showwarning = lambda text, *_, **__: show(text_in_page(str(text)))
        try:
            for made in task(show):
                connection.send(("made", made))
            failure = ""
        except CommonlawError as error:
            failure = message(error)
        except ConnectionError:  # the app has ended
            raise
        except Exception as error:  # Also what cannot be sent
            failure = message(fault(error))
    connection.send(("end", failure))
