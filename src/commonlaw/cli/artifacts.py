"""What follows a result: no later step costs what was found."""

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from io import BytesIO
from types import ModuleType
from typing import TYPE_CHECKING, TypeVar

from commonlaw.cli.options import is_of_kind
from commonlaw.cli.output import print_notes, say
from commonlaw.diagnostics import marked, reference
from commonlaw.errors import CommonlawError
from commonlaw.runtime.files import write_whole

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.law import Law
    from commonlaw.plots import Figure


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

    A file is written as soon as its content is there. A step that fails, whatever the reason, is remembered, and the
    others are taken all the same, so that what was found in minutes is printed and saved.
    """

    def __init__(self) -> None:
        self.failures: list[str] = []
        self.written: list[str] = []
        self._unwritten: list[str] = []

    def take(self, failure: str, step: Callable[[], T], otherwise: T) -> T:
        """Return what a step gives; if it fails, something else, and the words for that are remembered."""
        try:
            return step()
        except Exception as error:  # A fault of ours or of others is no reason to lose what was found
            self.failures.append(f"{failure}: {in_words(error)}")
        return otherwise

    def write(self, path: str, content: Callable[[], bytes | None]) -> None:
        """Write a file; a content of None is none, for which there are words already."""
        made = self.take(f"{path} was not made", content, None)
        if made is None:
            return
        try:
            write_whole(path, made)
        except CommonlawError as error:
            self._unwritten.append(f"{error.sentence(marked)} [{reference(error.code)}]")
        else:
            self.written += [path] if path not in self.written else []

    def write_law(self, path: str, law: "Law") -> None:
        """Write a law; one of so many objects that its JSON is too large as Parquet beside it."""
        from commonlaw.law.io import law_file

        name, content = self.take(f"{path} was not made", lambda: law_file(law, path), ("", b""))
        if name:
            self.write(name, lambda: content)
        said = f"{path} is too large for JSON: the law is saved in {name}; use that file"
        if name not in ("", path) and said not in self.failures:
            self.failures.append(said)

    def save(
        self,
        paths: Iterable[str],
        *,
        law: "Law | None" = None,
        figure: "Callable[[ModuleType], Figure | None] | None" = None,
        table: "Callable[[], pd.DataFrame] | None" = None,
        report: Callable[[], bytes] | None = None,
    ) -> None:
        """Write files, each with what its ending says if that is given; figures by a function of the room of plots."""

        def content(path: str) -> bytes | None:
            if law is not None and is_of_kind(path, "program"):
                from commonlaw.law.export import exported

                return exported(law, path)
            if figure is not None and is_of_kind(path, "figure"):
                from commonlaw import plots

                made = figure(plots)
                return None if made is None else plots.render(made, path)
            if report is not None and is_of_kind(path, "report"):
                return report()
            if table is None or not is_of_kind(path, "table"):
                return None
            frame, file = table(), BytesIO()
            write = frame.to_csv if path.lower().endswith(".csv") else frame.to_parquet
            write(file, index=False)
            return file.getvalue()

        for path in paths:
            if law is not None and is_of_kind(path, "law"):
                self.write_law(path, law)
            else:
                self.write(path, partial(content, path))

    def end(self, notes: Iterable[object] = (), *, silent: bool = False, reasons: Sequence[str] = ()) -> None:
        """Say which files were written, unless silent, then the notes and what failed.

        Refuse to end well where a file could not be written, or for other reasons.
        """
        for path in () if silent else self.written:
            say(f"Wrote {path}")
        print_notes([*notes, *(failure for failure in self.failures if failure not in reasons)])
        if refused := [*self._unwritten, *reasons]:
            raise CommonlawError("several", messages=refused)
