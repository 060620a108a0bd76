"""Saying how far long work has come."""

import sys
from collections.abc import Callable
from contextlib import suppress
from time import monotonic

from commonlaw.names import in_line
from commonlaw.notebooks import ProgressBar, in_notebook

PATIENCE = 2.0
"""Seconds after which people want to know."""

ProgressCallback = Callable[[str], None]


def on_terminal() -> ProgressCallback:
    """Return what shows steps of work where people see it, elsewhere nothing.

    That is a terminal on stderr, when they take long, or a notebook.
    """
    if in_notebook():
        return ProgressBar()
    # Where standard error is closed there is none
    if sys.stderr is None or not sys.stderr.isatty():
        return lambda _: None
    began = monotonic()

    def tell(step: str) -> None:
        seconds = monotonic() - began
        if seconds > PATIENCE:
            with suppress(OSError):  # a terminal may be closed while work goes on
                sys.stderr.write(f"commonlaw: {in_line(step)} ({seconds:.0f} s)\n")

    return tell
