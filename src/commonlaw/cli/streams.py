"""Standard output and error: open, able to take every character, and missed in words where they take nothing."""

import errno
import os
import sys
from codecs import register_error
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from typing import TextIO

from commonlaw.errors import CommonlawError
from commonlaw.text import escaped

_STREAMS = {"stdin": "r", "stdout": "w", "stderr": "w"}
"""Names and modes, by number."""

_TAKES_NOTHING = {errno.EBADF, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ENOSPC}
"""Errors of a stream that is closed, or that goes to where there is no space."""


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
        if error.filename is not None or error.errno not in _TAKES_NOTHING:  # of something else
            raise
        silence(sys.stdout)
        raise CommonlawError("standard-output", reason=error.strerror) from error


def silence(stream: TextIO) -> None:
    """Send what a stream still holds, and all that follows, to nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def _open_closed() -> None:
    """Open streams that are closed, so that no file gets their numbers; nothing can be written to them."""
    for name, mode in _STREAMS.items():
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDONLY), mode))


def _shown(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    return escaped(error.object[error.start : error.end]), error.end
