"""Rows of cells: which of them are a table, its header and its units, whether they stood in text or in a sheet."""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, islice, pairwise, zip_longest

from commonlaw.text import shown
from commonlaw.trials.cells import is_missing
from commonlaw.trials.dates import elapsed_in_names
from commonlaw.trials.headers import join_header, known_unit, split_header
from commonlaw.trials.recognition import is_time_header

_BEYOND = "[<>~\N{LESS-THAN OR EQUAL TO}\N{GREATER-THAN OR EQUAL TO}]? ?"
_NUMBER = rf"{_BEYOND}[+\-\N{{MINUS SIGN}}]?(\d[\d.,' \N{{NO-BREAK SPACE}}]*+|[.,]\d+)([eE][+-]?\d+)?"
_DATE = r"[A-Z][a-z]{2,8}\.? \d+,? \d{4}.*|\d{1,4}[-./ ][^\W_]+[-./ ]\d+.*|\d+:\d\d.*|\d{8}T\d{4,6}Z?"
_VALUE = re.compile(rf"{_NUMBER}(\s*[^\W\d_]\D*|\s*[%°]\D*)?|{_DATE}")
"""A number, with a unit or without, a date or a time, in whatever way it is written."""
_SUMMARY = re.compile(
    r"(mean|average|avg|median|total|sum|min|max|minimum|maximum|range|count|std|sd|stdev|mittelwert|summe)\b.*",
    re.IGNORECASE,
)
"""How rows begin that summarize the columns above them."""


@dataclass(frozen=True)
class Row:
    """Cells, and the numbers of the first and of the last line on which they stand."""

    first_line: int
    line: int
    cells: Sequence[str]
    is_quoted: bool = False
    """Whether every cell is in quotation marks, or there is none."""
    values: Sequence[object] = ()
    """The cells as a sheet holds them; none of a row of text."""
    is_comment: bool = False

    @property
    def is_blank(self) -> bool:
        """Whether nothing stands in it."""
        return not any(cell.strip() for cell in self.cells)

    @property
    def text(self) -> str:
        """The row in a message."""
        return " ".join(cell.strip() for cell in self.cells if cell.strip())[:80]

    def value(self, column: int) -> object:
        """Return a cell as a sheet holds it, or its text; nothing behind the last one."""
        cells = self.values or self.cells
        return cells[column] if column < len(cells) else ""


@dataclass(frozen=True)
class Layout:
    """Where the table begins."""

    header: Sequence[str]
    first_line: int
    """Number of the line below the header, and below a row of units."""
    key: int | None
    """The first column whose cells are numbers, dates or times; None if there is none."""
    facts: Sequence[str] = ()
    header_line: int = 0
    """Of a header that is a comment."""

    def is_below(self, cells: Sequence[str]) -> bool:
        """Say whether a row is no measurement: it has no number, or begins with the word for a mean or the like."""
        present = [cell.strip() for cell in cells if cell.strip()]
        if not present or self.key is None:
            return not present
        if is_value(present[0]) or is_missing(present[0]):
            return False
        return not any(map(is_value, present)) or (self.key == 0 and _SUMMARY.fullmatch(present[0]) is not None)


def is_value(cell: str) -> bool:
    """Say whether a cell is a number, a date or a time rather than a word."""
    return _VALUE.fullmatch(cell.strip()) is not None


def usual_width(rows: Sequence[Row]) -> int:
    """Return the number of cells of the rows of the table; zero if no row has several."""
    counts: dict[int, list[int]] = {}
    for row in rows:
        if len(row.cells) > 1 and not row.is_blank:
            values = sum(map(is_value, row.cells))
            count = counts.setdefault(len(row.cells), [0, 0, 0])
            for i, amount in enumerate((2 * values > len(row.cells), 1, values)):
                count[i] += amount
    return max(counts, key=counts.__getitem__, default=0)


def layout_of(rows: Sequence[Row], comments: Sequence[Row]) -> Layout:
    """Return where the table begins in rows, of which comments are taken out.

    The header is the row of words, or a comment, with a cell for each column above the first row of values. A row of
    units may follow it.
    """
    width = usual_width(rows) or 1
    full = [len(row.cells) == width and not row.is_blank for row in rows]
    table = [row for row, is_full in zip(rows, full, strict=True) if is_full]
    if not table:
        return Layout((), 1, None)
    columns = list(zip(*(row.cells for row in table), strict=True))
    is_empty = [not any(cell.strip() for cell in column) for column in columns]
    key = next((j for j, column in enumerate(columns) if _holds_values(column)), None)
    first = next((i for i in range(len(rows)) if full[i] and _is_measured(rows, i, key, columns)), None)
    if key is None or first is None:
        start = full.index(True)
        return Layout(rows[start].cells, rows[start].line + 1, None, _above(rows[:start]))
    top = first
    while top and rows[top - 1].is_blank:
        top -= 1
    bottom = top
    while top and not rows[top - 1].is_blank:
        cells = rows[top - 1].cells
        if any(map(str.strip, cells[width:])) or not all(is_empty[len(cells) :]):
            break  # A header has a cell for each column in which anything stands
        top -= 1
    block = rows[top:bottom]
    if not block:
        return _without_header(rows, first, key, width, columns, comments)
    filled = [sum(bool(cell.strip()) for cell in row.cells) for row in block]
    candidates = [i for i, count in enumerate(filled) if count == max(filled)]
    words = [i for i in candidates if not any(map(is_value, block[i].cells[1:] if width > 2 else block[i].cells))]
    named = [i for i in words if not (i and are_units(block[i].cells))] or candidates
    chosen = named[-1] if width == 2 else named[0]
    header = [*block[chosen].cells[:width], *[""] * (width - len(block[chosen].cells))]
    groups = _with_groups(header, block[chosen - 1].cells) if chosen else header
    facts = _above(rows[: top + chosen - (groups != header)])
    header = groups
    units = block[chosen + 1].cells if chosen + 1 < len(block) and are_units(block[chosen + 1].cells) else ()
    if units:
        header = headers_with_units(header, units)
        facts.append(f"line {block[chosen + 1].line} holds units")
    return Layout(_with_numbered_times(header), block[chosen + bool(units)].line + 1, key, facts)


def _with_groups(header: Sequence[str], above: Sequence[str]) -> list[str]:
    """Return headers with the names of their groups, each written above the first of its columns.

    Numbers of replicates stand behind them, and quantities that are the same in several groups behind a colon.
    """
    groups: Iterator[str] = accumulate(map(str.strip, above), lambda group, cell: cell or group)
    named = [*zip_longest(map(str.strip, header), islice(groups, len(header)), fillvalue="")]
    counts = Counter(name for name, _ in named if name)
    titles = [
        f"{group} {name}" if group and name.isdigit() else f"{group}: {name}" if group and counts[name] > 1 else name
        for name, group in named
    ]
    is_grouped = any(count > 1 for count in counts.values()) and len({*titles} - {""}) == sum(map(bool, titles))
    return titles if is_grouped else [*header]


def _with_numbered_times(header: Sequence[str]) -> list[str]:
    """Return headers with numbers behind the first one if it is a time again and again, and all others differ."""
    others = [title for title in header if title != header[0]]
    if len(others) in (0, len(header) - 1) or len({*others}) < len(others) or not is_time_header(header[0]):
        return [*header]
    name, unit = split_header(header[0])
    numbers = accumulate(int(title == header[0]) for title in header)
    return [
        join_header(f"{name} {number}", unit) if title == header[0] else title
        for number, title in zip(numbers, header, strict=True)
    ]


def _holds_values(column: Sequence[str]) -> bool:
    present = [cell for cell in column if cell.strip() and not is_missing(cell)]
    return 2 * sum(map(is_value, present)) > len(present)


def _is_measured(rows: Sequence[Row], i: int, key: int | None, columns: Sequence[Sequence[str]]) -> bool:
    """Say whether a row is below the header: a value stands in the first column of values."""
    cells = rows[i].cells
    if key is None or not any(map(is_value, cells)) or not (is_value(cells[key]) or is_missing(cells[key] or "-")):
        return False
    if rows[i].is_quoted and i + 1 < len(rows) and not rows[i + 1].is_quoted:
        return False
    words = [j for j, cell in enumerate(cells) if cell.strip() and not is_value(cell)]
    if not words or not all(row.is_blank for row in rows[:i]) or any(columns[j].count(cells[j]) > 1 for j in words):
        return True
    values = [cell for cell in cells if is_value(cell)]
    numbers = [*elapsed_in_names(values)[1].values()]  # 0 h, 24 h, ... above columns of these times
    try:
        numbers = numbers if len(numbers) == len(values) else [*map(float, values)]
    except ValueError:
        return True
    return len(numbers) < 2 or any(there <= here for here, there in pairwise(numbers))


def are_units(cells: Sequence[str]) -> bool:
    """Say whether cells are units, or empty, as those of a row below a header may be."""
    texts = [cell.strip() for cell in cells]
    units = [text for text in texts if text not in ("", "-", "1", "[-]", "(-)", "[]", "()")]
    return bool(units) and all(known_unit(_bare_unit(text)) is not None for text in units)


def headers_with_units(header: Sequence[str], units: Sequence[str]) -> list[str]:
    """Return headers with the units in a row below them, where they have none."""
    result = list(header)
    for j, (name, unit) in enumerate(zip(header, map(str.strip, units), strict=False)):
        bare = _bare_unit(unit) if unit else ""
        if bare not in ("", "-", "1") and not split_header(name)[1]:
            result[j] = f"{name.strip()} [{bare}]"
    return result


def _bare_unit(text: str) -> str:
    return text[1:-1].strip() if text[0] + text[-1] in ("[]", "()", "{}", "<>") else text


def _without_header(
    rows: Sequence[Row], first: int, key: int, width: int, columns: Sequence[Sequence[str]], comments: Sequence[Row]
) -> Layout:
    """Return the layout of a table whose header is a comment, or fits no columns, or is not there."""
    above = [row for row in comments if row.line < rows[first].first_line]
    if above and len(above[-1].cells) == width and not all(map(is_value, above[-1].cells)):
        fact = f"the header is the comment in line {above[-1].line}"
        return Layout(above[-1].cells, rows[first].first_line, key, [*_above(rows[:first]), fact], above[-1].line)
    if first and len(rows[first - 1].cells) > 1 and not any(map(is_value, rows[first - 1].cells)):
        cells = rows[first - 1].cells
        # R writes no header above the names of rows
        is_named = len(cells) == width - 1 and not _holds_values(columns[0])
        return Layout([""] * is_named + [*cells], rows[first - 1].line + 1, key, _above(rows[: first - 1]))
    words = [j for j in range(width) if not _holds_values(columns[j])]
    values = [j for j in range(width) if j not in words and j != key]
    names = {j: "object" if j == words[0] else f"text{i}" for i, j in enumerate(words, 1)} | {key: "t"}
    names |= {j: f"x{i}" if len(values) > 1 else "x" for i, j in enumerate(values, 1)}
    header = [names[j] for j in range(width)]
    fact = f"there is no header, and the columns are called {', '.join(header)}"
    return Layout(header, rows[first].first_line, key, [*_above(rows[:first]), fact])


def _above(rows: Sequence[Row]) -> list[str]:
    """Return what stood above the table."""
    texts = [repr(row.text) for row in rows if not row.is_blank]
    return [f"left out above the header: {shown(texts)}"] if texts else []
