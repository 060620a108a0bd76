"""Tables in text: what separates their cells, where their header is, and what stands around them."""

import csv
import io
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from commonlaw.array_types import Indices
from commonlaw.errors import CommonlawError
from commonlaw.runtime.reading import check_size, decoded
from commonlaw.text import counted, shown
from commonlaw.trials.columns import Table, filled_table
from commonlaw.trials.headers import split_header
from commonlaw.trials.layout import Layout, Row, is_value, layout_of, usual_width

_SAMPLE = 200_000
"""Characters at the beginning of a file by which its layout is found."""
_FOOTER = 100
"""Lines at the end of a file among which a footer is looked for."""
_MISSING = ["NA", "N/A", "n/a", "NaN", "nan", "null", "NULL"]
"""Words that are no text, unless they are in quotes."""
_QUOTED_MISSING = re.compile(r'(?<![^,;\t\n])"(NA|N/A|n/a|NaN|nan|null|NULL)"(?![^,;\t\n])')
_COMMENT = re.compile(r'"[^"]*"|^[ \t]*(?:#|%|//)[^\n]*', re.MULTILINE)
"""A comment line, or a cell in quotes, in which such a line would be text."""
_COMMENT_MARK = re.compile(r"\s*(?:[#%]+|//)\s*")
_BLANKS = re.compile(r'"[^"\n]*"|[ \t]+(?=[^\s\[(])')
_WIDE_BLANKS = re.compile(r'"[^"\n]*"|(?: {2,}| *\t *)(?=[^\s\[(])')
"""What separates columns that are aligned by blanks; a unit in brackets belongs to the name before it."""


def text_table(source: str, content: bytes) -> Table:
    """Return the table in text, every cell as text."""
    import pandas as pd

    text, encoding = decoded(source, content)
    facts = [f"text in {encoding}"] if encoding else []
    text, comments = _without_comments(text)
    separators = _separators(text)
    text, delimiter = separators.applied(text), separators.mark
    sample = _sample(text)
    quoted = re.compile(rf'(?:^|{delimiter})"(?:[^"]|"")*"(?={delimiter}|$)')
    written = sample.split("\n")
    rows = [
        replace(row, is_quoted=not quoted.sub("", "\n".join(written[row.first_line - 1 : row.line])))
        for row in _read(source, sample, delimiter)
        if row.line not in comments
    ]
    remarks = [
        Row(line, line, separators.applied(_COMMENT_MARK.sub("", comment, count=1)).split(delimiter))
        for line, comment in comments.items()
    ]
    layout = layout_of(rows, remarks)
    header, before = layout.header, layout.first_line - 1
    facts += [*layout.facts]
    if others := [repr(row.text) for row in remarks if row.line != layout.header_line and row.text]:
        facts.append(f"comments left out: {shown(others)}")
    check_size(source, text.count("\n") + 1, len(header))
    body = text.split("\n", before)[before] if text.count("\n") >= before else ""
    body, footer = _without_footer(body, delimiter, layout)
    facts += footer
    if not body.strip():
        return filled_table(source, header, [np.empty(0, dtype=object)] * len(header))
    lines = _line_numbers(source, body, delimiter, len(header), before)
    if '"' in body:
        # In quotes these words are text: a blank behind them, which is stripped from texts, tells them apart
        body = _QUOTED_MISSING.sub(r'"\1 "', body)
    try:
        frame = pd.read_csv(
            io.StringIO(body),
            sep=delimiter,
            header=None,
            names=range(len(header)),
            index_col=False,
            dtype=object,
            keep_default_na=False,
            na_values=[""],
            skip_blank_lines=False,
            engine="c",
        )
    except pd.errors.ParserError as error:
        raise CommonlawError("quotation-marks", where=source, error=error) from None
    kept = np.flatnonzero(lines)
    words, counts = frame.where(frame.isin(_MISSING)), Counter[tuple[int, str]]()
    for i in range(len(header)):
        counts.update((i, word) for word in words[i].dropna())
    cells = frame.mask(words.notna())
    table = filled_table(
        source,
        header,
        [cells[i].to_numpy()[kept] for i in range(len(header))],
        loose=range(len(header)),
        locate=lambda row: f"row {row + 1} (line {lines[kept[row]]})",
        number=lambda row: int(lines[kept[row]]),
    )
    facts += [
        f"read as missing in {split_header(header[i])[0]}: {word!r} in {counted(count, 'cell')}"
        for (i, word), count in counts.items()
    ]
    return replace(table, facts=tuple(facts))


def _without_comments(text: str) -> tuple[str, dict[int, str]]:
    """Return the text with comment lines empty, and these by the numbers of the lines.

    Where most lines begin as comments do, objects are called so.
    """
    comments = [found for found in _COMMENT.finditer(text) if not found[0].startswith('"')]
    if not comments or 2 * len(comments) > sum(1 for line in text.split("\n") if line.strip()):
        return text, {}
    numbers = {text.count("\n", 0, found.start()) + 1: found[0].strip() for found in comments}
    return _COMMENT.sub(lambda found: found[0] if found[0].startswith('"') else "", text), numbers


@dataclass(frozen=True)
class _Separators:
    """What separates the cells of a row: a mark; or, as they are written, blanks."""

    mark: str
    blanks: re.Pattern[str] | None = None

    def applied(self, text: str) -> str:
        """Return a text with the mark in place of blanks that separate cells."""
        if self.blanks is None:
            return text
        stripped = re.sub(r"^[ \t]+|[ \t]+$", "", text, flags=re.MULTILINE)
        return self.blanks.sub(lambda found: found[0] if found[0].startswith('"') else self.mark, stripped)


def _separators(text: str) -> _Separators:
    """Return what leaves most rows of one width, and then most values in them: tabs, semicolons, commas, or blanks."""
    ways = [*map(_Separators, "\t;,"), _Separators("\t", _BLANKS), _Separators("\t", _WIDE_BLANKS)]
    sample = _sample(text)
    counts = [_rows_and_values(each.applied(sample), each.mark) for each in ways]
    best = max(counts)
    return ways[counts.index(best)] if best[0] else _Separators(",")


def _sample(text: str) -> str:
    end = text.rfind("\n", 0, _SAMPLE)
    return text if len(text) <= _SAMPLE or end < 0 else text[:end]


def _rows_and_values(sample: str, delimiter: str) -> tuple[int, int]:
    """Return how many rows of the usual width a sample has by a delimiter, and how many values stand in them."""
    try:
        rows = list(_read("", sample, delimiter))
    except CommonlawError:
        return 0, 0
    width = usual_width(rows)
    table = [row.cells for row in rows if len(row.cells) == width]
    return len(table), sum(map(is_value, chain.from_iterable(table)))


def _read(source: str, text: str, delimiter: str, before: int = 0) -> Iterator[Row]:
    """Yield the rows in a text that begins `before` lines into the file."""
    reader, line = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter), before
    try:
        for cells in reader:
            yield Row(line + 1, before + reader.line_num, cells)
            line = before + reader.line_num
    except csv.Error as error:
        line = before + reader.line_num
        raise CommonlawError("quotation-marks-in-line", source=source, line=line, error=error) from None


def _without_footer(body: str, delimiter: str, layout: Layout) -> tuple[str, list[str]]:
    """Return the rows of the table without those at their end that are no measurements, and what these were."""
    lines = body.rstrip("\n").rsplit("\n", _FOOTER)
    footer: list[str] = []
    while len(lines) > 1 and not lines[-1].count('"') % 2 and layout.is_below(_cells(lines[-1], delimiter)):
        footer.insert(0, lines.pop())
    texts = [text for line in footer if (text := " ".join(_cells(line, delimiter)).strip())]
    return (
        ("\n".join(lines), [f"left out below the table: {shown([repr(text[:80]) for text in texts])}"])
        if texts
        else (body, [])
    )


def _cells(line: str, delimiter: str) -> list[str]:
    return next(csv.reader([line], delimiter=delimiter), [])


def _line_numbers(source: str, body: str, delimiter: str, width: int, before: int) -> Indices:
    """Return the number of the last line of each row, `before` lines into the file, and 0 for an empty row.

    A row that has more or fewer cells than the header is refused.
    """
    # Counting separators is much faster than reading rows, and says enough where all is in order
    if '"' not in body and (count := _full_rows(body.encode(), delimiter, width)):
        return before + 1 + np.arange(count)
    lines, count = [], 0
    for row in _read(source, body, delimiter, before):
        count += bool(row.cells)
        lines.append(row.line if row.cells else 0)
        if row.cells and len(row.cells) != width:
            raise CommonlawError(
                "row-length", where=source, row=count, line=row.line, cells=len(row.cells), width=width
            )
    return np.array(lines)


def _full_rows(body: bytes, delimiter: str, width: int) -> int:
    """Return the number of rows if each has a cell for each column, else zero."""
    text = np.frombuffer(body, dtype=np.uint8)
    ends = np.append(np.flatnonzero(text == ord("\n")), [len(text)] * (not body.endswith(b"\n")))
    separators = np.searchsorted(np.flatnonzero(text == ord(delimiter)), ends)
    return len(ends) if np.all(np.diff(separators, prepend=0) == width - 1) else 0
