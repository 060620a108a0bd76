"""Files read into a `Table`, by what they hold and not by what they are called."""

import os
from pathlib import Path

from commonlaw.errors import CommonlawError
from commonlaw.runtime.reading import BYTE_ORDER_MARK, read_file, unpacked
from commonlaw.trials.columns import Table
from commonlaw.trials.parquet import parquet_table
from commonlaw.trials.text import text_table
from commonlaw.trials.workbook import workbook_table


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
