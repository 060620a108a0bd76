"""Files as tables, by what they hold and not by what they are called; workbooks are read by a separate process.

A sheet with a value in its last cell would take all memory.
"""

import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

from commonlaw.errors import CommonlawError, unknown
from commonlaw.runtime.packages import optional_import
from commonlaw.runtime.reading import BYTE_ORDER_MARK, check_size, read_file, unpacked
from commonlaw.runtime.shutdown import put_away_first
from commonlaw.trials import workbook_process
from commonlaw.trials.columns import Table, column_of, filled_table
from commonlaw.trials.export import parquet_table
from commonlaw.trials.text import text_table

_SECONDS = 30
"""What reading a workbook may take."""

Rows = list[tuple[int, list[Any]]]
"""Numbers, from the header's, and cells of rows that are not empty."""


def workbook_table(source: str, content: bytes, wanted: str | None) -> Table:
    """Return the table in one sheet of a workbook, or in all of them if they have the same header."""
    sheets = _sheets(source, content)
    if wanted is not None and wanted not in sheets:
        raise unknown("sheet", wanted, sheets).at(source)
    chosen = {name: rows for name, rows in sheets.items() if rows and wanted in (None, name)}
    if not chosen:
        raise CommonlawError("workbook-empty", where=source, part="sheet" if wanted else "workbook")
    headers = {name: " | ".join(str(cell).strip() for cell in rows[0][1]).rstrip(" |") for name, rows in chosen.items()}
    if len(set(headers.values())) > 1:
        shown = "; ".join(f"{name!r} ({header})" for name, header in headers.items())
        raise CommonlawError("workbook-sheets", where=source, sheets=shown)
    return _sheets_table(source, chosen)


def _sheets(source: str, content: bytes) -> dict[str, Rows]:
    """Return the rows of all sheets by name."""
    optional_import("python_calamine", "reading workbooks", "excel")
    # With -P Python does not import what lies in the working folder
    command = [sys.executable, "-P", str(Path(workbook_process.__file__))]
    try:
        with put_away_first() as ending, ending.waiting():
            done = subprocess.run(command, input=content, capture_output=True, timeout=_SECONDS)
    except subprocess.TimeoutExpired:
        raise CommonlawError("workbook-too-slow", source=source, seconds=_SECONDS) from None
    if done.returncode == workbook_process.NO_WORKBOOK:
        reason = done.stderr.decode(errors="replace").strip()
        raise CommonlawError("workbook-damaged", source=source, reason=reason)
    if done.returncode:
        raise CommonlawError("workbook-too-large", source=source, memory=workbook_process.MEMORY / 2**30)
    sheets: dict[str, Rows] = pickle.loads(done.stdout)
    for name, rows in sheets.items():
        check_size(f"{source}, sheet {name!r}", len(rows), len(rows[0][1]) if rows else 0)
    return sheets


def _sheets_table(source: str, sheets: dict[str, Rows]) -> Table:
    """Return the table of sheets below each other; several sheets without a column ``object`` are an object each."""
    many = len(sheets) > 1
    header = max((rows[0][1] for rows in sheets.values()), key=len)
    locations, numbers, cells, names = [], [], [], []
    for name, rows in sheets.items():
        for number, row in rows[1:]:
            cells.append([None if cell == "" else cell for cell in row] + [None] * (len(header) - len(row)))
            names.append(name)
            locations.append(f"row {number}" + f" of sheet {name!r}" * many)
            numbers.append(number)
    made = [column_of([row[i] for row in cells]) for i in range(len(header))]
    columns, loose = [column for column, _ in made], [i for i, (_, is_mixed) in enumerate(made) if is_mixed]
    titles = [str(cell) for cell in header]
    if many and "object" not in {title.strip().casefold() for title in titles}:
        titles, columns = [*titles, "object"], [*columns, column_of(names)[0]]
    return filled_table(source, titles, columns, loose=loose, locate=locations.__getitem__, number=numbers.__getitem__)


def read_table(path: str | os.PathLike[str], sheet: str | None = None) -> Table:
    """Return the table in a file: text with separators, Parquet, or a workbook, each of which may be compressed."""
    return table_in(Path(path).name, read_file(path), sheet)


def table_in(name: str, content: bytes, sheet: str | None = None) -> Table:
    """Return the table in the content of a file that has this name in messages."""
    content = unpacked(name, content)
    if not content.removeprefix(BYTE_ORDER_MARK).strip():
        raise CommonlawError("table-empty", name=name)
    if content.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        return workbook_table(name, content, sheet)
    if sheet is not None:
        raise CommonlawError("sheet-of-text", name=name, sheet=sheet)
    if content.startswith(b"PAR1"):
        return parquet_table(name, content)
    return text_table(name, content)


def name_of_table(path: str | os.PathLike[str]) -> str:
    """Return the name of a file without its suffix, and without that of a compressed one.

    >>> name_of_table("runs/cup.csv.gz"), name_of_table("cup.2.csv")
    ('cup', 'cup.2')
    """
    file = Path(path)
    return (Path(file.stem) if file.suffix.casefold() in (".gz", ".bz2", ".xz") else file).stem
