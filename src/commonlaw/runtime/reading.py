"""Reading files of strangers within stated limits."""

import io
import os
import re
import stat
import zlib
from collections.abc import Iterator
from difflib import get_close_matches
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np

from commonlaw.errors import CommonlawError

LARGEST_FILE = 2**30
"""Bytes of a file that is read whole."""
MOST_ROWS = 10_000_000
MOST_COLUMNS = 10_000
MOST_CELLS = 30_000_000
"""Rows, columns and cells of a table that is held in memory."""
LARGEST_JSON = 2**26
"""Bytes of a law, and of what a Parquet file says of its columns."""
DEEPEST = 32
"""Lists and objects within each other in JSON."""

BYTE_ORDER_MARK = b"\xef\xbb\xbf"
"""What Excel writes before UTF-8."""

T = TypeVar("T")

_GZIP, _BZIP2, _XZ = b"\x1f\x8b", b"BZh", b"\xfd7zXZ\0"
"""What compressed files begin with."""
_PART = 2**20
"""Bytes that are unpacked at a time."""
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x1a\x1c-\x1f]")
"""Characters that no text of an instrument has."""
_STRING = re.compile(rb'"[^"\\]*(?:\\.[^"\\]*)*"', re.DOTALL)
_NO_BRACKETS = bytes({*range(256)} - {*b"[]{}"})


def checked_file(path: str | os.PathLike[str], largest: float = LARGEST_FILE) -> Path:
    """Return the path of a regular file of at most so many bytes.

    Raises `CommonlawError` if there is none: folders, devices and pipes, which may have no end, are refused too.
    """
    file = Path(path)
    try:
        found = file.stat()
    except FileNotFoundError:
        raise _no_file(file) from None
    except (OSError, ValueError) as error:
        raise _unreadable(file, error) from None
    if stat.S_ISDIR(found.st_mode):
        raise CommonlawError("file-is-folder", file=file)
    if not stat.S_ISREG(found.st_mode):
        raise CommonlawError("file-is-device", file=file)
    if found.st_size > largest:
        raise CommonlawError("file-too-large", file=file, bytes=found.st_size, limit=largest)
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

    Raises `CommonlawError` if it is damaged, or unpacks to more than `LARGEST_FILE`, or takes more memory for that.
    """
    import lzma

    if not content.startswith((_GZIP, _BZIP2, _XZ)):
        return content
    try:
        size = 0
        for part in _parts(content):  # Counted first, as a small file may unpack to more than the memory holds
            size += len(part)
            if size > LARGEST_FILE:
                raise CommonlawError("unpacked-too-large", source=source, limit=LARGEST_FILE)
        return b"".join(_parts(content))
    except (OSError, EOFError, lzma.LZMAError, zlib.error) as error:
        if "Memory usage limit" in str(error):
            raise CommonlawError("dictionary-too-large", source=source, limit=LARGEST_FILE) from None
        raise CommonlawError("not-unpacked", source=source, error=error) from None


def _parts(content: bytes) -> Iterator[bytes]:
    """Yield what compressed bytes hold, part by part; streams may follow each other."""
    import bz2
    import gzip
    import lzma

    if not content.startswith(_XZ):
        packed = io.BytesIO(content)
        with gzip.GzipFile(fileobj=packed) if content.startswith(_GZIP) else bz2.BZ2File(packed) as stream:
            yield from iter(lambda: stream.read(_PART), b"")
        return
    while content:
        decompressor = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=LARGEST_FILE)
        while not decompressor.eof:
            yield decompressor.decompress(content, _PART)
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


def read_json(content: bytes, kind: type[T]) -> T:
    """Return the value of a type that msgspec knows from JSON.

    Raises `CommonlawError` if it is no JSON, of another type, larger than `LARGEST_JSON` or nested deeper than
    `DEEPEST`; the message says where.
    """
    import msgspec

    if len(content) > LARGEST_JSON:
        raise CommonlawError("json-too-large", bytes=len(content), limit=LARGEST_JSON)
    check_text("JSON", content)
    brackets = np.frombuffer(_STRING.sub(b"", content).translate(None, _NO_BRACKETS), dtype=np.uint8)
    depth = int(np.cumsum(np.where(np.isin(brackets, list(b"[{")), 1, -1), dtype=np.int32).max(initial=0))
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
    if not folder.is_dir():
        return CommonlawError("folder-missing", file=str(file), folder=str(folder))
    try:
        where = str(folder.absolute())
        names = {each.name.casefold(): each.name for each in islice(folder.iterdir(), 10_000)}
    except OSError:  # The folder may not be listed, or was deleted
        where, names = str(folder), {}
    near = get_close_matches(file.name.casefold(), names, n=1)
    hint = f"did you mean {names[near[0]]!r}?" if near else "check the name"
    return CommonlawError("file-missing", file=file.name, folder=where, hint=hint)
