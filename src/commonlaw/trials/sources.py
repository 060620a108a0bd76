"""Files and frames read into a `Table`, by what they hold and not by what they are called."""

import csv
import io
import json
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.errors import CommonlawError, unknown
from commonlaw.trials.columns import Table
from commonlaw.trials.headers import split_headers

if TYPE_CHECKING:
    import pyarrow as pa

METADATA = b"commonlaw"  # the key under which a Parquet file keeps the roles of its columns

_INK = re.compile(rb"\S")
_DECIMAL_COMMA = re.compile(rb"\d,\d")
_MARK = b"\xef\xbb\xbf"  # the byte order mark of UTF-8, which Excel writes
_MISSING = ["", "NA", "N/A", "n/a", "NaN", "nan", "null", "NULL"]


def read_table(path: str | os.PathLike[str], sheet: str | None = None) -> Table:
    """Return the table in a file: text with separators, Parquet, or a workbook.

    Raises
    ------
    CommonlawError
        If the file is missing, empty, or cannot be read as a table.
    """
    file = Path(path)
    content = _content(file)
    if content.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        return _workbook(file.name, content, sheet)
    if sheet is not None:
        raise CommonlawError(f"{file.name} is not a workbook and has no sheet {sheet!r}: leave the sheet out")
    return _parquet(file.name, content) if content.startswith(b"PAR1") else _text(file.name, content)


def frame_table(frame: Any, source: str = "the frame") -> Table:
    """Return the table in a pandas, polars or pyarrow frame, or in any other that narwhals reads.

    Raises
    ------
    CommonlawError
        If it is not a frame, or a header is there twice.
    """
    import narwhals as nw
    import pyarrow as pa

    try:
        data = nw.from_native(frame)
        eager = data.collect() if isinstance(data, nw.LazyFrame) else data
        headers = [str(name) for name in eager.columns]
    except nw.exceptions.DuplicateError as error:
        text = " ".join(str(error).split())
        raise CommonlawError(f"{source}: {text}; give each column a name of its own") from None
    except TypeError:
        raise CommonlawError(
            f"cannot read a table from {type(frame).__name__}: give a pandas, polars or pyarrow frame"
        ) from None
    columns, loose = [], []
    for place, column in enumerate(eager.iter_columns()):
        try:
            columns.append(column.to_arrow())
        except (pa.ArrowInvalid, pa.ArrowTypeError):
            columns.append(_column(column.to_list())[0])
            loose.append(place)
    return _table(source, headers, columns, loose=loose)


def _content(file: Path) -> bytes:
    if file.is_dir():
        raise CommonlawError(f"{file} is a folder: name a file in it")
    try:
        content = file.read_bytes()
    except FileNotFoundError:
        raise CommonlawError(_no_file(file)) from None
    except OSError as error:
        raise CommonlawError(f"cannot read {file}: {error.strerror}; check the file and who may read it") from error
    if not _INK.search(content.removeprefix(_MARK)):
        raise CommonlawError(f"{file.name} is empty: give a file with a header and rows")
    return content


def _no_file(file: Path) -> str:
    folder = file.parent
    if not folder.is_dir():
        return f"there is no file {str(file)!r}, nor a folder {str(folder)!r}: check the path"
    names = {each.name.casefold(): each.name for each in folder.iterdir()}
    near = get_close_matches(file.name.casefold(), names, n=1)
    hint = f"did you mean {names[near[0]]!r}?" if near else "check the name"
    return f"there is no file {file.name!r} in {str(folder.absolute())!r}: {hint}"


def _table(
    source: str,
    headers: Sequence[str],
    columns: Sequence[Any],
    *,
    loose: Sequence[int] = (),
    place: Callable[[int], str] = lambda row: f"row {row + 1}",
) -> Table:
    """Return the table of these columns without the rows and the nameless columns in which nothing stands."""
    import pyarrow as pa
    import pyarrow.compute as pc

    plain = [_plain(column) for column in columns]
    used = [i for i, column in enumerate(plain) if headers[i].strip() or column.null_count < len(column)]
    names, units = split_headers(source, [headers[i] for i in used])
    blank = np.ones(len(plain[0]) if plain else 0, dtype=bool)
    for i in used:
        blank &= pc.is_null(plain[i]).to_numpy(zero_copy_only=False) if plain[i].null_count else False
    rows = np.flatnonzero(~blank)
    chosen = pa.array(rows) if len(rows) < len(blank) else None
    arrays = {name: plain[i] if chosen is None else plain[i].take(chosen) for name, i in zip(names, used, strict=True)}
    loosely = frozenset(name for name, i in zip(names, used, strict=True) if i in loose)
    return Table(source, arrays, units, lambda row: place(int(rows[row])), loosely)


def _plain(column: Any) -> "pa.Array":
    """Return a column as one Arrow array of numbers, dates, or ordinary strings."""
    import pyarrow as pa

    array = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    kind = array.type
    if pa.types.is_dictionary(kind):
        array, kind = array.dictionary_decode(), kind.value_type
    if pa.types.is_null(kind) or pa.types.is_large_string(kind) or pa.types.is_string_view(kind):
        return array.cast(pa.string())
    return array.cast(pa.int8()) if pa.types.is_boolean(kind) else array


def _parquet(source: str, content: bytes) -> Table:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        data = pq.read_table(pa.BufferReader(content))
    except (pa.ArrowException, OSError) as error:
        raise CommonlawError(f"{source} is a damaged Parquet file ({error}): write it again") from error
    table = _table(source, data.column_names, data.columns)
    kept = json.loads((data.schema.metadata or {}).get(METADATA, b"{}"))
    return replace(table, roles=kept.get("roles", {}), notes=tuple(kept.get("notes", ())))


def _workbook(source: str, content: bytes, wanted: str | None) -> Table:
    """Return the table in one sheet of a workbook, or in all of them if they have the same header."""
    from python_calamine import CalamineError, CalamineWorkbook

    try:
        book = CalamineWorkbook.from_filelike(io.BytesIO(content))
        sheets = {name: book.get_sheet_by_name(name).to_python() for name in book.sheet_names}
    except CalamineError as error:
        raise CommonlawError(f"{source} cannot be read as a workbook ({error}): save it as xlsx or CSV") from error
    if wanted is not None and wanted not in sheets:
        raise CommonlawError(f"{source}: {unknown('sheet', wanted, sheets)}")
    chosen = {name: rows for name, rows in sheets.items() if rows and wanted in (None, name)}
    if not chosen:
        raise CommonlawError(f"{source}: there is nothing in the {'sheet' if wanted else 'workbook'}: give it a table")
    headers = {name: " | ".join(str(cell).strip() for cell in rows[0]).rstrip(" |") for name, rows in chosen.items()}
    if len(set(headers.values())) > 1:
        shown = "; ".join(f"{name!r} ({header})" for name, header in headers.items())
        raise CommonlawError(f"{source}: the sheets have different headers, choose one with sheet=...: {shown}")
    return _sheets(source, chosen)


def _sheets(source: str, sheets: dict[str, list[list[Any]]]) -> Table:
    """Return the table of sheets below each other; several sheets without a column ``object`` are an object each."""
    many = len(sheets) > 1
    header = max((rows[0] for rows in sheets.values()), key=len)
    places, cells, names = [], [], []
    for name, rows in sheets.items():
        for number, row in enumerate(rows[1:], 1):
            full = [None if cell == "" else cell for cell in row] + [None] * (len(header) - len(row))
            if any(cell is not None for cell in full):
                cells.append(full)
                names.append(name)
                places.append(f"row {number}" + f" of sheet {name!r}" * many)
    columns, loose = [], []
    for i in range(len(header)):
        column, is_mixed = _column([row[i] for row in cells])
        columns.append(column)
        loose += [i] * is_mixed
    titles = [str(cell) for cell in header]
    if many and "object" not in {title.strip().casefold() for title in titles}:
        titles, columns = [*titles, "object"], [*columns, _column(names)[0]]
    return _table(source, titles, columns, loose=loose, place=places.__getitem__)


def _column(cells: Sequence[Any]) -> tuple["pa.Array", bool]:
    """Return cells as an Arrow array, and whether they were of several kinds and became text."""
    import pyarrow as pa

    try:
        return pa.array(cells, from_pandas=True), False
    except (pa.ArrowInvalid, pa.ArrowTypeError):
        return pa.array([None if cell is None or cell != cell else str(cell) for cell in cells], pa.string()), True


def _text(source: str, content: bytes) -> Table:
    """Return the table in text with separators, every cell as text."""
    import pyarrow as pa
    import pyarrow.csv as arrow_csv

    content = _decodable(source, content)
    unquoted = re.sub(rb'"[^"]*"', b"x", content[:100_000])
    first = next((line for line in unquoted.splitlines() if line.strip()), b"")
    delimiter = max("\t;,", key=lambda each: first.count(each.encode()))
    end, header = _rows(source, content, delimiter, stop=1)[0]
    start = 0
    for _ in range(end):
        start = content.find(b"\n", start) + 1 or len(content)
    if not _INK.search(content, start):
        return _table(source, header, [pa.nulls(0)] * len(header))
    names = [str(i) for i in range(len(header))]
    try:
        data = arrow_csv.read_csv(
            pa.BufferReader(memoryview(content)[start:]),
            arrow_csv.ReadOptions(column_names=names),
            arrow_csv.ParseOptions(delimiter=delimiter, newlines_in_values=b'"' in content),
            arrow_csv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.string()),
                null_values=_MISSING,
                strings_can_be_null=True,
                quoted_strings_can_be_null=False,
            ),
        )
    except pa.ArrowInvalid as error:
        raise CommonlawError(f"{source}: {_ragged(source, content, delimiter, len(header)) or error}") from None
    table = _table(
        source,
        header,
        data.columns,
        loose=range(len(header)),
        place=lambda row: f"row {row + 1} (line {_rows(source, content, delimiter)[row + 1][0]})",
    )
    if delimiter != ";" or not _DECIMAL_COMMA.search(content, start):
        return table
    note = f"{source}: semicolons separate the columns, and a comma is read as the decimal point"
    return replace(table, decimal_comma=True, notes=(note,))


def _decodable(source: str, content: bytes) -> bytes:
    """Return UTF-8 text without its byte order mark, lines ended by a line feed."""
    content = content.removeprefix(_MARK)
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise CommonlawError(f"{source} is text in UTF-16: save it as UTF-8")
    try:
        content.decode()
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise CommonlawError(
            f"{source}, line {line}: byte {content[error.start]:#x} is not UTF-8 text; save the file as CSV in UTF-8"
        ) from None
    if b"\0" in content:
        raise CommonlawError(f"{source} is neither text nor a workbook nor Parquet: save the table as CSV in UTF-8")
    return content if b"\n" in content else content.replace(b"\r", b"\n")


def _rows(source: str, content: bytes, delimiter: str, stop: int | None = None) -> list[tuple[int, list[str]]]:
    """Return the rows that are not empty, with the numbers of their last lines; the first is the header."""
    reader = csv.reader(io.TextIOWrapper(io.BytesIO(content), "utf-8", newline=""), delimiter=delimiter)
    found: list[tuple[int, list[str]]] = []
    try:
        for row in reader:
            if row:
                found.append((reader.line_num, row))
            if len(found) == stop:
                break
    except csv.Error as error:
        raise CommonlawError(
            f"{source}, line {reader.line_num}: {error}; check the quotation marks up to there"
        ) from None
    return found


def _ragged(source: str, content: bytes, delimiter: str, width: int) -> str | None:
    """Return the message about the first row that has more or fewer cells than the header."""
    for i, (line, row) in enumerate(_rows(source, content, delimiter)):
        if len(row) != width:
            return (
                f"row {i} (line {line}) has {len(row)} cells and the header {width}; give every row a cell per column"
            )
    return None
