"""Tables in the sheets of a workbook."""

import io
from typing import Any

from commonlaw.errors import CommonlawError, unknown
from commonlaw.extras import optional_import
from commonlaw.trials.columns import Table, column_of, filled_table


def workbook_table(source: str, content: bytes, wanted: str | None) -> Table:
    """Return the table in one sheet of a workbook, or in all of them if they have the same header.

    Raises
    ------
    CommonlawError
        If python-calamine is not installed, the workbook is damaged, or it does not say which sheet to read.
    """
    calamine = optional_import("python_calamine", "reading workbooks", "excel")
    try:
        book = calamine.CalamineWorkbook.from_filelike(io.BytesIO(content))
        sheets = {name: book.get_sheet_by_name(name).to_python() for name in book.sheet_names}
    except calamine.CalamineError as error:
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
    locations, cells, names = [], [], []
    for name, rows in sheets.items():
        for number, row in enumerate(rows[1:], 1):
            full = [None if cell == "" else cell for cell in row] + [None] * (len(header) - len(row))
            if any(cell is not None for cell in full):
                cells.append(full)
                names.append(name)
                locations.append(f"row {number}" + f" of sheet {name!r}" * many)
    columns, loose = [], []
    for i in range(len(header)):
        column, is_mixed = column_of([row[i] for row in cells])
        columns.append(column)
        loose += [i] * is_mixed
    titles = [str(cell) for cell in header]
    if many and "object" not in {title.strip().casefold() for title in titles}:
        titles, columns = [*titles, "object"], [*columns, column_of(names)[0]]
    return filled_table(source, titles, columns, loose=loose, locate=locations.__getitem__)
