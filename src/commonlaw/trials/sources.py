"""Files read into a `Table`, by what they hold and not by what they are called."""

import io
import os
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from commonlaw.errors import CommonlawError, unknown
from commonlaw.extras import optional_import
from commonlaw.trials.columns import Table, column_of, filled_table
from commonlaw.trials.parquet import parquet_table
from commonlaw.trials.text import BYTE_ORDER_MARK, text_table


def read_table(path: str | os.PathLike[str], sheet: str | None = None) -> Table:
    """Return the table in a file: text with separators, Parquet, or a workbook."""
    file = Path(path)
    content = _content(file)
    if content.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        return _workbook_table(file.name, content, sheet)
    if sheet is not None:
        raise CommonlawError(f"{file.name} is not a workbook and has no sheet {sheet!r}: leave the sheet out")
    if content.startswith(b"PAR1"):
        return parquet_table(file.name, content)
    return text_table(file.name, content)


def _content(file: Path) -> bytes:
    if file.is_dir():
        raise CommonlawError(f"{file} is a folder: name a file in it")
    try:
        content = file.read_bytes()
    except FileNotFoundError:
        raise CommonlawError(_no_file(file)) from None
    except OSError as error:
        raise CommonlawError(f"cannot read {file}: {error.strerror}; check the file and who may read it") from error
    if not content.removeprefix(BYTE_ORDER_MARK).strip():
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


def _workbook_table(source: str, content: bytes, wanted: str | None) -> Table:
    """Return the table in one sheet of a workbook, or in all of them if they have the same header."""
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
    return _sheets_table(source, chosen)


def _sheets_table(source: str, sheets: dict[str, list[list[Any]]]) -> Table:
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
    made = [column_of([row[i] for row in cells]) for i in range(len(header))]
    columns, loose = [column for column, _ in made], [i for i, (_, is_mixed) in enumerate(made) if is_mixed]
    titles = [str(cell) for cell in header]
    if many and "object" not in {title.strip().casefold() for title in titles}:
        titles, columns = [*titles, "object"], [*columns, column_of(names)[0]]
    return filled_table(source, titles, columns, loose=loose, locate=locations.__getitem__)
