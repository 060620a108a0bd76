"""Several files, each with a law of its own, and one table of all: `commonlaw discover --each`."""

from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import click

from commonlaw.cli.later import LaterSteps
from commonlaw.cli.options import as_one, in_options, option
from commonlaw.cli.output import print_table, say
from commonlaw.cli.paths import ReadFile, WrittenTable
from commonlaw.cli.question import Question
from commonlaw.cli.source import Source, guesses
from commonlaw.cli.workers import in_processes, in_words
from commonlaw.runtime.cluster import counting, current_cluster
from commonlaw.runtime.progress import ProgressCallback, Stage
from commonlaw.text import as_text, counted, shown

Piece = tuple[Source, Question]

COLUMNS = (
    "file", "object", "equation", "term", "value", "standard error", "low", "high", "unit", "verdict", "error",
)  # fmt: skip
"""Of the table of all files, which has a row for each coefficient, or for a file without a law."""

_several = partial(option, "Several files")

_OPTIONS = (
    click.argument("more", nargs=-1, metavar="[MORE FILES]...", type=ReadFile()),
    _several("--each", is_flag=True, help="Find a law in each FILE by itself, instead of one in a single FILE."),
    _several(
        "--out",
        type=WrittenTable(),
        metavar="RESULTS.csv",
        help="With --each: write one table (.csv or .parquet) with a row for each coefficient of each file: its value, "
        "standard error, 95 % interval and unit, the verdict on the law, or what was wrong with the file. With "
        "a stream of files: a row for each coefficient of each object.",
    ),
    _several(
        "--workers",
        type=click.IntRange(1),
        help="With --each: how many files are worked on at the same time.  [default: one for each core]",
    ),
)


if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Found:
    """What was found in a file: the form of the law, whether it can be used, the rows of the table, and guesses."""

    law: str
    usable: bool | None
    rows: list[dict[str, object]]
    guesses: list[str]


@dataclass(frozen=True)
class Batch:
    """What is said of several files."""

    more: tuple[str, ...]
    each: bool
    out: str | None
    workers: int | None

    def check(self, source: Source, given: Sequence[str], cluster: str | None, streams: bool) -> None:
        """Refuse what does not go together; `given` are options that are for a single file."""
        if not self.each:
            if self.more:
                raise click.UsageError(
                    "several files: say --each to find a law in each of them, or put them into one table with a column "
                    "that names the object (and one for the trial) to find the law that they share"
                )
            if self.workers or (self.out and not streams):
                raise click.UsageError("--out and --workers go with --each: leave them out, or say --each")
        elif cluster and self.workers:
            raise click.UsageError("--workers is for this machine: leave it out, --cluster has the workers that it has")
        elif not source.path or source.dataset:
            raise click.UsageError("--each takes files: commonlaw discover a.csv b.csv --each --out results.csv")
        elif given:
            raise click.UsageError(f"{' and '.join(given)} for a single file: with --each, results go to --out")

    def run(self, source: Source, question: Question, show: ProgressCallback) -> "Results":
        """Find the laws of all files, by the workers of a cluster if there is one."""
        paths = [path for path in (source.path, *self.more) if path]
        pieces = [(replace(source, path=str(Path(path).absolute())), question) for path in paths]
        results: list[tuple[Found | None, str]] = [(None, "")] * len(paths)
        with closing(self._ended(pieces, show)) as ended:
            for number, found, failure in ended:
                results[number] = found, in_options(failure)
        return Results(paths, results)

    def _ended(self, pieces: Sequence[Piece], show: ProgressCallback) -> Generator[tuple[int, Found | None, str]]:
        """Yield the number of each file as soon as it is done, with what was found or why nothing was."""
        cluster = current_cluster()
        if cluster is not None:
            tell = counting(show, "files", len(pieces), cluster)
            for done, (number, found, error) in enumerate(cluster.each(_found, pieces), start=1):
                yield number, found, in_words(error) if error else ""
                tell(done)
            return
        from joblib import cpu_count

        at_once = min(self.workers or cpu_count(), len(pieces))
        show(Stage(f"{at_once} processes for {len(pieces)} files", 0.0))
        with closing(in_processes(_found, pieces, at_once)) as ended:
            for done, each in enumerate(ended, start=1):
                yield each
                show(Stage(f"{done} of {len(pieces)} files", done / len(pieces)))


@dataclass(frozen=True)
class Results:
    """What was found in each file, or why nothing was."""

    paths: Sequence[str]
    found: Sequence[tuple[Found | None, str]]

    def give(self, out: str | None, later: LaterSteps) -> None:
        """Write the table, print a line for each file, and say in how many there is a law."""
        later.write(out, lambda: self._table(str(out)))
        words = {True: "can be used", False: "cannot be used", None: "could not be judged"}
        print_table(
            ["file", "law", "forecasts by it, or what is wrong"],
            [
                [path, each.law, words[each.usable]] if each else [path, "", failure]
                for path, (each, failure) in zip(self.paths, self.found, strict=True)
            ],
        )
        laws = sum(each is not None for each, _ in self.found)
        say(f"\n{counted(laws, 'law')} in {counted(len(self.paths), 'file')}")
        files = dict[str, list[str]]()
        for path, (each, _) in zip(self.paths, self.found, strict=True):
            for guess in each.guesses if each else ():
                files.setdefault(guess, []).append(path)
        later.end(
            [f"in {shown(names)}: {guess}" for guess, names in files.items()],
            reasons=() if laws else ("no file has a law",),
        )

    def _table(self, path: str) -> bytes:
        import pandas as pd

        rows: list[dict[str, object]] = []
        for name, (each, failure) in zip(self.paths, self.found, strict=True):
            file: dict[str, object] = {"file": as_text(name)}
            rows += [file | row for row in each.rows] if each else [file | {"error": failure}]
        return table_bytes(pd.DataFrame(rows, columns=COLUMNS), path)


def table_bytes(frame: "pd.DataFrame", path: str) -> bytes:
    """Return a table in the format that the name of its file says."""
    if path.endswith(".csv"):
        return frame.to_csv(index=False).encode()
    content = BytesIO()
    frame.to_parquet(content, index=False)
    return content.getvalue()


with_batch = as_one("batch", Batch, _OPTIONS)
"""Adds further files and the options for them to a command, which receives them as `batch`."""


def _found(piece: Piece) -> Found:
    """Return what is found in a file."""
    from commonlaw.law.tables import coefficient_rows

    source, question = piece
    trials, later = source.load(), LaterSteps()
    training = source.select(trials)
    law = question.explained(question.answer(training, lambda _: None), lambda _: None, later)
    verdict = later.take("the law was not judged", lambda: law.assess(trials, training), None)
    said: dict[str, object] = {
        "verdict": verdict.sentences[0] if verdict else None,
        "error": "; ".join(later.failures) or None,
    }
    rows = coefficient_rows(law).to_dict(orient="records") or [{}]
    return Found(
        "; ".join(law.structure),
        verdict.usable if verdict else None,
        [{str(name): value for name, value in each.items()} | said for each in rows],
        guesses(trials),
    )
