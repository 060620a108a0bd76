"""One thread of linear algebra while laws are found: more only get in each other's way on matrices of this size."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Any


class _Limit:
    """How many hold to the limit, and what the first of them has found."""

    lock = Lock()
    users = 0
    first: Any = None


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Hold linear algebra to one thread, also where several threads of a program do so at once.

    The limit is one of the process: who comes while it holds takes it for what was there before, and so the last to
    leave puts back what the first has found.
    """
    from threadpoolctl import threadpool_limits

    with _Limit.lock:
        own = threadpool_limits(1, "blas")
        _Limit.first = _Limit.first if _Limit.users else own
        _Limit.users += 1
    try:
        with own:
            yield
    finally:
        with _Limit.lock:
            _Limit.users -= 1
            if not _Limit.users:
                with _Limit.first:
                    pass  # leaving puts back what was found
