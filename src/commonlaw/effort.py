"""Work that would take more than memory is refused before it begins, and work of minutes is announced."""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from time import monotonic
from typing import TypeVar

from commonlaw.diagnostics import Diagnostic, marked
from commonlaw.errors import CommonlawError

MOST_MEMORY = 4 * 2**30
"""Bytes that one piece of work may take."""

PATIENCE = 60.0
"""Seconds beyond which work is announced."""

_TRIED = 5.0
"""Seconds after which it shows how long work takes that nothing tells beforehand."""

_announcing = ContextVar("_announcing", default=True)

T = TypeVar("T")


class LongWorkWarning(UserWarning):
    """Work has begun that will take minutes; the message says how many, and what makes it less."""


def check_memory(what: str, size: float, remedy: str) -> None:
    """Refuse work that would take so many bytes."""
    if size > MOST_MEMORY:
        raise CommonlawError("too-much-memory", task=what, size=size / 2**30, limit=MOST_MEMORY / 2**30, remedy=remedy)


def announce(what: str, seconds: float, remedy: str | Diagnostic) -> None:
    """Warn of work that will take about so many seconds, if these are many."""
    if seconds > PATIENCE and _announcing.get():
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
        if done and seconds > _TRIED and not is_told:
            announce(what, seconds / done * len(pieces), remedy)
            is_told = True
        yield piece
