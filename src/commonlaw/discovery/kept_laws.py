"""Laws that were found before: the same trials, question and version give the same law, so it is found once.

Laws lie in the user's cache folder as JSON with a checksum, written whole or not at all. What is damaged or cannot be
read is found anew. Of too many laws the ones longest not asked for go.
"""

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path

import numpy as np

import commonlaw
from commonlaw.errors import CommonlawError
from commonlaw.law import Law, from_json, to_json
from commonlaw.runtime.files import make_folder, mark_as_used, remove_longest_unused, write_whole
from commonlaw.runtime.progress import ProgressCallback, Stage
from commonlaw.runtime.reading import read_file
from commonlaw.trials import Trials

VARIABLE = "COMMONLAW_CACHE"
"""Environment variable that names another folder, or with ``off`` has no law kept."""

LARGEST = 200 * 2**20
"""Bytes that all laws may take."""


class _UnknownError(Exception):
    """Nothing tells whether two values of this kind are the same."""


def found_once(
    trials: Trials, question: Mapping[str, object], find: Callable[[], Law], progress: ProgressCallback
) -> Law:
    """Return the law that was found for this question in these trials before, or find it and keep it.

    The question is all that decides which law is found, by name. With values of other classes, such as
    functions, whose equality cannot be checked, the law is found anew.
    """
    path = _path(trials, question)
    if path is None:
        return find()
    kept = _read(path)
    if kept is not None:
        progress(Stage("reading the law from the cache", 1.0))
        return kept
    law = find()
    with suppress(OSError, CommonlawError):  # A full or read-only disk, or a law of somebody's own terms
        _write(path, law)
    return law


def digest(value: object) -> str:
    """Return what is the same for equal values of numbers, texts, arrays, and collections and dataclasses of them.

    Fields in which equal dataclasses may differ do not count.

    Raises `_UnknownError` if a value is of another class, or of a subclass.
    """
    found = hashlib.sha256()
    for each in _parts(value):
        found.update(len(each).to_bytes(8, "little") + each)
    return found.hexdigest()


def _path(trials: Trials, question: Mapping[str, object]) -> Path | None:
    """Return where the law is kept; None if it is not."""
    folder = os.environ.get(VARIABLE, "")
    if folder.lower() == "off":
        return None
    try:
        name = digest((_version(), os.environ.get("COMMONLAW_KERNEL", ""), trials, question))
    except _UnknownError:
        return None
    if folder:
        return Path(folder) / name
    from platformdirs import user_cache_path

    return user_cache_path("commonlaw", appauthor=False) / "laws" / name


def _read(path: Path) -> Law | None:
    """Return a law that was kept; None if there is none, or it is damaged."""
    try:
        checksum, _, content = read_file(path).partition(b"\n")
        if checksum != hashlib.sha256(content).hexdigest().encode():
            return None
        law = from_json(content)
    except CommonlawError:
        return None
    mark_as_used(path)
    return law


def _write(path: Path, law: Law) -> None:
    """Keep a law, and remove those longest not asked for if all take too much."""
    content = to_json(law).encode()
    if len(content) > LARGEST:
        return
    make_folder(path.parent)
    write_whole(path, hashlib.sha256(content).hexdigest().encode() + b"\n" + content)
    remove_longest_unused((each for each in path.parent.iterdir() if len(each.name) == len(path.name)), LARGEST)


@cache
def _version() -> str:
    """Return what is the same as long as the program is: its version, and every file of it as it is now."""
    import scipy

    root = Path(commonlaw.__file__).parent
    files = sorted(each for kind in ("*.py", "*.so", "*.pyd", "*.dylib") for each in root.rglob(kind))
    known = [(str(each.relative_to(root)), each.stat().st_size, each.stat().st_mtime_ns) for each in files]
    return digest((commonlaw.__version__, np.__version__, scipy.__version__, known))


def _parts(value: object) -> Iterator[bytes]:
    """Yield what a value is made of, each with its kind."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        yield f"array {value.dtype.str} {value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif value is None or isinstance(value, bool | int | float | complex | str | np.generic):
        yield f"{type(value).__name__} {value!r}".encode()
    elif isinstance(value, Mapping):
        yield f"mapping {len(value)}".encode()
        yield from _parts_of_all([each for pair in value.items() for each in pair])
    elif isinstance(value, list | tuple):
        yield f"sequence {len(value)}".encode()
        yield from _parts_of_all(value)
    elif (
        is_dataclass(value)
        and not isinstance(value, type)
        and type(value).__module__.split(".")[0] == commonlaw.__name__
    ):
        yield f"{type(value).__module__} {type(value).__qualname__}".encode()
        yield from _parts_of_all([getattr(value, each.name) for each in fields(value) if each.compare])
    else:
        raise _UnknownError


def _parts_of_all(values: Sequence[object]) -> Iterator[bytes]:
    for each in values:
        yield from _parts(each)
