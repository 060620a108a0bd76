"""Files: read within stated limits, and written whole or not at all, with respect for what is there already.

A regular file is replaced in one step and keeps its permissions; a symbolic link stays, and the file that it points to
is replaced. Devices and pipes are written to. Refused are read-only files, even for root, and files with further names
(hard links): a replacement would part them from these, and writing in place could leave them half-written.
"""

import errno
import io
import os
import re
import stat
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar
from uuid import uuid4

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.runtime.shutdown import put_away_first

LARGEST_FILE = 2**30
"""Bytes of a file that is read whole."""
MOST_ROWS = 10_000_000
MOST_COLUMNS = 10_000
MOST_CELLS = 30_000_000
"""Rows, columns and cells of a table that is held in memory."""
MOST_LINES = 2 * MOST_ROWS
"""Lines of text, with blank ones and comments."""
LONGEST_LINE = 2**22
"""Bytes of a line of text: 400 characters in each of `MOST_COLUMNS`."""
LARGEST_INFLATED = 2**28
"""Bytes to which a compressed file may unpack: text of 10 bytes in each of `MOST_CELLS`."""
LARGEST_JSON = 2**26
"""Bytes of a law, and of what a Parquet file says of its columns."""
DEEPEST = 32
"""Lists and objects within each other in JSON."""

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
"""What Excel writes before UTF-8."""

T = TypeVar("T")

_GZIP, _BZIP2, _XZ = b"\x1f\x8b", b"BZh", b"\xfd7zXZ\0"
"""What compressed files begin with."""
PARQUET, WORKBOOK = b"PAR1", (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""What tables begin with that are not text."""
_STEPS = np.array([(byte in b"[{") - (byte in b"]}") for byte in range(256)], dtype=np.int8)
"""By how much each byte of JSON, outside of texts, changes the depth."""
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
"""Characters that no text of an instrument has."""


def is_file(name: str | os.PathLike[str]) -> bool:
    """Return whether a file has this name, which may be any text: of one too long for a name none has."""
    return _mode(name, stat.S_ISREG)


def is_folder(name: str | os.PathLike[str]) -> bool:
    """Return whether a folder has this name, which may be any text."""
    return _mode(name, stat.S_ISDIR)


def _mode(name: str | os.PathLike[str], is_kind: Callable[[int], bool]) -> bool:
    try:
        return is_kind(Path(name).stat().st_mode)
    except (OSError, ValueError):
        return False


def path_of(path: object) -> Path:
    """Return an argument as a path; refused if it is no name of a file."""
    if not isinstance(path, str | os.PathLike):
        raise CommonlawError("argument-type", name="path", kind=type(path).__name__, expected="the name of a file")
    return Path(path)


def checked_file(path: str | os.PathLike[str], largest: float = LARGEST_FILE) -> Path:
    """Return the path of a regular file of at most so many bytes.

    Raises `CommonlawError` if there is none: folders, devices and pipes, which may have no end, are refused too.
    """
    file = path_of(path)
    try:
        state = file.stat()
    except FileNotFoundError:
        raise _no_file(file) from None
    except (OSError, ValueError) as error:
        raise _unreadable(file, error) from None
    if stat.S_ISDIR(state.st_mode):
        raise CommonlawError("file-is-folder", file=file)
    if not stat.S_ISREG(state.st_mode):
        raise CommonlawError("file-is-device", file=file)
    if state.st_size > largest:
        raise CommonlawError("file-too-large", file=file, bytes=state.st_size, limit=largest)
    return file


def read_file(path: str | os.PathLike[str]) -> bytes:
    """Return what is in a regular file.

    Raises `CommonlawError` if it cannot be read, or is larger than `LARGEST_FILE`; the message names the file.
    """
    file = checked_file(path)
    try:
        return file.read_bytes()
    except OSError as error:
        raise _unreadable(file, error) from None


def check_size(source: str, rows: int, columns: int) -> None:
    """Refuse a table of more rows, columns or cells than are held in memory."""
    for count, most, what in (
        (columns, MOST_COLUMNS, "columns"),
        (rows, MOST_ROWS, "rows"),
        (rows * columns, MOST_CELLS, f"cells, {rows} rows of {columns}"),
    ):
        if count > most:
            raise CommonlawError("table-too-large", source=source, count=count, cells=what, limit=most)


def unpacked(source: str, content: bytes) -> bytes:
    """Return what a file holds that may be compressed: by gzip, bzip2 or xz.

    Raises `CommonlawError` if it is damaged, unpacks to more than `LARGEST_INFLATED`, takes more memory for that, or
    is text of more or longer lines than `MOST_LINES` and `LONGEST_LINE`.
    """
    import lzma

    if not content.startswith((_GZIP, _BZIP2, _XZ)):
        _check_parts(source, (content[i : i + 2**20] for i in range(0, len(content), 2**20)), LARGEST_FILE)
        return content
    try:
        # Counted first, as a small file may unpack to more than the memory holds
        _check_parts(source, _parts(content), LARGEST_INFLATED)
        whole = io.BytesIO()
        whole.writelines(_parts(content))
        return whole.getvalue()
    except (OSError, EOFError, lzma.LZMAError, zlib.error) as error:
        if "Memory usage limit" in str(error):
            raise CommonlawError("dictionary-too-large", source=source, limit=LARGEST_FILE) from None
        raise CommonlawError("not-unpacked", source=source, error=error) from None


def _check_parts(source: str, parts: Iterable[bytes], limit: int) -> None:
    """Refuse content at the first part with which it is larger than a number of bytes, or has too many lines."""
    size = lines = length = 0
    is_text = True
    for part in parts:
        is_text = is_text if size else not part.startswith((PARQUET, *WORKBOOK))
        size += len(part)
        if size > limit:
            raise CommonlawError("unpacked-too-large", source=source, limit=limit)
        if not is_text:
            continue
        lines += max(part.count(b"\n"), part.count(b"\r"))
        if lines > MOST_LINES:
            raise CommonlawError("table-too-large", source=source, count=lines, cells="lines", limit=MOST_LINES)
        end = max(part.rfind(b"\n"), part.rfind(b"\r"))
        length = len(part) - end - 1 + (length if end < 0 else 0)
        if length > LONGEST_LINE:
            raise CommonlawError("line-too-long", source=source, line=lines + 1, limit=LONGEST_LINE)


def _parts(content: bytes) -> Iterator[bytes]:
    """Yield what compressed bytes hold, part by part; streams may follow each other."""
    import bz2
    import gzip
    import lzma

    if not content.startswith(_XZ):
        packed = io.BytesIO(content)
        with gzip.GzipFile(fileobj=packed) if content.startswith(_GZIP) else bz2.BZ2File(packed) as stream:
            yield from iter(lambda: stream.read(2**20), b"")
        return
    while content:
        decompressor = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=LARGEST_FILE)
        while not decompressor.eof:
            yield decompressor.decompress(content, 2**20)
            content = b""
            if decompressor.needs_input and not decompressor.eof:
                raise EOFError("it ends within a stream")
        content = decompressor.unused_data.lstrip(b"\0")  # Between streams there may be padding


def decoded(source: str, content: bytes) -> tuple[str, str]:
    """Return bytes as text, with lines that end in a line feed, and the encoding if it is not UTF-8.

    UTF-16 shows itself by its first bytes, or by zeros in every other one; what is not UTF-8 either is Windows-1252, of
    which Latin-1 text is a part.

    Raises `CommonlawError` if it is no text.
    """
    zeros = [content[i:400:2].count(0) for i in (0, 1)]
    marked = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    utf_16 = "UTF-16-LE" if zeros[1] > len(content[:400]) / 4 else "UTF-16-BE"
    wide = marked or max(zeros) > len(content[:400]) / 4
    for encoding in ("UTF-16" if marked else utf_16,) if wide else ("UTF-8-sig", "Windows-1252"):
        try:
            text = content.decode(encoding)
        except UnicodeDecodeError:
            continue
        if not (_CONTROL.search(text) if encoding == "Windows-1252" else "\0" in text):
            return text.replace("\r\n", "\n").replace("\r", "\n"), encoding.removesuffix("-sig").replace("UTF-8", "")
        break
    raise CommonlawError("not-a-table", source=source)


def check_text(source: str, content: bytes) -> None:
    """Refuse bytes that are not text in UTF-8; the message names the line."""
    try:
        content.decode()
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise CommonlawError("not-utf-8", source=source, line=line, byte=content[error.start]) from None


def read_json(content: bytes, kind: type[T], largest: int = LARGEST_JSON) -> T:
    """Return the value of a type that msgspec knows from JSON.

    Raises `CommonlawError` if it is no JSON, of another type, larger than so many bytes or nested deeper than
    `DEEPEST`; the message says where.
    """
    import msgspec

    if len(content) > largest:
        raise CommonlawError("json-too-large", bytes=len(content), limit=largest)
    check_text("JSON", content)
    # Without escaped quotes, what stands behind an odd number of quotes is in a text
    bare = np.frombuffer(content.replace(rb"\\", b"").replace(rb"\"", b""), dtype=np.uint8)
    steps = _STEPS[bare] * (1 - np.cumsum(bare == ord('"'), dtype=np.uint8) % 2)
    depth = int(np.cumsum(steps[steps != 0], dtype=np.int32).max(initial=0))
    if depth > DEEPEST:
        raise CommonlawError("json-too-deep", depth=depth, limit=DEEPEST)
    try:
        return msgspec.json.decode(content, type=kind)
    except msgspec.DecodeError as error:
        raise CommonlawError("json-syntax", problem=error) from None


def _unreadable(file: Path, error: Exception) -> CommonlawError:
    reason = getattr(error, "strerror", None) or error
    return CommonlawError("file-unreadable", file=str(file)[:200], reason=reason)


def _no_file(file: Path) -> CommonlawError:
    folder = file.parent
    if file.is_symlink():
        return CommonlawError("link-broken", file=file, target=str(file.readlink()))
    if not is_folder(folder):
        return CommonlawError("folder-missing", file=str(file), folder=str(folder))
    try:
        where = str(folder.absolute())
        names = {entry.name.casefold(): entry.name for entry in islice(folder.iterdir(), 10_000)}
    except OSError:  # The folder may not be listed, or was deleted
        where, names = str(folder), {}
    near = get_close_matches(file.name.casefold(), names, n=1)
    hint = f"did you mean {names[near[0]]!r}?" if near else "check the name"
    return CommonlawError("file-missing", file=file.name, folder=where, hint=hint)


AnyPath = str | os.PathLike[str]
P = TypeVar("P", bound=AnyPath)

_ANCHOR = re.compile(r"\.commonlaw-[0-9a-f]{32}")
"""Name of the file that stands, locked, for those that one process is writing in a folder."""

_REMEDIES = {
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ENXIO: "start what reads from it first",
    errno.EPIPE: "keep what reads from it running",
}


def write_whole(path: AnyPath, content: bytes, mode: int = 0o666) -> None:
    """Write `content` to `path` so that a reader sees the old file or the whole new one, with these permissions."""
    write_all({path: content}, mode)


def write_all(contents: Mapping[P, bytes], mode: int = 0o666) -> None:
    """Write several files: all of them are complete next to their targets before the first is put in place.

    What a process that was killed has left half-written in these folders is removed.

    Raises `CommonlawError` if a target cannot be written to, see `check_targets`, or the disk is full; no file is
    touched then.
    """
    targets = check_targets(contents)
    with put_away_first() as ending, ExitStack() as stack:
        anchors: dict[Path, Path] = {}
        staged: list[tuple[_Target, Path]] = []
        for number, (target, content) in enumerate(zip(targets, contents.values(), strict=True)):
            if target.is_stream:
                continue
            ending.check()
            with _refused(target.path):
                folder = target.file.parent
                if folder not in anchors:
                    anchors[folder] = stack.enter_context(_anchor(folder))
                part = folder / f"{anchors[folder].name}-{number}"
                stack.callback(part.unlink, missing_ok=True)
                _stage(part, content, target.status, mode)
            staged.append((target, part))
        for target, content in zip(targets, contents.values(), strict=True):
            if target.is_stream:
                with _refused(target.path), ending.waiting():
                    opened = os.open(
                        target.path, os.O_WRONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
                    )
                    with os.fdopen(opened, "wb") as stream:
                        if hasattr(os, "O_NONBLOCK"):
                            os.set_blocking(opened, True)
                        stream.write(content)
        for target, part in staged:
            with _refused(target.path):
                part.replace(target.file)


def check_targets(paths: Iterable[AnyPath], inputs: Iterable[AnyPath] = ()) -> "tuple[_Target, ...]":
    """Refuse paths that cannot be written to; before long work, as nothing is opened yet.

    Raises `CommonlawError` if a path is in no folder that can be written to, is a folder, read-only, a hard link or of
    another kind that cannot be replaced, is an input, or is the same file as another path or the standard output.

    Parameters
    ----------
    paths
        Where something is to be written.
    inputs
        What is read for it, and must not be written over.
    """
    taken = {_identity(path): "it is read here too" for path in inputs}
    taken |= {_identity(number): "standard output or standard error goes there too" for number in (1, 2)}
    targets = []
    for path in paths:
        with _refused(path):
            target = _target(path)
        identity = _identity(path) or target.file
        if not target.is_stream:
            if identity in taken:
                raise CommonlawError("output-twice", path=path, reason=taken[identity])
            taken[identity] = f"it is the same file as {path}"
        targets.append(target)
    return tuple(targets)


def make_folder(folder: AnyPath, private: bool = False) -> None:
    """Make a folder, and those that it is in, where they are not there yet; a new private one for its owner alone.

    Raises `CommonlawError` if it cannot be made.
    """
    try:
        Path(folder).parent.mkdir(parents=True, exist_ok=True)
        Path(folder).mkdir(0o700 if private else 0o777, exist_ok=True)
    except (OSError, ValueError) as error:
        raise CommonlawError("folder-not-made", folder=str(folder), reason=_reason(error)) from error


@contextmanager
def one_writer(folder: Path) -> Iterator[None]:
    """Let one thread of one process at a time do what is within: read and write again what is in a folder.

    Raises `CommonlawError` if the folder cannot be locked, such as one that cannot be written.
    """
    from filelock import FileLock

    with ExitStack() as stack:
        with _refused(folder / ".lock"):
            stack.enter_context(FileLock(folder / ".lock", mode=0o600))
        yield


def remove_file(file: Path) -> None:
    """Remove a file, if it is there."""
    with _refused(file):
        file.unlink(missing_ok=True)


def mark_as_used(file: Path) -> None:
    """Have `remove_longest_unused` see a file as used just now."""
    with suppress(OSError):
        os.utime(file)


def remove_longest_unused(files: Iterable[Path], most: int) -> None:
    """Remove those of several files that were longest not written or used, until all take at most so many bytes."""
    known = []
    for file in files:
        with suppress(OSError):  # Another process may have removed it
            state = file.stat()
            known.append((state.st_mtime_ns, state.st_size, file))
    for _, size, file in sorted(known, reverse=True):
        most -= size
        if most < 0:
            with suppress(OSError):
                file.unlink()


@contextmanager
def private_file(name: str, content: bytes) -> Iterator[Path | None]:
    """Keep a file that nobody else can read, in a folder of its own, as long as what is within goes on.

    Yields its path; None where there is no place for temporary files.
    """
    with ExitStack() as stack:
        file = None
        with suppress(OSError):
            file = Path(stack.enter_context(TemporaryDirectory(prefix="commonlaw-"))) / name
            opened = os.open(file, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            with os.fdopen(opened, "wb") as writing:
                writing.write(content)
        yield file


@dataclass(frozen=True)
class _Target:
    """A path that can be written to: the file that it means once links are followed, and what is there."""

    path: AnyPath
    file: Path
    status: os.stat_result | None

    @property
    def is_stream(self) -> bool:
        """Whether what is there takes bytes and keeps no content that could be replaced."""
        return self.status is not None and (stat.S_ISCHR(self.status.st_mode) or stat.S_ISFIFO(self.status.st_mode))


def _target(path: AnyPath) -> _Target:
    """Return `path` as a target if a file can have it."""
    try:
        # Through the path as it is given: the system may refuse to follow a link that a stranger has put there
        status = Path(path).stat()
    except (FileNotFoundError, NotADirectoryError):
        status = None
    target = _Target(path, Path(os.path.realpath(path)), status)
    if reason := _obstacle(target):
        raise CommonlawError("output-refused", path=path, reason=reason)
    return target


def _obstacle(target: _Target) -> str | None:
    """Return why a target cannot be written to, and what to do."""
    folder, mode = target.file.parent, 0 if target.status is None else target.status.st_mode
    if target.is_stream:
        return None if os.access(target.path, os.W_OK) else "you may not write to it; choose another name"
    if target.status is None and not folder.is_dir():
        return f"there is no folder {str(Path(target.path).parent)!r}; create it or choose another"
    if stat.S_ISDIR(mode):
        return "it is a folder; name a file in it"
    if mode and not stat.S_ISREG(mode):
        return "it is neither a file nor a pipe; choose another name"
    if mode and not (mode & 0o222 and os.access(target.file, os.W_OK)):
        return "it is read-only; make it writable, or choose another name"
    if target.status is not None and target.status.st_nlink > 1:
        return "it is one file under several names (hard links); remove this name first, or choose another"
    if not os.access(folder, os.W_OK | os.X_OK):
        return f"you may not write to the folder {str(folder)!r}; choose one that you may write to"
    return None


def _identity(file: AnyPath | int) -> object:
    """Return what all paths of a file, or the number of a stream to it, have in common; None if it is not there."""
    try:
        status = os.fstat(file) if isinstance(file, int) else Path(file).stat()
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


@contextmanager
def _refused(path: AnyPath) -> Iterator[None]:
    """Turn what the system refuses into an error that names the path."""
    try:
        yield
    except CommonlawError:
        raise
    except (OSError, ValueError) as error:
        remedy = _REMEDIES.get(getattr(error, "errno", 0), "choose a folder that you may write to and that has space")
        raise CommonlawError("output-failed", path=path, reason=_reason(error), remedy=remedy) from error


def _reason(error: OSError | ValueError) -> str:
    return getattr(error, "strerror", None) or str(error)


@contextmanager
def _anchor(folder: Path) -> Iterator[Path]:
    """Keep a locked file in a folder: as long as it is locked, no other process removes files that begin like it.

    What processes that were killed have left there is removed first.
    """
    from filelock import FileLock

    with suppress(OSError):
        names = [path.name for path in folder.iterdir()]
        for orphan in filter(_ANCHOR.fullmatch, names):
            with suppress(OSError), FileLock(folder / orphan, blocking=False):  # Its process lives, or it has ended
                for name in names:
                    if name.startswith(f"{orphan}-"):
                        (folder / name).unlink(missing_ok=True)
                _remove(folder / orphan)
    anchor = folder / f".commonlaw-{uuid4().hex}"
    with ExitStack() as stack:
        stack.callback(_remove, anchor)  # Where the system removes no locked file
        with suppress(OSError):  # Not every file system has locks; nothing is cleared away there
            stack.enter_context(FileLock(anchor, mode=0o600))
        stack.callback(_remove, anchor)
        yield anchor


def _remove(file: Path) -> None:
    with suppress(PermissionError):
        file.unlink(missing_ok=True)


def _stage(part: Path, content: bytes, old: os.stat_result | None, mode: int) -> None:
    """Write a new file next to its target, with owner and permissions of the `old` one that it is to replace."""
    opened = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0), 0o600 if old else mode)
    with os.fdopen(opened, "wb") as file:
        file.write(content)
        file.flush()
        os.fsync(opened)
    if old is not None:
        mode = stat.S_IMODE(old.st_mode) & 0o777
        if sys.platform != "win32":
            try:
                os.chown(part, old.st_uid, old.st_gid)
            except PermissionError:
                try:
                    os.chown(part, -1, old.st_gid)
                except PermissionError:
                    mode &= ~0o070  # what its group might do, another must not
        part.chmod(mode)
