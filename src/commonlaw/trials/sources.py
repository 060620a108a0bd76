"""Files read into a `Table`, by what they hold and not by what they are called."""

import os
import re
from difflib import get_close_matches
from pathlib import Path

from commonlaw.errors import CommonlawError
from commonlaw.trials.columns import Table
from commonlaw.trials.parquet import parquet_table
from commonlaw.trials.text import BYTE_ORDER_MARK, text_table
from commonlaw.trials.workbook import workbook_table

_INK = re.compile(rb"\S")


def read_table(path: str | os.PathLike[str], sheet: str | None = None) -> Table:
    """Return the table in a file: text with separators, Parquet, or a workbook.

    Raises
    ------
    CommonlawError
        If the file is missing, empty, or cannot be read as a table.
    """
    file = Path(path)
    content = _content(file)
    if content.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        return workbook_table(file.name, content, sheet)
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
    if not _INK.search(content.removeprefix(BYTE_ORDER_MARK)):
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
