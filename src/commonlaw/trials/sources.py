"""Files read into a `Table`, by what they hold and not by what they are called."""

import os
from pathlib import Path

from commonlaw.errors import CommonlawError
from commonlaw.foreign import BYTE_ORDER_MARK, read_file
from commonlaw.trials.columns import Table
from commonlaw.trials.parquet import parquet_table
from commonlaw.trials.text import text_table
from commonlaw.trials.workbook import workbook_table


def read_table(path: str | os.PathLike[str], sheet: str | None = None) -> Table:
    """Return the table in a file: text with separators, Parquet, or a workbook."""
    file, content = Path(path), read_file(path)
    if not content.removeprefix(BYTE_ORDER_MARK).strip():
        raise CommonlawError(f"{file.name} is empty: give a file with a header and rows")
    if content.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        return workbook_table(file.name, content, sheet)
    if sheet is not None:
        raise CommonlawError(f"{file.name} is not a workbook and has no sheet {sheet!r}: leave the sheet out")
    if content.startswith(b"PAR1"):
        return parquet_table(file.name, content)
    return text_table(file.name, content)
