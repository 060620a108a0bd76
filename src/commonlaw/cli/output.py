"""What commands print and write, and the streams that take it."""

import errno
import os
import sys
from bisect import bisect_right
from codecs import register_error
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from io import BytesIO, TextIOWrapper
from itertools import accumulate
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any, TextIO, TypeVar

from commonlaw.cli.options import in_options, is_of_kind
from commonlaw.diagnostics import marked, reference
from commonlaw.errors import CommonlawError
from commonlaw.law.text import Written, with_error
from commonlaw.runtime.files import write_whole
from commonlaw.text import escaped, in_line, json_text, visible

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from commonlaw.law import Law
    from commonlaw.plots import Figure


def say(text: str, err: bool = False) -> None:
    """Print lines on stdout or stderr, with nothing in them that a terminal would obey.

    What stderr does not take is lost; the exit code remains.
    """
    try:
        print(visible(text), file=sys.stderr if err else sys.stdout, flush=True)
    except OSError:
        if not err:
            raise
        silence(sys.stderr)


def print_table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print the first rows of a table, text to the left and numbers to the right, as wide as the terminal.

    A cell is a number, a pair of a number and its standard error, or text.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    rows = [list(row) for row in rows]
    # More would take minutes to set
    rows, left_out = rows[:1000], rows[1000:]
    table = Table(box=SIMPLE_HEAD, show_edge=False)
    for j, name in enumerate(head):
        numeric = all(isinstance(row[j], int | float | tuple | Written) or str(row[j]).startswith("< ") for row in rows)
        table.add_column(in_line(name), justify="right" if numeric else "left")
    for row in rows:
        table.add_row(*map(shown, row))
    _console().print(table)
    if left_out:
        say(f" ... and {len(left_out)} more rows")


def print_columns(columns: Mapping[str, Sequence[object]]) -> None:
    """Print columns of which the first names the rows; a row for each column where they are too wide together."""
    head, rows, room = list(columns), list(zip(*columns.values(), strict=True)), _console().width
    if sum(_width((name, *values)) for name, values in columns.items()) <= room:
        print_table(head, rows)
        return
    names, across = _width(head), [*map(_width, rows)]
    while rows:
        # As many side by side as there is room for, but one at least
        count = max(1, bisect_right(list(accumulate(across)), room - names))
        print_table(
            [head[0], *(str(row[0]) for row in rows[:count])],
            zip(head[1:], *(row[1:] for row in rows[:count]), strict=True),
        )
        rows, across = rows[count:], across[count:]
        if rows:
            say("")


def _width(cells: Iterable[object]) -> int:
    """Return how many characters a column of these cells takes, with those between it and the next."""
    return 3 + max(len(line) for cell in cells for line in shown(cell).split("\n"))


def print_frame(frame: "pd.DataFrame", titles: Mapping[str, str] = MappingProxyType({})) -> None:
    """Print a data frame without its index; columns may have other titles."""
    from commonlaw.law.tables import readable

    frame = readable(frame)
    print_table([titles.get(str(name), str(name)) for name in frame.columns], frame.itertuples(index=False, name=None))


def print_law(law: "Law", parameters: "pd.DataFrame | None" = None) -> None:
    """Print a law: its equations, parameters, simpler forms, what is beyond it, and what is quoted of a known form.

    `parameters` is `commonlaw.summary.parameter_table` by default.
    """
    from commonlaw.law.tables import quantities_by_object, readable, spread_tables
    from commonlaw.law.text import MANY
    from commonlaw.summary import parameter_table, parameters_caption, remarks, shown_equations

    parameters = parameter_table(law) if parameters is None else parameters
    say("\n".join(map(in_line, shown_equations(law))))
    if len(law.objects) > MANY and (tables := spread_tables(law, 10)):
        spread, farthest = tables
        say("\nCoefficients of all objects:\n")
        print_frame(spread)
        say("\nThe 10 objects farthest from the medians, in standard deviations of a normal spread:\n")
        print_frame(farthest)
    elif len(parameters):
        say(f"\n{parameters_caption(law)}:\n")
        print_columns({str(name): column.tolist() for name, column in readable(parameters).items()})
    for line in remarks(law):
        say(f"\n{in_line(line)}")
    if len(quantities := quantities_by_object(law)):
        say("\nDerived quantities:\n")
        print_columns({str(name): column.tolist() for name, column in quantities.items()})


def _console() -> "Console":
    from rich.console import Console

    return Console(width=None if sys.stdout.isatty() else 160, highlight=False, markup=False, emoji=False)


def shown(value: object) -> str:
    """Return a cell's text: numbers to four digits or as far as their error lets them be, nothing for a missing one.

    Only numbers with their intervals have several lines.
    """
    if isinstance(value, Written):
        return str(value)
    if isinstance(value, tuple):
        return with_error(*value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return "" if value != value else f"{value:.4g}"
    return in_line(str(value))


def print_history(law: "Law") -> None:
    """Print all candidates for a law, and every choice on the way to it."""
    from commonlaw.law.tables import readable_candidates

    if law.provenance.alternatives:
        say("\nAll candidate laws (* chosen):\n")
        print_frame(readable_candidates(law.provenance.alternatives))
    say("\nFound in these steps:\n" if law.history else "\nThere is no record of how the law was found.")
    if law.history:
        rows = ([step.stage, step.choice, in_options(step.reason)] for step in law.history)
        print_table(["stage", "choice", "reason"], rows)


def print_json(document: Mapping[str, Any]) -> None:
    """Print a document as JSON; numbers that are not finite (a forecast that diverged) become null."""
    say(json_text(document))


def print_notes(notes: Iterable[object]) -> None:
    """Print remarks on stderr, each once, so that they do not mix with results."""
    for note in dict.fromkeys(map(str, notes)):
        say(in_line(f"Note: {in_options(note)}"), err=True)


@contextmanager
def changing_line(words: Callable[[], str]) -> Iterator[None]:
    """Show one line on the terminal of stderr that says, each time that it is drawn, what these words are."""
    from rich.console import Console
    from rich.text import Text

    class Words:
        def __rich__(self) -> Text:
            return Text(words())

    console = Console(stderr=True)
    with console.status(Words()):
        console.show_cursor()  # which would stay hidden if a signal ended the process
        yield


T = TypeVar("T")


def in_words(error: Exception) -> str:
    """Return why a step or a piece of work gave nothing."""
    if isinstance(error, CommonlawError):
        return error.sentence(marked)
    if isinstance(error, MemoryError):
        return "there is not enough memory for this: take fewer trials or a smaller library"
    return f"{type(error).__name__}: {error}"


class Artifacts:
    """The steps that follow a result, and what became of them.

    A file is written as soon as its content is there. A step that fails, whatever the reason, does not stop the others,
    so that what was found in minutes is printed and saved; without a file that was asked for the command then fails.
    """

    def __init__(self) -> None:
        self.failures: list[str] = []
        self.written: list[str] = []
        self._unwritten: dict[str, str] = {}

    def take(self, failure: str, step: Callable[[], T], otherwise: T) -> T:
        """Return what a step gives; if it fails, something else, and the words for that are remembered."""
        try:
            return step()
        except Exception as error:  # A fault of ours or of others is no reason to lose what was found
            self.failures.append(f"{failure}: {in_words(error)}")
        return otherwise

    def write(self, path: str, content: Callable[[], bytes]) -> None:
        """Write a file."""
        try:
            made = content()
        except Exception as error:  # As in `take`
            self._unwritten[path] = f"{path} was not made: {in_words(error)}"
            return
        try:
            write_whole(path, made)
        except CommonlawError as error:
            self._unwritten[path] = f"{error.sentence(marked)} [{reference(error.code)}]"
        else:
            self._unwritten.pop(path, None)
            self.written += [path] if path not in self.written else []

    def write_law(self, path: str, law: "Law") -> None:
        """Write a law; one whose JSON would be too large becomes a Parquet file in the same folder."""
        from commonlaw.law.io import law_file

        try:
            name, content = law_file(law, path)
        except Exception as error:  # As in `take`
            self._unwritten[path] = f"{path} was not made: {in_words(error)}"
            return
        self.write(name, lambda: content)
        message = f"{path} is too large for JSON: the law is saved in {name}; use that file"
        if name != path and message not in self.failures:
            self.failures.append(message)

    def save(
        self,
        paths: Iterable[str],
        *,
        law: "Law | None" = None,
        figure: "Callable[[ModuleType], Figure] | None" = None,
        table: "Callable[[], pd.DataFrame] | None" = None,
        report: Callable[[], bytes] | None = None,
    ) -> None:
        """Write files, each with what its ending says if that is given; figures by a function of the room of plots."""

        given = {"program": law, "figure": figure, "report": report, "table": table}

        def content(path: str) -> bytes:
            if law is not None and is_of_kind(path, "program"):
                from commonlaw.law.export import exported

                return exported(law, path)
            if report is not None and is_of_kind(path, "report"):
                from commonlaw.report import printed

                return printed(report()) if path.lower().endswith(".pdf") else report()
            if figure is not None and is_of_kind(path, "figure"):
                from commonlaw import plots

                return plots.render(figure(plots), path)
            assert table is not None
            frame, file = table(), BytesIO()
            write = frame.to_csv if path.lower().endswith(".csv") else frame.to_parquet
            write(file, index=False)
            return file.getvalue()

        for path in paths:
            if law is not None and is_of_kind(path, "law"):
                self.write_law(path, law)
            elif any(part is not None and is_of_kind(path, kind) for kind, part in given.items()):
                self.write(path, partial(content, path))

    def end(self, notes: Iterable[object] = (), *, silent: bool = False, reasons: Sequence[str] = ()) -> None:
        """Say which files were written, unless silent, then the notes and what failed.

        Refuse to end well where a file could not be made or written, or for other reasons.
        """
        for path in () if silent else self.written:
            say(f"Wrote {path}")
        print_notes([*notes, *(failure for failure in self.failures if failure not in reasons)])
        if refused := [*self._unwritten.values(), *reasons]:
            raise CommonlawError("several", messages=[*map(in_options, refused)])


_TAKES_NOTHING = {errno.EBADF, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.ENOSPC}
"""Errors of a stream that is closed, or that goes to where there is no space."""


@contextmanager
def standard_streams() -> Iterator[None]:
    """Prepare the standard streams for a command, and say why standard output does not take what it prints.

    Characters that a stream has no code for are shown like those that hide.

    Raises `CommonlawError` if standard output is closed, or what it goes to is full.
    """
    # Closed streams are opened, so that no file gets their numbers; nothing can be written to them
    for name, mode in {"stdin": "r", "stdout": "w", "stderr": "w"}.items():
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDONLY), mode))
    register_error("commonlaw", _shown)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="commonlaw")
    try:
        yield
        sys.stdout.flush()
    except OSError as error:
        if error.filename is not None or error.errno not in _TAKES_NOTHING:  # of something else
            raise
        silence(sys.stdout)
        raise CommonlawError("standard-output", reason=error.strerror) from error


def silence(stream: TextIO) -> None:
    """Send what a stream still holds, and all that follows, to nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def _shown(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    return escaped(error.object[error.start : error.end]), error.end
