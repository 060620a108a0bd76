"""Cached properties and locks that work in a process that was forked while other threads held them.

The thread that holds a lock is not in the forked process, so that nothing frees it there.
"""

import functools
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from threading import RLock
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING or sys.version_info >= (3, 12):
    from functools import cached_property as cached_property
else:

    class _CachedProperty(functools.cached_property):
        """That of Python 3.12, without a lock: where two threads compute it at once, both get what the first has."""

        def __get__(self, instance: Any, owner: Any = None) -> Any:
            """Return what is computed at the first access."""
            if instance is None:
                return self
            return instance.__dict__.setdefault(self.attrname, self.func(instance))

    cached_property = _CachedProperty


class ProcessLock:
    """A lock of this process, which a forked one has free.

    >>> lock = ProcessLock()
    >>> with lock.held():
    ...     pass
    """

    def __init__(self) -> None:
        self._renew()
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._renew)

    def _renew(self) -> None:
        self._lock = RLock()

    @contextmanager
    def held(self) -> Iterator[None]:
        """Hold the lock while what is within goes on."""
        with self._lock:
            yield
