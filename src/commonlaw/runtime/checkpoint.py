"""Checkpoint and restart: results of the long steps of a search, with which it goes on where it was stopped.

A step is a function of values. Its result is looked up by the hash of the function and its arguments, so that a search
that begins again takes from the checkpoint what was done before, bit by bit the same, and computes only the rest.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import fields, is_dataclass
from functools import wraps
from pkgutil import resolve_name
from time import perf_counter
from typing import Literal, ParamSpec, TypeVar

import numpy as np
from msgspec import msgpack

from commonlaw.runtime.digest import PACKAGE, NotHashableError, digest, is_of_package
from commonlaw.runtime.time_limit import current_limit

LEAST_TIME = 2e-3
"""Seconds: what takes less time is computed again, as it costs about as much to look it up."""

P = ParamSpec("P")
T = TypeVar("T")

_CHECKPOINT = ContextVar[dict[str, bytes] | None]("_CHECKPOINT", default=None)


@contextmanager
def with_checkpoint(results: dict[str, bytes]) -> Iterator[None]:
    """Let steps within take their results from a checkpoint, or add them to it."""
    token = _CHECKPOINT.set(results)
    try:
        yield
    finally:
        _CHECKPOINT.reset(token)


def is_replay() -> bool:
    """Return whether there is a checkpoint with results."""
    return bool(_CHECKPOINT.get())


def checkpointed(step: Callable[P, T]) -> Callable[P, T]:
    """Let a function of values that returns values be a step, see `at_checkpoint`."""

    @wraps(step)
    def replayed(*args: P.args, **kwargs: P.kwargs) -> T:
        return at_checkpoint(lambda: step(*args, **kwargs), step.__qualname__, *args, kwargs)

    return replayed


def at_checkpoint(step: Callable[[], T], *key: object) -> T:
    """Return the result of a step that depends on the values of a key only.

    It is taken from the checkpoint, if there is one that has it, and added to it if it took long. It consists of
    numbers, texts, arrays, tuples, lists, mappings, and dataclasses of the package.
    """
    results = _CHECKPOINT.get()
    if results is None:
        return step()
    try:
        name = digest(key, keep=True)
    except NotHashableError:
        return step()
    if name in results:
        result: T = msgpack.decode(results[name], ext_hook=_restored)
        return result
    began = perf_counter()
    result = step()
    if perf_counter() - began > LEAST_TIME:
        results[name] = msgpack.encode(_written(result))
        if (limit := current_limit()) is not None:
            limit.end_replay()
    return result


def _written(value: object) -> object:
    """Return a value of numbers, texts and lists, with all else as a list of its kind and its parts."""
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, np.ndarray):
        order: Literal["C", "F"] = "F" if value.flags.fnc else "C"  # Sums of columns depend on it in the last bit
        parts: list[object] = ["array", value.dtype.str, list(value.shape), order, value.tobytes(order)]
    elif isinstance(value, np.generic):
        parts = ["number", value.dtype.str, value.tobytes()]
    elif isinstance(value, list):
        return [*map(_written, value)]
    elif type(value) is tuple:
        parts = ["tuple", *map(_written, value)]
    elif isinstance(value, Mapping):
        parts = ["mapping", *(_written(part) for pair in value.items() for part in pair)]
    else:
        inner = [str(value)] if isinstance(value, str) else [_written(part) for part in _parts(value)]
        parts = [f"{type(value).__module__}:{type(value).__qualname__}", *inner]
    return msgpack.Ext(0, msgpack.encode(parts))


def _parts(value: object) -> Iterator[object]:
    assert is_dataclass(value)
    assert is_of_package(type(value))
    yield from (getattr(value, field.name) for field in fields(value) if field.init)


def _restored(_: int, content: memoryview) -> object:
    """Return what `_written` made a list of kind and parts; the number is that of the kind of extension."""
    kind, *parts = msgpack.decode(content, ext_hook=_restored)
    match kind, parts:
        case "array", [dtype, shape, order, values]:
            return np.frombuffer(values, dtype).reshape(shape, order=order).copy(order="K")
        case "number", [dtype, values]:
            return np.frombuffer(values, dtype)[0]
        case "tuple", _:
            return tuple(parts)
        case "mapping", _:
            return dict(zip(parts[::2], parts[1::2], strict=True))
    module = kind.partition(":")[0]
    made = resolve_name(kind) if module.startswith(f"{PACKAGE}.") else None
    if not (isinstance(made, type) and made.__module__ == module):
        raise ValueError(f"{kind} is no class of the package")
    return made(*parts)
