"""Long work: refused if it exceeds memory, announced if it takes minutes, and its progress shown."""

import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from time import monotonic
from typing import TypeVar

from commonlaw.diagnostics import Diagnostic, marked
from commonlaw.errors import CommonlawError
from commonlaw.runtime.notebooks import ProgressBar, in_notebook
from commonlaw.text import in_line

SECONDS_UNTIL_SHOWN = 2.0
"""Seconds after which people want to know."""


ProgressCallback = Callable[[str], None]


def silent(step: str) -> None:
    """Take a step of work and show nothing."""


class Stage(str):
    """The text of a step of work, and the share of the whole that is done when it begins."""

    done: float

    def __new__(cls, text: str, done: float) -> "Stage":
        """Return a text with a share, from 0 to 1."""
        stage = super().__new__(cls, text)
        stage.done = float(done)  # Which may be one of NumPy
        return stage

    def __reduce__(self) -> tuple[object, ...]:
        return Stage, (str(self), self.done)


class Interim(str):
    """What work has found so far, in a line; it is no step of the work."""


def part(progress: ProgressCallback, begin: float, end: float) -> ProgressCallback:
    """Return what takes the steps of a part of some work, from one share of it to another.

    >>> shares = []
    >>> part(lambda step: shares.append(step.done), 0.5, 0.9)(Stage("half of it", 0.5))
    >>> shares
    [0.7]
    """

    def take(step: str) -> None:
        is_step = not isinstance(step, Interim)
        progress(Stage(step, begin + (end - begin) * getattr(step, "done", 0.0)) if is_step else step)

    return take


class Elapsed:
    """How far work has come: its step, how long it has taken, and what is left where steps say their share.

    `interim` is what it has found so far, in a line, if it has found something.
    """

    def __init__(self) -> None:
        self._began = monotonic()
        self._done, self._done_after = 0.0, 0.0
        self.step, self.interim, self._said = "", "", ""

    @property
    def seconds(self) -> float:
        """How long it has taken."""
        return monotonic() - self._began

    def take(self, step: str) -> None:
        """Begin a step; its share may be smaller than one before, where work turns out to be more."""
        if isinstance(step, Interim):
            self.interim = in_line(step)
            return
        self.step = step
        if isinstance(step, Stage):
            self._done, self._done_after = step.done, self.seconds

    def lines(self) -> list[str]:
        """Return what it has found since the last call, if anything, and the step."""
        news, self._said = [self.interim] * (self.interim != self._said), self.interim
        return [*news, str(self)]

    def __str__(self) -> str:
        """Return the step in words, with the time and what is left."""
        shown, seconds = in_line(self.step), self.seconds
        # Before, the time that was taken does not tell what is left
        if self._done < 0.1:
            return f"{shown} ({in_words(seconds)})".strip()
        remaining = max(self._done_after / self._done - seconds, 0.0)
        rest = f", about {in_words(remaining)} left" if remaining else ""
        return f"{shown} ({in_words(seconds)}, {100 * self._done:.0f} % done{rest})".strip()


def in_words(seconds: float) -> str:
    """Return a length of time.

    >>> in_words(7.2), in_words(200), in_words(9000)
    ('7 s', '3 min', '2.5 h')
    """
    if seconds < 99.5:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5970 else f"{seconds / 3600:.1f} h"


def on_terminal() -> ProgressCallback:
    """Return what shows steps of work where people see it, elsewhere nothing.

    That is a terminal on stderr, when they take long, or a notebook.
    """
    course = Elapsed()
    if in_notebook():
        bar = ProgressBar()

        def show(step: str) -> None:
            course.take(step)
            bar(course.step, course.interim)

        return show
    # Where standard error is closed there is none
    if sys.stderr is None or not sys.stderr.isatty():
        return lambda _: None

    def tell(step: str) -> None:
        course.take(step)
        if course.seconds > SECONDS_UNTIL_SHOWN:
            with suppress(OSError):  # a terminal may be closed while work goes on
                sys.stderr.writelines(f"commonlaw: {line}\n" for line in course.lines())

    return tell


MOST_MEMORY = 4 * 2**30
"""Bytes that one piece of work may take."""


_announcing = ContextVar("_announcing", default=True)

T = TypeVar("T")


class LongWorkWarning(UserWarning):
    """Work has begun that will take minutes; the message says how many, and what makes it less."""


def check_memory(what: str, size: float, remedy: str) -> None:
    """Refuse work that would take so many bytes."""
    if size > MOST_MEMORY:
        raise CommonlawError("too-much-memory", task=what, size=size / 2**30, limit=MOST_MEMORY / 2**30, remedy=remedy)


def announce(what: str, seconds: float, remedy: str | Diagnostic) -> None:
    """Warn of work that will take about so many seconds, if it is over a minute."""
    if seconds > 60 and _announcing.get():
        length = f"{seconds / 60:.0f} minutes" if seconds < 7200 else f"{seconds / 3600:.0f} hours"
        warning = Diagnostic("long-work", {"work": what, "length": length, "remedy": remedy})
        warnings.warn(warning.sentence(marked), LongWorkWarning, stacklevel=2)


@contextmanager
def unannounced() -> Iterator[None]:
    """Announce nothing: the pieces of a longer work, which nobody awaits by themselves."""
    token = _announcing.set(False)
    try:
        yield
    finally:
        _announcing.reset(token)


def announced(pieces: Sequence[T], what: str, remedy: str) -> Iterator[T]:
    """Yield pieces of work; once a few of them show that the whole takes long, it is announced."""
    began, is_told = monotonic(), False
    for done, piece in enumerate(pieces):
        seconds = monotonic() - began
        if done and seconds > 5.0 and not is_told:
            announce(what, seconds / done * len(pieces), remedy)
            is_told = True
        yield piece
