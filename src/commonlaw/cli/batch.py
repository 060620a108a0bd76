"""The search for a law in each of several tables, by processes of this machine or workers of a cluster."""

import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any, TypeVar, cast

import click

from commonlaw.cli.options import ReadFile, as_one, in_options, is_of_kind, option
from commonlaw.cli.output import Artifacts, in_words, print_table, say
from commonlaw.cli.question import Question
from commonlaw.cli.results import Outputs
from commonlaw.cli.source import Source, guesses
from commonlaw.runtime.cluster import counting, current_cluster
from commonlaw.runtime.parallel import threads
from commonlaw.runtime.progress import ProgressCallback, Stage
from commonlaw.runtime.shutdown import begun, end_with_parent
from commonlaw.text import as_text, counted, shown

T = TypeVar("T")
R = TypeVar("R")


def in_processes(
    work: Callable[[T], R], pieces: Sequence[T], at_once: int
) -> Generator[tuple[int, R | None, str], None, None]:
    """Yield the number of each piece of work as soon as it is done, with what it gave or why there is nothing.

    So many processes at once do one piece after the other: what the first of them loads, the others have. Work and
    pieces must be possible to pickle. All processes end with this one, and when the generator is closed.
    """
    waiting, idle = list(enumerate(pieces))[::-1], list[tuple[BaseProcess, Connection]]()
    busy = dict[Connection, tuple[BaseProcess, int]]()
    try:
        while waiting or busy:
            while waiting and len(busy) < at_once:
                process, connection = idle.pop() if idle else begun(_serve, work)
                number, piece = waiting.pop()
                busy[connection] = process, number
                with suppress(OSError):  # Its process has ended; receiving the answer fails, too
                    connection.send(piece)
            for connection in cast(list[Connection], wait([*busy])):
                process, number = busy.pop(connection)
                try:
                    content = connection.recv_bytes()
                except (EOFError, OSError):
                    process.join()
                    connection.close()
                    code = process.exitcode
                    yield number, None, f"its process ended by itself, with code {code}: is there enough memory?"
                    continue
                idle.append((process, connection))
                try:
                    result, failure = ForkingPickler.loads(content)
                except Exception as error:  # One answer that cannot be read is no reason to lose the others
                    result, failure = None, in_words(error)
                yield number, result, failure
    finally:
        for process, connection in (*idle, *((process, connection) for connection, (process, _) in busy.items())):
            process.kill()
            process.join()
            connection.close()


def _serve(connection: Connection, work: Callable[[Any], object]) -> None:
    """Do pieces of work as they come; the main function of a process."""
    end_with_parent()
    warnings.simplefilter("ignore")
    with threads(1):  # The other processes have the other cores
        while True:
            try:
                piece = connection.recv()
                try:
                    content = ForkingPickler.dumps((work(piece), ""))
                except Exception as error:  # A fault of ours or of others is no reason to lose what the others find
                    content = ForkingPickler.dumps((None, in_words(error)))
                connection.send_bytes(content)
            except (EOFError, OSError):
                return


Piece = tuple[Source, Question]

COLUMNS = (
    "file", "object", "equation", "term", "value", "standard error", "low", "high", "unit", "verdict", "error",
)  # fmt: skip
"""Of the table of all files, which has a row for each coefficient, or for a file without a law."""

_BATCH_OPTIONS = (
    click.argument("more", nargs=-1, metavar="[MORE TABLES]...", type=ReadFile()),
    option(
        "--each",
        "Find a law in each TABLE by itself, instead of one in a single TABLE, several at a time (--set n_jobs=4); "
        "--save then writes one table (.csv, .parquet) with a row for each coefficient of each file: its value, "
        "standard error, 95 % interval and unit, the verdict on the law, or what was wrong with the file.",
        group="Several files",
        is_flag=True,
    ),
)


@dataclass(frozen=True)
class FileResult:
    """What was found in a file: the form of the law, whether it can be used, rows of the table, and guesses; or not."""

    path: str
    failure: str = ""
    law: str = ""
    usable: bool | None = None
    rows: Sequence[Mapping[str, object]] = ()
    guesses: Sequence[str] = ()


@dataclass(frozen=True)
class Batch:
    """What is said of several files."""

    more: tuple[str, ...]
    each: bool
    processes: int | None

    def check(self, source: Source, question: Question, outputs: Outputs, cluster: str | None) -> None:
        """Refuse what does not go together."""
        others = [file for file in outputs.save if not is_of_kind(file, "table")]
        given = [*(f"--save {file}" for file in others), *(["--json"] if outputs.as_json else [])]
        if not self.each:
            return
        if cluster and self.processes:
            raise click.UsageError("--set n_jobs is for this machine: leave it out, --cluster has its own workers")
        if question.resume:
            raise click.UsageError("--resume is for one law: leave it out with --each")
        if not source.path:
            raise click.UsageError("--each takes files: commonlaw discover a.csv b.csv --each --save results.csv")
        if given:
            raise click.UsageError(
                f"{' and '.join(given)} for a single file: with --each, results go to a table, --save results.csv"
            )

    def run(self, source: Source, question: Question, show: ProgressCallback) -> list[FileResult]:
        """Find the laws of all files, by the workers of a cluster if there is one."""
        paths = [path for path in (source.path, *self.more) if path]
        pieces = [(replace(source, path=str(Path(path).absolute())), question) for path in paths]
        results = [*map(FileResult, paths)]
        with closing(self._ended(pieces, show)) as ended:
            for number, result, failure in ended:
                path = paths[number]
                results[number] = replace(result, path=path) if result else FileResult(path, in_options(failure))
        return results

    def _ended(self, pieces: Sequence[Piece], show: ProgressCallback) -> Generator[tuple[int, FileResult | None, str]]:
        """Yield the number of each file as soon as it is done, with what was found or why nothing was."""
        cluster = current_cluster()
        if cluster is not None:
            tell = counting(show, "files", len(pieces), cluster)
            for done, (number, result, error) in enumerate(cluster.each(_found_in_file, pieces), start=1):
                yield number, result, in_words(error) if error else ""
                tell(done)
            return
        from joblib import cpu_count

        at_once = min(self.processes or cpu_count(), len(pieces))
        show(Stage(f"{at_once} processes for {len(pieces)} files", 0.0))
        with closing(in_processes(_found_in_file, pieces, at_once)) as ended:
            for done, outcome in enumerate(ended, start=1):
                yield outcome
                show(Stage(f"{done} of {len(pieces)} files", done / len(pieces)))


def give(results: Sequence[FileResult], paths: Sequence[str]) -> None:
    """Write the table, print a line for each file, and say in how many there is a law."""
    import pandas as pd

    later = Artifacts()
    rows = [{"file": as_text(file.path), **row} for file in results for row in file.rows or [{"error": file.failure}]]
    later.save(paths, table=lambda: pd.DataFrame(rows, columns=COLUMNS))
    words = {True: "can be used", False: "cannot be used", None: "could not be assessed"}
    print_table(
        ["file", "law", "forecasts by it, or what is wrong"],
        [[result.path, result.law, words[result.usable] if result.law else result.failure] for result in results],
    )
    laws = sum(bool(result.law) for result in results)
    say(f"\n{counted(laws, 'law')} in {counted(len(results), 'file')}")
    files = dict[str, list[str]]()
    for result in results:
        for guess in result.guesses:
            files.setdefault(guess, []).append(result.path)
    notes = [f"in {shown(names)}: {guess}" for guess, names in files.items()]
    later.end(notes, reasons=() if laws else ("no file has a law",))


with_batch = as_one("batch", Batch, _BATCH_OPTIONS)
"""Adds further files and the options for them to a command, which receives them as `batch`."""


def _found_in_file(piece: Piece) -> FileResult:
    from commonlaw.law.tables import coefficient_rows

    source, question = piece
    trials, later = source.load(), Artifacts()
    training = source.select(trials)
    law = question.explained(question.answer(training, lambda _: None), lambda _: None, later)
    verdict = later.take("the forecast assessment failed", lambda: law.assess(trials, training), None)
    summary: dict[str, object] = {"verdict": verdict.sentences[0] if verdict else None}
    summary["error"] = "; ".join(later.failures) or None
    rows = coefficient_rows(law).to_dict(orient="records") or [{}]
    return FileResult(
        source.name,
        law="; ".join(law.structure),
        usable=verdict.usable if verdict else None,
        rows=[{str(name): value for name, value in row.items()} | summary for row in rows],
        guesses=guesses(trials),
    )
