"""Tables in text: separators, encodings, comments, and rows below the table."""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Bools, Indices
from commonlaw.errors import CommonlawError
from commonlaw.runtime.files import MOST_CELLS, MOST_COLUMNS, MOST_ROWS, check_size, decoded
from commonlaw.text import counted, shown
from commonlaw.trials.cells import show_commas
from commonlaw.trials.columns import Column, Table, filled_table
from commonlaw.trials.headers import split_header
from commonlaw.trials.layouts.cells import table_in_cells
from commonlaw.trials.layouts.grid import Grid
from commonlaw.trials.rows import Layout, Row, is_value, layout_of, usual_width

if TYPE_CHECKING:
    import pandas as pd

_MISSING = ["NA", "N/A", "n/a", "NaN", "nan", "null", "NULL"]
"""Words that are no text, unless they are in quotes."""
_QUOTED_MISSING = re.compile(r'(?<![^,;|\t\n])"(NA|N/A|n/a|NaN|nan|null|NULL)"(?![^,;\t\n])')
_COMMENT = re.compile(r'"[^"]*"|^[ \t]*(?:#|%|//)[^\n]*', re.MULTILINE)
"""A comment line, or a cell in quotes, in which such a line would be text."""
_COMMENT_LINE, _WRITTEN_LINE = re.compile(r"\n[ \t]*(?:#|%|//)"), re.compile(r"\S[^\n]*")
_COMMENT_MARK = re.compile(r"\s*(?:[#%]+|//)\s*")
_BLANKS = re.compile(r'"[^"\n]*"|(?<![ \t])[ \t]++(?=[^\s\[(])')
_WIDE_BLANKS = re.compile(r'"[^"\n]*"|(?<! )(?: {2,}+| *+\t *+)(?=[^\s\[(])')
"""What separates columns that are aligned by blanks; a unit in brackets belongs to the name before it.

Each run of blanks is tried from its beginning only, so that a long one takes no time in proportion to its square.
"""
_MOST_COMMENTS = 1_000_000


def text_table(source: str, content: bytes) -> Table:
    """Return the table in text: columns of plain numbers as such, and of others every cell as text."""
    import pandas as pd

    text, encoding = decoded(source, content)
    facts = [f"text in {encoding}"] if encoding else []
    text, comments = _without_comments(source, text)
    separators = _separators(text)
    text, delimiter = separators.applied(text), separators.mark
    sample = _sample(text)
    mark = re.escape(delimiter)
    quoted = re.compile(rf'(?:^|{mark})"(?:[^"]|"")*"(?={mark}|$)')
    written = sample.split("\n")
    every = [*_read(source, sample, delimiter)]
    rows = [
        replace(row, is_quoted=not quoted.sub("", "\n".join(written[row.first_line - 1 : row.line])))
        for row in every
        if row.line not in comments
    ]
    remarks = [
        Row(line, line, separators.applied(_COMMENT_MARK.sub("", comment, count=1)).split(delimiter), is_comment=True)
        for line, comment in comments.items()
    ]
    by_line = {row.line: row for row in remarks}
    table = table_in_cells(Grid(source, [by_line.get(row.line, row) for row in every]))
    if table is not None and len(sample) < len(text):
        table = table_in_cells(Grid(source, [by_line.get(row.line, row) for row in _read(source, text, delimiter)]))
    if table is not None:
        return replace(table, facts=(*facts, *table.facts))
    layout = layout_of(rows, remarks)
    header, before = layout.header, layout.first_line - 1
    facts += [*layout.facts]
    if others := [repr(row.text) for row in remarks if row.line != layout.header_line and row.text]:
        facts.append(f"comments left out: {shown(others)}")
    _, *below = text.split("\n", before)[before - 1 :] if before else ("", text)
    body = below[0] if below else ""
    del content, text, below
    body, footer = _without_footer(source, body, delimiter, layout, before)
    facts += footer
    if not body.strip():
        return filled_table(source, header, [np.empty(0, dtype=object)] * len(header))
    if any(f'"{word}"' in body for word in _MISSING):
        # In quotes these words are text: a blank behind them, which is stripped from texts, tells them apart
        body = _QUOTED_MISSING.sub(r'"\1 "', body)
    cells = _Cells.of(source, body, delimiter, len(header), before)
    del body
    (columns, commas), counts = cells.columns(), Counter[tuple[int, str]]()
    for i, column in enumerate(columns):
        if column.dtype.kind == "O":
            is_word = pd.Series(column, dtype=object).isin(_MISSING).to_numpy()
            if is_word.any():
                counts.update((i, word) for word in column[is_word])
                columns[i] = np.where(is_word, np.nan, column)
    lines, kept = cells.lines, cells.rows
    table = filled_table(
        source,
        header,
        columns,
        loose=[i for i, column in enumerate(columns) if column.dtype.kind == "O"],
        locate=lambda row: f"row {row + 1} (line {lines[kept[row]]})",
        number=lambda row: int(lines[kept[row]]),
        written=cells.texts,
        commas=commas,
    )
    facts += [
        f"read as missing in {split_header(header[i])[0]}: {word!r} in {counted(count, 'cell')}"
        for (i, word), count in counts.items()
    ]
    return replace(table, facts=tuple(facts))


@dataclass(frozen=True, eq=False)
class _Cells:
    """The cells of a table in text below its header, in rows of one width.

    Parameters
    ----------
    content
        The text in UTF-8.
    lines
        The number in the file of the last line of each row, 0 of an empty row.
    begins
        Which columns have a cell that begins otherwise than its number is written, such as ``007`` or ``+5``, or is in
        quotation marks, shape (width,).
    """

    source: str
    content: bytes
    delimiter: str
    lines: Indices
    begins: Bools

    @classmethod
    def of(cls, source: str, body: str, delimiter: str, width: int, before: int) -> "_Cells":
        """Return the cells in a text that begins `before` lines into the file; refused if rows differ in width."""
        content = (body if body.endswith("\n") else f"{body}\n").encode()
        if (known := _lines_and_begins(source, content, delimiter, width, before)) is not None:
            return cls(source, content, delimiter, *known)
        lines, count, most = [], 0, min(MOST_ROWS, MOST_CELLS // max(width, 1))
        for row in _read(source, body, delimiter, before):
            count += bool(row.cells)
            if count > most:
                check_size(source, count, width)
            lines.append(row.line if row.cells else 0)
            if row.cells and len(row.cells) != width:
                raise CommonlawError(
                    "row-length", where=source, row=count, line=row.line, cells=len(row.cells), width=width
                )
        return cls(source, content, delimiter, np.array(lines), np.ones(width, dtype=np.bool_))

    @property
    def rows(self) -> Indices:
        """The indices of the rows that are not empty."""
        return np.flatnonzero(self.lines)

    def columns(self) -> tuple[list[Column], set[int]]:
        """Return the columns, and the indices of those whose numbers have a decimal comma.

        They are numbers where all cells are plain ones, as Python reads them or with a comma, or empty; else text.
        """
        width, rows = len(self.begins), self.rows
        first = self._read(range(width), object, max(100_000 // width, 1)).to_numpy(dtype=object)
        texts = {i for i in range(width) if not _are_plain(first[:, i])}
        commas = {i for i in texts if show_commas([cell.strip() for cell in first[:, i] if isinstance(cell, str)])}
        texts, columns, marks = texts - commas, dict[int, Column](), ((".", {*range(width)} - commas), (",", commas))
        for mark, indices in marks:
            if indices:
                frame = self._read(sorted(indices), dict.fromkeys(texts & indices, object), decimal=mark)
                columns |= {i: frame[i].to_numpy() for i in indices}
        again = [i for i, column in columns.items() if column.dtype.kind not in "if" and i not in texts]
        again += [i for i, column in columns.items() if column.dtype.kind == "i" and self.begins[i]]
        again += [i for i in commas if columns[i].dtype.kind == "f" and np.isinf(columns[i]).any()]  # Perhaps a word
        for i, column in columns.items():
            if column.dtype.kind == "f" and np.isnan(column).all():
                columns[i] = column.astype(object)
        columns |= dict(zip(again, self._texts(again), strict=True))
        columns = {i: column if len(rows) == len(column) else column[rows] for i, column in columns.items()}
        return [columns[i] for i in range(width)], commas.difference(again)

    def texts(self, indices: Sequence[int]) -> list[Column]:
        """Return columns, by their indices, as they are written, without the empty rows."""
        return [column[self.rows] for column in self._texts(indices)]

    def _texts(self, indices: Sequence[int]) -> list[Column]:
        if not indices:
            return []
        frame = self._read(indices, object)
        return [frame[i].to_numpy(dtype=object) for i in indices]

    def _read(self, indices: Sequence[int], kinds: Any, rows: int | None = None, decimal: str = ".") -> "pd.DataFrame":
        import pandas as pd

        options: dict[str, Any] = {
            "sep": self.delimiter,
            "header": None,
            "names": range(len(self.begins)),
            "usecols": indices,
            "index_col": False,
            "dtype": kinds,
            "nrows": rows,
            "decimal": decimal,
            "keep_default_na": False,
            "na_values": [""],
            "skip_blank_lines": False,
            "low_memory": False,
            "engine": "c",
        }
        if tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1):  # Older ones round the last digit unless asked
            options["float_precision"] = "round_trip"
        try:
            frame: pd.DataFrame = pd.read_csv(io.BytesIO(self.content), **options)
        except pd.errors.ParserError as error:
            raise CommonlawError("quotation-marks", where=self.source, error=error) from None
        return frame


def _are_plain(cells: Column) -> bool:
    """Say whether cells may be numbers, as far as they are not empty."""
    try:
        cells.astype(np.float64)
    except ValueError:
        return False
    return True


_BLOCK = 2**24
"""Bytes of text that are looked through at a time."""


def _lines_and_begins(
    source: str, content: bytes, delimiter: str, width: int, before: int
) -> tuple[Indices, Bools] | None:
    """Return `lines` and `begins` of `_Cells`, by counting separators; None where only reading the rows shows them.

    That is where rows differ in width, or a quotation mark is not at the begin or the end of a cell in one line.
    """
    lines, begins, start, rows, stop = list[Indices](), np.zeros(width, dtype=np.bool_), 0, 0, before
    while start < len(content):
        end = content.find(b"\n", start + _BLOCK) + 1 or len(content)
        known = _blank_lines_and_begins(np.frombuffer(content, np.uint8, end - start, start), delimiter, width)
        if known is None:
            return None
        is_blank, is_odd = known
        rows += int(np.sum(~is_blank))
        check_size(source, rows, width)
        lines.append(np.where(is_blank, 0, stop + 1 + np.arange(len(is_blank))))
        begins |= is_odd
        start, stop = end, stop + len(is_blank)
    return np.concatenate(lines), begins


def _blank_lines_and_begins(codes: NDArray[np.uint8], delimiter: str, width: int) -> tuple[Bools, Bools] | None:
    """Return which lines of a block of text are empty, and `begins` of `_Cells`; see `_lines_and_begins`."""
    mark, quote, end = map(ord, (delimiter, '"', "\n"))
    is_quote = codes == quote
    quotes, cell_ends = np.flatnonzero(is_quote), np.flatnonzero((codes == mark) | (codes == end))
    if len(quotes):
        opening, closing = quotes[::2], quotes[1::2]
        if len(opening) > len(closing):
            return None
        doubled = opening[1:] == closing[:-1] + 1
        outside = (codes[opening - 1], codes[closing + 1])  # What comes before the first character is the last line end
        at_begin, at_end = ((character == mark) | (character == end) for character in outside)
        if not ((at_begin[1:] | doubled).all() and (at_end[:-1] | doubled).all() and at_begin[0] and at_end[-1]):
            return None
        is_quoted = np.cumsum(is_quote, dtype=np.uint8)[cell_ends] % 2 == 1
        if (codes[cell_ends[is_quoted]] == end).any():
            return None
        cell_ends = cell_ends[~is_quoted]
    last = np.flatnonzero(codes[cell_ends] == end)  # Of each line, the index of its last cell among all cells
    is_blank = np.diff(cell_ends[last], prepend=-1) == 1
    is_regular = is_blank | (np.diff(last, prepend=-1) == width)
    if not is_regular.all() or np.diff(cell_ends, prepend=-1).max() > csv.field_size_limit():
        return None
    begin = np.append(0, cell_ends[:-1] + 1)
    first, second = codes[begin], codes[np.minimum(begin + 1, len(codes) - 1)]
    is_zero = (first == ord("0")) & (second >= ord("0")) & (second <= ord("9"))
    is_odd = is_zero | (first == ord("+")) | ((first == ord("-")) & (second == ord("0"))) | (first == quote)
    odd = np.flatnonzero(is_odd)
    row = np.searchsorted(last, odd)
    return is_blank, np.bincount(odd - np.append(0, last[:-1] + 1)[row], minlength=width)[:width] > 0


def _without_comments(source: str, text: str) -> tuple[str, dict[int, str]]:
    """Return a text with empty lines in place of comments, and these by the numbers of their lines.

    Where they are more than half of what is written, they are no comments.
    """
    comments, line, begin = dict[int, str](), 1, 0
    for match in _COMMENT.finditer(text) if _COMMENT.match(text) or _COMMENT_LINE.search(text) else ():
        if match[0].startswith('"'):
            continue
        line, begin = line + text.count("\n", begin, match.start()), match.start()
        comments[line] = match[0].strip()
        if len(comments) > _MOST_COMMENTS:
            raise CommonlawError(
                "table-too-large", source=source, count=len(comments), cells="comments", limit=_MOST_COMMENTS
            )
    if not comments or 2 * len(comments) > sum(1 for _ in _WRITTEN_LINE.finditer(text)):
        return text, {}
    return _COMMENT.sub(lambda match: match[0] if match[0].startswith('"') else "", text), comments


@dataclass(frozen=True)
class _Separators:
    """What separates the cells of a row: a mark; or, as they are written, blanks."""

    mark: str
    blanks: re.Pattern[str] | None = None

    def applied(self, text: str) -> str:
        """Return a text with the mark in place of blanks that separate cells."""
        if self.blanks is None:
            return text
        stripped = "\n".join(line.strip(" \t") for line in text.split("\n"))
        return self.blanks.sub(lambda match: match[0] if match[0].startswith('"') else self.mark, stripped)


def _separators(text: str) -> _Separators:
    """Return what leaves most rows of one width, then most values in them: tabs, semicolons, commas, bars or blanks."""
    ways = [*map(_Separators, "\t;,|"), _Separators("\t", _BLANKS), _Separators("\t", _WIDE_BLANKS)]
    sample, counts = _sample(text), list[tuple[int, int]]()
    for way in ways:
        try:
            rows = list(_read("", way.applied(sample), way.mark))
        except CommonlawError:
            rows = []
        width = usual_width(rows)
        wide = [row.cells for row in rows if len(row.cells) >= width]
        table = [cells for cells in wide if not any(map(str.strip, cells[width:]))]  # Blanks may stand behind a header
        counts.append((len(table), sum(map(is_value, chain.from_iterable(table)))))
    best = max(counts)
    return ways[counts.index(best)] if best[0] else _Separators(",")


def _sample(text: str, length: int = 200_000) -> str:
    """Return the lines at the beginning of a file by which its layout is found."""
    end = text.rfind("\n", 0, length)
    end = end if end >= 0 else text.find("\n", length)
    return text if len(text) <= length or end < 0 else text[:end]


def _read(source: str, text: str, delimiter: str, before: int = 0) -> Iterator[Row]:
    """Yield the rows in a text that begins `before` lines into the file."""
    reader, line = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter), before
    try:
        for cells in reader:
            if len(cells) > MOST_COLUMNS:
                check_size(source, 1, len(cells))
            yield Row(line + 1, before + reader.line_num, cells)
            line = before + reader.line_num
    except csv.Error as error:
        begin, line = line + 1, before + reader.line_num
        if "field limit" in str(error) and line == begin:  # On several lines a quotation mark is missing
            raise CommonlawError("cell-too-long", source=source, line=line, limit=csv.field_size_limit()) from None
        raise CommonlawError("quotation-marks-in-line", source=source, line=line, error=error) from None


def _without_footer(source: str, body: str, delimiter: str, layout: Layout, before: int) -> tuple[str, list[str]]:
    """Return the rows of the table without those at their end that are no measurements, and what these were."""
    # Among the last 100 lines
    lines, texts = body.rstrip("\n").rsplit("\n", 100), list[str]()
    above = before + lines[0].count("\n")
    while len(lines) > 1 and not lines[-1].count('"') % 2:
        line = above + len(lines) - 1
        cells = next((row.cells for row in _read(source, lines[-1], delimiter, line)), [])
        if not layout.is_below(cells):
            break
        texts.insert(0, " ".join(cells).strip()[:80])
        lines.pop()
    if not any(texts):
        return body, []
    return "\n".join(lines), [f"left out below the table: {shown([repr(text) for text in texts if text])}"]
