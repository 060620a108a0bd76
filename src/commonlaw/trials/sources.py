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
    return table_in(Path(path).name, read_file(path), sheet)


def table_in(name: str, content: bytes, sheet: str | None = None) -> Table:
    """Return the table in the content of a file that has this name in messages."""
    if not content.removeprefix(BYTE_ORDER_MARK).strip():
        raise CommonlawError(f"{name} is empty: give a file with a header and rows")
    if content.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        return workbook_table(name, content, sheet)
    if sheet is not None:
        raise CommonlawError(f"{name} is not a workbook and has no sheet {sheet!r}: leave the sheet out")
    if content.startswith(b"PAR1"):
        return parquet_table(name, content)
    return text_table(name, content)
