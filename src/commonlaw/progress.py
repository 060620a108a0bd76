"""Saying how far long work has come."""

import sys
from collections.abc import Callable
from time import monotonic

from commonlaw.names import in_line

PATIENCE = 2.0
"""Seconds after which people want to know."""

ProgressCallback = Callable[[str], None]


def on_terminal() -> ProgressCallback:
    """Return what writes steps of work to a terminal on stderr, when they take long; elsewhere it writes nothing."""
    if not sys.stderr.isatty():
        return lambda _: None
    began = monotonic()

    def tell(step: str) -> None:
        seconds = monotonic() - began
        if seconds > PATIENCE:
            sys.stderr.write(f"commonlaw: {in_line(step)} ({seconds:.0f} s)\n")

    return tell
