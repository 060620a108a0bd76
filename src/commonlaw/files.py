"""Writing files whole or not at all."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar
from uuid import uuid4

from commonlaw.errors import CommonlawError

P = TypeVar("P", bound=str | os.PathLike[str])


def write_whole(path: str | os.PathLike[str], content: bytes) -> None:
    """Write `content` to `path` so that a reader sees the old file or the whole new one."""
    write_all({path: content})


def write_all(contents: Mapping[P, bytes]) -> None:
    """Write several files: all of them are complete beside their targets before the first is put in place.

    Raises
    ------
    CommonlawError
        If a folder does not exist or cannot be written to, or the disk is full; no target is touched then.
    """
    staged: list[tuple[Path, Path]] = []
    try:
        for path, content in contents.items():
            target = _target(path)
            temporary = target.parent / f".commonlaw-{uuid4().hex}"
            staged.append((temporary, target))
            temporary.write_bytes(content)
        for temporary, target in staged:
            temporary.replace(target)
    except OSError as error:
        raise CommonlawError(
            f"cannot write {target}: {error.strerror}; choose a folder that you may write to and that has space"
        ) from error
    finally:
        for temporary, _ in staged:
            temporary.unlink(missing_ok=True)


def _target(path: str | os.PathLike[str]) -> Path:
    """Return `path` if a file can have it."""
    target = Path(path)
    if target.is_dir():
        raise CommonlawError(f"cannot write {target}: it is a folder; name a file in it")
    if not target.parent.is_dir():
        raise CommonlawError(
            f"cannot write {target}: there is no folder {str(target.parent)!r}; create it or choose another"
        )
    return target
