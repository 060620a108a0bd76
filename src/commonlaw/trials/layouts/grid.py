"""Cells of a text or a sheet before it is decided which of them are a table, and tables of some of them."""

import re
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from commonlaw.text import shown
from commonlaw.trials.columns import Column, Table, column_of, filled_table
from commonlaw.trials.reading import WrittenReading
from commonlaw.trials.recognition import TRIAL, is_called
from commonlaw.trials.rows import Row

_PLAIN = re.compile(r"[+-]?(?:0|[1-9]\d*|(?=\.\d))(?:\.\d*)?(?:[eE][+-]?\d+)?", re.ASCII)
"""A number as Python writes it, and no label such as 007."""


@dataclass(frozen=True)
class Grid:
    """All rows of a text or of a sheet in their order, comments and blank rows among them.

    Parameters
    ----------
    source
        The name of the file in messages.
    line
        What a row is called there: the line of a text, the row of a sheet.
    """

    source: str
    rows: Sequence[Row]
    line: str = "line"

    def left_out(self, used: Sequence[Row]) -> tuple[str, ...]:
        """Return the fact that names the rows that are none of those used, if there are such."""
        lines = {row.line for row in used}
        texts = [repr(row.text) for row in self.rows if row.line not in lines and not row.is_blank]
        return (f"left out around the table: {shown(texts)}",) if texts else ()


def table_of(
    source: str,
    columns: Mapping[str, Sequence[object]],
    locate: Callable[[int], str],
    number: Callable[[int], int],
) -> Table:
    """Return the table of columns of cells by their headers: texts, which may be numbers, or what a sheet holds."""
    made = [_column(cells) for cells in columns.values()]
    loose = [i for i, (_, is_loose) in enumerate(made) if is_loose]
    return filled_table(source, [*columns], [column for column, _ in made], loose=loose, locate=locate, number=number)


SORTED: WrittenReading = {"restarts": "sort"}
"""Of layouts whose rows are of the trial of their labels, in whatever order."""


class Sample(NamedTuple):
    """Cells by their headers, what they are of, and where the first of them stands."""

    key: Hashable
    cells: Mapping[str, object]
    place: str
    number: int


def merged(source: str, samples: Iterable[Sample]) -> Table:
    """Return the table with a row for all samples of a key, such as quantities that were measured at the same time."""
    rows, first = dict[Hashable, dict[str, object]](), list[Sample]()
    for sample in samples:
        if sample.key not in rows:
            first.append(sample)
        rows.setdefault(sample.key, {}).update(sample.cells)
    headers = dict.fromkeys(header for row in rows.values() for header in row)
    columns = {header: [row.get(header, "") for row in rows.values()] for header in headers}
    return table_of(source, columns, lambda row: first[row].place, lambda row: first[row].number)


def labels_of(names: Sequence[str]) -> dict[str, list[str]]:
    """Return the objects that files or blocks of these names are of, and labels of trials where several are of one.

    >>> labels_of(["golf_1", "golf_2", "tennis_1"])
    {'object': ['golf', 'golf', 'tennis'], 'trial': ['1', '2', '1']}
    >>> labels_of(["run 1", "run 2"]), labels_of(["cup 1", "cup 2"])
    ({'object': ['run', 'run'], 'trial': ['1', '2']}, {'object': ['cup 1', 'cup 2']})
    """
    numbered = [re.fullmatch(r"(.+?)[\s_.-]+(\d+)", name) for name in names]
    if all(numbered):
        stems, labels = zip(*(match.groups() for match in numbered if match), strict=True)
        if 1 < len(set(stems)) < len(names) or (len(set(stems)) == 1 and is_called(stems[0], TRIAL)):
            return {"object": list(stems), "trial": list(labels)}
    return {"object": list(names)}


def _column(cells: Sequence[object]) -> tuple[Column, bool]:
    """Return cells as a column, and whether its text may be meant as numbers."""
    present = [(cell.strip() or None) if isinstance(cell, str) else cell for cell in cells]
    texts = [cell for cell in present if isinstance(cell, str)]
    if all(map(_PLAIN.fullmatch, texts)):
        return column_of([_number(cell) if isinstance(cell, str) else cell for cell in present])
    return column_of(present)[0], True


def _number(text: str) -> float:
    return int(text) if text.lstrip("+-").isdigit() else float(text)
