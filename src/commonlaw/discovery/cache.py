"""The cache of laws: the same trials, settings and version give the same law.

Laws are stored in the user's cache folder as JSON with a checksum, and steps of stopped searches as msgpack, in atomic
writes. Damaged files are ignored. The least recently used are removed if the cache exceeds its size.
"""

import hashlib
import os
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from functools import cache
from pathlib import Path

import numpy as np
from msgspec import msgpack

import commonlaw
from commonlaw.errors import CommonlawError
from commonlaw.law import Law, from_json, to_json
from commonlaw.runtime.checkpoint import with_checkpoint
from commonlaw.runtime.digest import NotHashableError, digest
from commonlaw.runtime.files import (
    make_folder,
    mark_as_used,
    read_file,
    remove_file,
    remove_longest_unused,
    write_whole,
)
from commonlaw.runtime.progress import ProgressCallback, Stage
from commonlaw.trials import Trials

VARIABLE = "COMMONLAW_CACHE"
"""Environment variable with another folder, or ``off`` for no cache."""

LARGEST = 200 * 2**20
"""Size of the cache in bytes."""


def cached_law(
    trials: Trials,
    question: Mapping[str, object],
    find: Callable[[], Law],
    progress: ProgressCallback,
    *,
    can_stop: bool,
) -> Law:
    """Return the cached law of these trials and settings, or find it and write it to the cache.

    `question` has all settings that influence the law, by name. If the equality of a setting cannot be checked, as of a
    function, the cache is not used. Of a search that was stopped, which it only is if it `can_stop`, the cache keeps
    the steps, with which the same search goes on.
    """
    path = _path(trials, question)
    if path is None:
        return find()
    cached = _read_law(path)
    if cached is not None:
        progress(Stage("reading the law from the cache", 1.0))
        return cached
    of_steps = path.with_suffix(_STEPS)
    content = _read(of_steps)
    steps = {} if content is None else msgpack.decode(content, type=dict[str, bytes])
    with with_checkpoint(steps) if can_stop or steps else nullcontext():
        law = find()
    with suppress(OSError, CommonlawError):  # A full or read-only disk, or terms that cannot be saved
        if law.provenance.is_stopped:  # Of more time, or a faster machine, there is another law
            _write(of_steps, msgpack.encode(steps))
        else:
            _write(path, to_json(law).encode())
            remove_file(of_steps)
    return law


def is_kept(trials: Trials, question: Mapping[str, object]) -> bool:
    """Return whether the cache has the law of these trials and settings, or the steps of a search for it."""
    path = _path(trials, question)
    return path is not None and (path.exists() or path.with_suffix(_STEPS).exists())


_STEPS = ".steps"


def _path(trials: Trials, question: Mapping[str, object]) -> Path | None:
    folder = os.environ.get(VARIABLE, "")
    if folder.lower() == "off":
        return None
    try:
        name = digest((_version(), os.environ.get("COMMONLAW_KERNEL", ""), trials, question))
    except NotHashableError:
        return None
    if folder:
        return Path(folder) / name
    from platformdirs import user_cache_path

    return user_cache_path("commonlaw", appauthor=False) / "laws" / name


def _read(path: Path) -> bytes | None:
    try:
        checksum, _, content = read_file(path).partition(b"\n")
    except CommonlawError:
        return None
    if checksum != hashlib.sha256(content).hexdigest().encode():
        return None
    mark_as_used(path)
    return content


def _read_law(path: Path) -> Law | None:
    content = _read(path)
    try:
        return None if content is None else from_json(content)
    except CommonlawError:
        return None


def _write(path: Path, content: bytes) -> None:
    if len(content) > LARGEST:
        return
    make_folder(path.parent)
    write_whole(path, hashlib.sha256(content).hexdigest().encode() + b"\n" + content)
    remove_longest_unused((file for file in path.parent.iterdir() if len(file.stem) == len(path.stem)), LARGEST)


@cache
def _version() -> str:
    """Return a hash of the versions and of all files of the program."""
    import scipy

    root = Path(commonlaw.__file__).parent
    files = sorted(path for kind in ("*.py", "*.so", "*.pyd", "*.dylib") for path in root.rglob(kind))
    known = [(str(file.relative_to(root)), file.stat().st_size, file.stat().st_mtime_ns) for file in files]
    return digest((commonlaw.__version__, np.__version__, scipy.__version__, known))
