"""Standard output and error: open, able to take every character, and missed in words where they take nothing."""

import os
import sys
from codecs import register_error
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from typing import TextIO

from commonlaw.errors import CommonlawError
from commonlaw.names import escaped

_STREAMS = {"stdin": "r", "stdout": "w", "stderr": "w"}
"""Names and modes, by number."""


@contextmanager
def standard_streams() -> Iterator[None]:
    """Prepare the standard streams for a command, and say why standard output does not take what it prints.

    Characters that a stream has no code for are shown like those that hide.

    Raises
    ------
    CommonlawError
        If standard output is closed, or what it goes to is full.
    """
    _open_closed()
    register_error("commonlaw", _shown)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="commonlaw")
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        if _takes(sys.stdout):
            raise
        silence(sys.stdout)
        raise CommonlawError(
            f"cannot write to standard output: {error.strerror}; leave it open, and send it to where there is space"
        ) from error


def silence(stream: TextIO) -> None:
    """Send what a stream still holds, and all that follows, to nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def _takes(stream: TextIO) -> bool:
    """Return whether a stream has got rid of all that was written to it."""
    try:
        stream.flush()
    except OSError:
        return False
    return True


def _open_closed() -> None:
    """Open streams that are closed, so that no file gets their numbers; nothing can be written to them."""
    for name, mode in _STREAMS.items():
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDONLY), mode))


def _shown(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    return escaped(error.object[error.start : error.end]), error.end
