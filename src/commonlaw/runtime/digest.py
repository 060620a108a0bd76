"""Hashes of values: equal values have the same, in any process."""

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields, is_dataclass

import numpy as np

PACKAGE = __name__.split(".")[0]


class NotHashableError(Exception):
    """Equality of two values of this class cannot be checked."""


def digest(value: object, *, keep: bool = False) -> str:
    """Return the SHA-256 hash of a value: a number, text, array, or a collection or dataclass of them.

    Fields that are not compared do not enter. With `keep`, frozen dataclasses within keep their hashes, for values
    that nothing changes.

    Raises `NotHashableError` if a value is of another class, or of a subclass.
    """
    hashed = hashlib.sha256()
    for content in _parts(value, keep):
        hashed.update(len(content).to_bytes(8, "little") + content)
    return hashed.hexdigest()


def is_of_package(kind: type) -> bool:
    """Return whether a class is a dataclass of the package."""
    return is_dataclass(kind) and kind.__module__.split(".")[0] == PACKAGE


def _parts(value: object, keep: bool) -> Iterator[bytes]:
    inside: Sequence[object] = ()
    if isinstance(value, np.ndarray) and value.dtype != object:
        yield f"array {value.dtype.str} {value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif value is None or isinstance(value, bool | int | float | complex | str | np.generic):
        yield f"{type(value).__name__} {value!r}".encode()
    elif isinstance(value, Mapping):
        yield f"mapping {len(value)}".encode()
        inside = [part for pair in value.items() for part in pair]
    elif isinstance(value, list | tuple):
        yield f"sequence {len(value)}".encode()
        inside = value
    elif is_dataclass(value) and not isinstance(value, type) and is_of_package(type(value)):
        is_frozen = type(value).__setattr__ is not object.__setattr__
        keeps = keep and is_frozen and hasattr(value, "__dict__")
        attributes = vars(value) if keeps else {}
        if _KEPT in attributes:
            yield attributes[_KEPT]
            return
        name = f"{type(value).__module__} {type(value).__qualname__}"
        content = [name, *(getattr(value, field.name) for field in fields(value) if field.compare)]
        attributes[_KEPT] = digest(content, keep=keep).encode()
        yield attributes[_KEPT]
    else:
        raise NotHashableError
    for part in inside:
        yield from _parts(part, keep)


_KEPT = "_digest"
"""The attribute with the hash of a dataclass that keeps it."""
