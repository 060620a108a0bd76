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
        except CommonlawError as error:
            self.failures.append(f"{failure}: {error.sentence(marked)}")
        except MemoryError:
            self.failures.append(f"{failure}: there is not enough memory")
        except Exception as error:  # A fault of ours or of others is no reason to lose what was found
            self.failures.append(f"{failure}: {type(error).__name__}: {error}")
        return otherwise

    def write(self, path: str | None, content: Callable[[], bytes | None]) -> None:
        """Write a file if one is asked for; a content of None is none, for which there are words already."""
        made = self.take(f"{path} was not made", content, None) if path else None
        if not path or made is None:
            return
        try:
            write_whole(path, made)
        except CommonlawError as error:
            self._unwritten.append(f"{error.sentence(marked)} [{reference(error.code)}]")
        else:
            self.written += [path] if path not in self.written else []

    def write_law(self, path: str | None, law: "Law") -> None:
        """Write a law if that is asked for; one of so many objects that its JSON is too large as Parquet beside it."""
        from commonlaw.law.io import law_file

        failure, nothing = f"{path} was not made", ("", b"")
        name, content = self.take(failure, lambda: law_file(law, path), nothing) if path else nothing
        self.write(name or None, lambda: content)
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

        def drawn(path: str, figure: "Callable[[ModuleType], Figure | None]") -> bytes | None:
            from commonlaw import plots

            made = figure(plots)
            return None if made is None else plots.render(made, path)

        def program(law: "Law", path: str) -> bytes:
            from commonlaw.law.export import exported

            return exported(law, path)

        def tabled(path: str, table: "Callable[[], pd.DataFrame]") -> bytes:
            content = BytesIO()
            if path.lower().endswith(".csv"):
                table().to_csv(content, index=False)
            else:
                table().to_parquet(content, index=False)
            return content.getvalue()

        for path in paths:
            if law is not None and is_of_kind(path, "law"):
                self.write_law(path, law)
            elif law is not None and is_of_kind(path, "program"):
                self.write(path, partial(program, law, path))
            elif figure is not None and is_of_kind(path, "figure"):
                self.write(path, partial(drawn, path, figure))
            elif report is not None and is_of_kind(path, "report"):
                self.write(path, report)
            elif table is not None and is_of_kind(path, "table"):
                self.write(path, partial(tabled, path, table))

    def end(self, notes: Iterable[object] = (), *, silent: bool = False, reasons: Sequence[str] = ()) -> None:
        """Say which files were written, unless silent, then the notes and what failed.

        Refuse to end well where a file could not be written, or for other reasons.
        """
        for path in () if silent else self.written:
            say(f"Wrote {path}")
        print_notes([*notes, *(failure for failure in self.failures if failure not in reasons)])
        if refused := [*self._unwritten, *reasons]:
            raise CommonlawError("several", messages=refused)
