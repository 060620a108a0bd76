"""The process that reads a workbook: bytes in, the rows of its sheets out; it imports nothing of the package.

Of each sheet these are the rows that are not empty, with their numbers from the first of them on.

Its memory is limited where the system knows such limits, and its time by its caller.
"""

import contextlib
import io
import pickle
import sys

MEMORY = 2**31
"""Bytes."""
NO_WORKBOOK = 3
"""What it exits with if the bytes are no workbook; the reason is on stderr."""


def main() -> None:
    """Read standard input."""
    # A limit that is lower already stays; some systems have none
    with contextlib.suppress(ImportError, AttributeError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    import python_calamine

    try:
        book = python_calamine.CalamineWorkbook.from_filelike(io.BytesIO(sys.stdin.buffer.read()))
        sheets = {}
        for name in book.sheet_names:
            rows = book.get_sheet_by_name(name).to_python()
            sheets[name] = [(number, row) for number, row in enumerate(rows) if row.count("") < len(row)]
    except python_calamine.CalamineError as error:
        sys.stderr.write(str(error))
        sys.exit(NO_WORKBOOK)
    sys.stdout.buffer.write(pickle.dumps(sheets))


if __name__ == "__main__":
    main()
