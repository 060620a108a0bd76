"""Blocks of rows below each other, each of an object: behind blank rows, titles, comments, or the header again.

A block begins where the time goes back, so that blank rows and remarks within a record do not end it.
"""

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from commonlaw.text import counted, shown
from commonlaw.trials.columns import Table
from commonlaw.trials.layouts.grid import Grid, labels_of, table_of
from commonlaw.trials.reading import READ_AS, WrittenReading
from commonlaw.trials.recognition import is_time_header
from commonlaw.trials.rows import Layout, Row, is_value, layout_of

BLOCK = "block"
"""The column that names blocks, if these are objects."""
_FIRST_ROWS = 100
"""Among which the header stands."""
_CLOCK = re.compile(r"(?:(\d+):)?(\d+):(\d\d(?:[.,]\d+)?)")


@dataclass(frozen=True)
class _Block:
    """Rows of measurements, and the rows that stand above them."""

    above: Sequence[Row]
    body: Sequence[Row]

    def title(self, no_titles: Sequence[Row]) -> str:
        """Return the last row above that is neither blank nor among some others."""
        return next((row.text for row in reversed(self.above) if not row.is_blank and row not in no_titles), "")


def blocks(grid: Grid) -> Table | None:
    """Return the table of blocks of rows with the same columns, None if there is one block without the header again."""
    first_rows = [row for row in grid.rows[:_FIRST_ROWS] if _is_full(row) and not any(map(is_value, row.cells))]
    begins = {row.cells[0] for row in first_rows}
    words = Counter(_cells(row) for row in grid.rows if row.cells and row.cells[0] in begins)
    heads = {_cells(row) for row in first_rows if words[_cells(row)] > 1}
    begins = {row.cells[0] for row in first_rows if _cells(row) in heads}
    apart = [not _is_full(row) or (row.cells[0] in begins and _cells(row) in heads) for row in grid.rows]
    if sum(here and not there for here, there in pairwise([True, *apart])) < 2:
        return None  # All that stands apart is above or below the table
    plain = [row for row in grid.rows if not row.is_comment]
    layout = layout_of(plain, [row for row in grid.rows if row.is_comment])
    parts = _parts(grid.rows, layout, heads)
    is_again = any(_cells(row) in heads for part in parts[1:] for row in part.above)
    made = _joined(parts, layout)
    if layout.key is None or (len(made) < 2 and not is_again):
        return None
    headers = [row for row in grid.rows if _cells(row) in heads]
    titles = [block.title(headers) for block in made]
    if layout.header_line and not _are_names(titles):
        headers += [row for row in grid.rows if row.is_comment and [*row.cells] == [*layout.header]]
        titles = [block.title(headers) for block in made]
    elif layout.header_line:  # The comment above the first block is its title
        layout = layout_of(plain, [])
    is_named = _are_names(titles)
    rows = [row for block in made for row in block.body]
    columns = {title: [row.value(j) for row in rows] for j, title in enumerate(layout.header)}
    if len(columns) < len(layout.header):
        return None
    names = titles if is_named else [str(number + 1) for number in range(len(made))]
    labels = {} if len(made) < 2 or _is_labelled(columns, made) else labels_of(names)
    if "trial" not in labels:
        labels = {BLOCK: names} if labels else {}
    if not labels and not is_again and len(made) > 1 and not any(map(_is_title, grid.rows)):
        return None
    sizes = [len(block.body) for block in made]
    columns |= {role: np.repeat(np.array(column, dtype=object), sizes).tolist() for role, column in labels.items()}
    numbers = [row.line for row in rows]
    table = table_of(grid.source, columns, lambda row: f"{grid.line} {numbers[row]}", numbers.__getitem__)
    used = {row.line for row in (*rows, *headers)}
    remarks = [repr(row.text) for row in grid.rows if row.line not in used and not row.is_blank]
    remarks = [text for text in remarks if not is_named or text[1:-1] not in titles]
    facts = (f"left out around the blocks: {shown(remarks)}",) if remarks else ()
    note = f"{READ_AS}{counted(len(made), 'block')} of rows"
    if BLOCK in labels:
        note += f", an object each: {', '.join(names[:3])}{', ...' if len(names) > 3 else ''}"
        note += "; with `restarts='trials'` they are trials of one"
    roles: WrittenReading = {"object": next(iter(labels))} if labels else {}
    return replace(table, facts=facts, roles=roles, notes=(note,))


def _cells(row: Row) -> tuple[str, ...]:
    return () if row.is_comment else tuple(map(str.strip, row.cells))


def _is_full(row: Row) -> bool:
    """Say whether a row may be one of a table: it has at least two cells that are not empty."""
    if row.is_comment or len(row.cells) < 2:
        return False
    return bool(row.cells[0].strip() and row.cells[1].strip()) or sum(bool(cell.strip()) for cell in row.cells) > 1


def _is_title(row: Row) -> bool:
    return not (row.is_comment or row.is_blank or _is_full(row))


def _is_labelled(columns: Mapping[str, Sequence[object]], made: Sequence[_Block]) -> bool:
    """Say whether a column names blocks already: it changes between them alone, or is called ``object``."""
    ends = np.cumsum([len(block.body) for block in made])
    rows = np.repeat(np.arange(len(made)), np.diff(ends, prepend=0))
    for name, cells in columns.items():
        firsts = [cells[int(end) - 1] for end in ends]
        if name.casefold() == "object" or (
            len({*map(str, firsts)}) > 1 and all(cell == firsts[block] for cell, block in zip(cells, rows, strict=True))
        ):
            return True
    return False


def _are_names(titles: Sequence[str]) -> bool:
    return all(titles) and len({*titles}) == len(titles)


def _parts(rows: Sequence[Row], layout: Layout, heads: set[tuple[str, ...]]) -> list[_Block]:
    """Return the rows of measurements that follow each other, with what stands above them."""
    result, above, body = list[_Block](), list[Row](), list[Row]()
    for row in rows:
        is_full = row.line >= layout.first_line and _is_full(row) and _cells(row) not in heads
        if is_full and len(row.cells) == len(layout.header) and not layout.is_below(row.cells):
            body.append(row)
        else:
            if body:
                result.append(_Block(above, body))
                above, body = [], []
            above.append(row)
    return [*result, _Block(above, body)] if body else result


def _joined(parts: Sequence[_Block], layout: Layout) -> list[_Block]:
    """Return the parts, joined where the time goes on from one to the next."""
    times = [j for j, title in enumerate(layout.header) if is_time_header(title)]
    key = times[0] if times else layout.key or 0
    result = [*parts[:1]]
    for part in parts[1:]:
        before, after = (_number(row.cells[key]) for row in (result[-1].body[-1], part.body[0]))
        if not after <= before:
            result[-1] = _Block(result[-1].above, [*result[-1].body, *part.body])
        else:
            result.append(part)
    return result


def _number(text: str) -> float:
    """Return a number, or a time of day in seconds; NaN for others, such as dates, which do not go back."""
    if match := _CLOCK.fullmatch(text.strip()):
        return 3600 * float(match[1] or 0) + 60 * float(match[2]) + float(match[3].replace(",", "."))
    try:
        return float(text.replace(",", "."))
    except ValueError:
        return np.nan
