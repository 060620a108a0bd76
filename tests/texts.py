"""Texts in documents of JSON, and others in place of them."""

from collections.abc import Iterator
from typing import Any

Place = tuple[Any, ...]
"""Names and indices that lead to a text."""


def texts(document: Any, path: Place = ()) -> Iterator[Place]:
    """Yield where texts stand in a document of JSON."""
    if isinstance(document, str):
        yield path
    for key, value in (
        document.items() if isinstance(document, dict) else enumerate(document if isinstance(document, list) else ())
    ):
        yield from texts(value, (*path, key))


def planted(document: Any, path: Place, sentinel: str) -> Any:
    """Return a document with a text in place of another."""
    if not path:
        return sentinel
    inner = planted(document[path[0]], path[1:], sentinel)
    if isinstance(document, dict):
        return document | {path[0]: inner}
    return [*document[: path[0]], inner, *document[path[0] + 1 :]]
