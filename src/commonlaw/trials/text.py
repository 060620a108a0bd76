"""Tables in text with separators: commas, semicolons or tabs."""

import csv
import io
import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Indices
from commonlaw.errors import CommonlawError
from commonlaw.foreign import BYTE_ORDER_MARK, check_size, check_text
from commonlaw.trials.columns import Table, filled_table

if TYPE_CHECKING:
    from _csv import Reader

_DECIMAL_COMMA = re.compile(rb'(?<![^;\n"]) *[+-]?\d*,\d+(?:[eE][+-]?\d+)? *(?![^;\n"])')
"""A cell that is a number with one."""
_MISSING = ["", "NA", "N/A", "n/a", "NaN", "nan", "null", "NULL"]
_QUOTED_MISSING = re.compile(rb'(?<![^,;\t\n])"(NA|N/A|n/a|NaN|nan|null|NULL)"(?![^,;\t\n])')


def text_table(source: str, content: bytes) -> Table:
    """Return the table in text with separators, every cell as text."""
    import pandas as pd

    content = _decodable(source, content)
    unquoted = re.sub(rb'"[^"]*"', b"x", content[:100_000])
    first = next((line for line in unquoted.splitlines() if line.strip()), b"")
    delimiter = max("\t;,", key=lambda each: first.count(each.encode()))
    header, before = _header(source, content, delimiter)
    check_size(source, content.count(b"\n") + 1, len(header))
    body = content.split(b"\n", before)[before] if content.count(b"\n") >= before else b""
    if not body.strip():
        return filled_table(source, header, [np.empty(0, dtype=object)] * len(header))
    lines = _line_numbers(source, body, delimiter, len(header), before)
    if b'"' in body:
        # In quotes these words are text: a blank behind them, which is stripped from texts, tells them apart
        body = _QUOTED_MISSING.sub(rb'"\1 "', body)
    try:
        frame = pd.read_csv(
            io.BytesIO(body),
            sep=delimiter,
            header=None,
            names=range(len(header)),
            index_col=False,
            dtype=object,
            keep_default_na=False,
            na_values=_MISSING,
            skip_blank_lines=False,
            engine="c",
        )
    except pd.errors.ParserError as error:
        raise CommonlawError(f"{source}: {error}; check the quotation marks") from None
    kept = np.flatnonzero(lines)
    table = filled_table(
        source,
        header,
        [frame[i].to_numpy()[kept] for i in range(len(header))],
        loose=range(len(header)),
        locate=lambda row: f"row {row + 1} (line {lines[kept[row]]})",
        number=lambda row: int(lines[kept[row]]),
    )
    if delimiter != ";" or not _DECIMAL_COMMA.search(body):
        return table
    note = f"{source}: semicolons separate the columns, and a comma is read as the decimal point"
    return replace(table, decimal_comma=True, notes=(note,))


def _decodable(source: str, content: bytes) -> bytes:
    """Return UTF-8 text without its byte order mark, lines ended by a line feed."""
    content = content.removeprefix(BYTE_ORDER_MARK)
    check_text(source, content)
    if b"\0" in content:
        raise CommonlawError(f"{source} is neither text nor a workbook nor Parquet: save the table as CSV in UTF-8")
    return content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")


def _header(source: str, content: bytes, delimiter: str) -> tuple[list[str], int]:
    """Return the first row that is not empty, and the number of its last line."""
    reader = _reader(content, delimiter)
    try:
        header = next((row for row in reader if row), [])
    except csv.Error as error:
        raise _unreadable(source, reader.line_num, error) from None
    return header, reader.line_num


def _line_numbers(source: str, body: bytes, delimiter: str, width: int, before: int) -> Indices:
    """Return the number of the last line of each row, `before` lines into the file, and 0 for an empty row.

    A row that has more or fewer cells than the header is refused.
    """
    # Counting separators is much faster than reading rows, and says enough where all is in order
    if b'"' not in body and (count := _full_rows(body, delimiter, width)):
        return before + 1 + np.arange(count)
    reader = _reader(body, delimiter)
    lines, rows = [], 0
    try:
        for row in reader:
            rows += bool(row)
            lines.append(before + reader.line_num if row else 0)
            if row and len(row) != width:
                raise CommonlawError(
                    f"{source}: row {rows} (line {lines[-1]}) has {len(row)} cells and the header {width}; give every "
                    "row a cell per column"
                )
    except csv.Error as error:
        raise _unreadable(source, before + reader.line_num, error) from None
    return np.array(lines)


def _full_rows(body: bytes, delimiter: str, width: int) -> int:
    """Return the number of rows if each has a cell for each column, else zero."""
    text = np.frombuffer(body, dtype=np.uint8)
    ends = np.append(np.flatnonzero(text == ord("\n")), [len(text)] * (not body.endswith(b"\n")))
    separators = np.searchsorted(np.flatnonzero(text == ord(delimiter)), ends)
    return len(ends) if np.all(np.diff(separators, prepend=0) == width - 1) else 0


def _reader(content: bytes, delimiter: str) -> "Reader":
    return csv.reader(io.TextIOWrapper(io.BytesIO(content), "utf-8", newline=""), delimiter=delimiter)


def _unreadable(source: str, line: int, error: csv.Error) -> CommonlawError:
    return CommonlawError(f"{source}, line {line}: {error}; check the quotation marks up to there")
