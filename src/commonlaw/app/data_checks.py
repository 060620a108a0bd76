"""What data checks find, beside the rows of the table in which it stands."""

from collections.abc import Mapping, Sequence
from typing import Any

from commonlaw.app.words import text_in_page
from commonlaw.trials.check import Finding, Report
from commonlaw.trials.columns import Codes, Table

_CASES, _AROUND = 12, 3
"""Cases of the same kind that are shown, and rows before and after the one that is meant."""

_Labels = tuple[str | None, str | None]
"""Of an object and its trial."""


def finding_kinds(check: Report, table: Table, row_indices: Sequence[Codes]) -> list[dict[str, Any]]:
    """Return the findings: for each kind its text, how many cases there are, and the first of them with their rows.

    Parameters
    ----------
    check
        What data checks found in the trials of a table.
    table
        Its cells.
    row_indices
        Of each trial the indices of the rows of its samples.
    """
    rows: dict[_Labels, Codes] = {
        (each.object, each.trial): own for each, own in zip(check.trials, row_indices, strict=True)
    }
    return [
        {"text": text_in_page(text), "count": len(same), "cases": [_case(each, table, rows) for each in same[:_CASES]]}
        for text, same in check.kinds().items()
    ]


def _case(found: Finding, table: Table, rows: Mapping[_Labels, Codes]) -> dict[str, Any]:
    """Return a finding with rows of its trial, each the number that it has in the file and its cells.

    Which of the rows and columns is meant comes with it; neither if it is the trial as a whole.
    """
    own = rows.get((found.object, found.trial))
    case: dict[str, Any] = {"text": text_in_page(found.text), "rows": [], "row": None, "column": None}
    if own is None:
        return case
    sample, columns = found.sample or 0, table.columns.values()
    first = max(0, sample - _AROUND)
    shown = own[first : sample + _AROUND + 1].tolist()
    case["rows"] = [[table.number(row), *(cell_text(column[row]) for column in columns)] for row in shown]
    if found.sample is not None:
        case |= {"row": sample - first, "column": found.column}
    return case


def cell_text(cell: Any) -> str:
    """Return what is shown of a cell; nothing of an empty one."""
    return "" if cell is None or cell != cell else str(cell)
