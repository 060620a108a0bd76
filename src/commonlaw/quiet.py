"""Warnings of other packages that say nothing to users are left out, by one thread at a time."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock

_ALONE = RLock()
"""What warnings are shown is set for the whole process: of two threads, each would put back what the other has set."""


@contextmanager
def quiet(category: type[Warning], message: str = "") -> Iterator[None]:
    """Leave out warnings of a category whose text begins with a regular expression."""
    with _ALONE, warnings.catch_warnings():
        warnings.filterwarnings("ignore", message, category)
        yield
