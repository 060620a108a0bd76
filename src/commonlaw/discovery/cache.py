"""The cache of laws: the same trials, settings and version give the same law.

Laws are stored in the user's cache folder as JSON with a checksum, in atomic writes. Damaged files are ignored. The
least recently used laws are removed if the cache exceeds its size.
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
from commonlaw.runtime.files import make_folder, mark_as_used, read_file, remove_longest_unused, write_whole
from commonlaw.runtime.progress import ProgressCallback, Stage
from commonlaw.trials import Trials

VARIABLE = "COMMONLAW_CACHE"
"""Environment variable with another folder, or ``off`` for no cache."""

LARGEST = 200 * 2**20
"""Size of the cache in bytes."""


class _NotHashableError(Exception):
    """Equality of two values of this class cannot be checked."""


def cached_law(
    trials: Trials, question: Mapping[str, object], find: Callable[[], Law], progress: ProgressCallback
) -> Law:
    """Return the cached law of these trials and settings, or find it and write it to the cache.

    `question` has all settings that influence the law, by name. If the equality of a setting cannot be checked, as of a
    function, the cache is not used.
    """
    path = _path(trials, question)
    if path is None:
        return find()
    cached = _read(path)
    if cached is not None:
        progress(Stage("reading the law from the cache", 1.0))
        return cached
    law = find()
    if not law.provenance.is_stopped:  # Of more time, or a faster machine, there is another one
        with suppress(OSError, CommonlawError):  # A full or read-only disk, or terms that cannot be saved
            _write(path, law)
    return law


def digest(value: object) -> str:
    """Return the SHA-256 hash of a value: a number, text, array, or a collection or dataclass of them.

    Fields that are not compared do not enter.

    Raises `_NotHashableError` if a value is of another class, or of a subclass.
    """
    hashed = hashlib.sha256()
    for content in _parts(value):
        hashed.update(len(content).to_bytes(8, "little") + content)
    return hashed.hexdigest()


def _path(trials: Trials, question: Mapping[str, object]) -> Path | None:
    folder = os.environ.get(VARIABLE, "")
    if folder.lower() == "off":
        return None
    try:
        name = digest((_version(), os.environ.get("COMMONLAW_KERNEL", ""), trials, question))
    except _NotHashableError:
        return None
    if folder:
        return Path(folder) / name
    from platformdirs import user_cache_path

    return user_cache_path("commonlaw", appauthor=False) / "laws" / name


def _read(path: Path) -> Law | None:
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
    content = to_json(law).encode()
    if len(content) > LARGEST:
        return
    make_folder(path.parent)
    write_whole(path, hashlib.sha256(content).hexdigest().encode() + b"\n" + content)
    remove_longest_unused((file for file in path.parent.iterdir() if len(file.name) == len(path.name)), LARGEST)


@cache
def _version() -> str:
    """Return a hash of the versions and of all files of the program."""
    import scipy

    root = Path(commonlaw.__file__).parent
    files = sorted(path for kind in ("*.py", "*.so", "*.pyd", "*.dylib") for path in root.rglob(kind))
    known = [(str(file.relative_to(root)), file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    return digest((commonlaw.__version__, np.__version__, scipy.__version__, known))


def _parts(value: object) -> Iterator[bytes]:
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
    elif (
        is_dataclass(value)
        and not isinstance(value, type)
        and type(value).__module__.split(".")[0] == commonlaw.__name__
    ):
        yield f"{type(value).__module__} {type(value).__qualname__}".encode()
        inside = [getattr(value, field.name) for field in fields(value) if field.compare]
    else:
        raise _NotHashableError
    for part in inside:
        yield from _parts(part)
