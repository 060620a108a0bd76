"""`commonlaw discover`: from a table to a law, or with --each from each of several tables to its own."""

import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, TypeVar, cast

import click

from commonlaw.cli.artifacts import Artifacts
from commonlaw.cli.command import command, working
from commonlaw.cli.method_options import Question, with_question
from commonlaw.cli.options import ReadFile, as_one, in_options, is_of_kind, option
from commonlaw.cli.output import print_table, say
from commonlaw.cli.results import Outputs, find_law, with_outputs
from commonlaw.cli.source import WITHOUT_LAW, Source, guesses, on_cluster_at, with_cluster, with_table
from commonlaw.diagnostics import marked
from commonlaw.errors import CommonlawError
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
                    answer = connection.recv()
                    idle.append((process, connection))
                except (EOFError, OSError):
                    process.join()
                    connection.close()
                    code = process.exitcode
                    answer = None, f"its process ended by itself, with code {code}: is there enough memory?"
                yield number, *answer
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
                    answer: tuple[object, str] = work(piece), ""
                except Exception as error:  # A fault of ours or of others is no reason to lose what the others find
                    answer = None, in_words(error)
                connection.send(answer)
            except (EOFError, OSError):
                return


def in_words(error: Exception) -> str:
    """Return why a piece of work gave nothing."""
    if isinstance(error, CommonlawError):
        return error.sentence(marked)
    if isinstance(error, MemoryError):
        return "there is not enough memory for this: take fewer trials or a smaller library"
    return f"{type(error).__name__}: {error}"


Piece = tuple[Source, Question]

COLUMNS = (
    "file", "object", "equation", "term", "value", "standard error", "low", "high", "unit", "verdict", "error",
)  # fmt: skip
"""Of the table of all files, which has a row for each coefficient, or for a file without a law."""

_BATCH_OPTIONS = (
    click.argument("more", nargs=-1, metavar="[MORE TABLES]...", type=ReadFile()),
    option(
        "--each",
        "Find a law in each TABLE by itself, instead of one in a single TABLE, several at a time (--set "
        "n_jobs=4); --save then writes one table (.csv, .parquet) with a row for each coefficient of each "
        "file: its value, standard error, 95 % interval and unit, the verdict on the law, or what was wrong "
        "with the file.",
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

    def check(self, source: Source, outputs: Outputs, cluster: str | None) -> None:
        """Refuse what does not go together."""
        others = [each for each in outputs.save if not is_of_kind(each, "table")]
        given = [*(f"--save {each}" for each in others), *(["--json"] if outputs.as_json else [])]
        if not self.each:
            return
        if cluster and self.processes:
            raise click.UsageError("--set n_jobs is for this machine: leave it out, --cluster has its own workers")
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
            for number, found, failure in ended:
                path = paths[number]
                results[number] = replace(found, path=path) if found else FileResult(path, in_options(failure))
        return results

    def _ended(self, pieces: Sequence[Piece], show: ProgressCallback) -> Generator[tuple[int, FileResult | None, str]]:
        """Yield the number of each file as soon as it is done, with what was found or why nothing was."""
        cluster = current_cluster()
        if cluster is not None:
            tell = counting(show, "files", len(pieces), cluster)
            for done, (number, found, error) in enumerate(cluster.each(_found_in_file, pieces), start=1):
                yield number, found, in_words(error) if error else ""
                tell(done)
            return
        from joblib import cpu_count

        at_once = min(self.processes or cpu_count(), len(pieces))
        show(Stage(f"{at_once} processes for {len(pieces)} files", 0.0))
        with closing(in_processes(_found_in_file, pieces, at_once)) as ended:
            for done, each in enumerate(ended, start=1):
                yield each
                show(Stage(f"{done} of {len(pieces)} files", done / len(pieces)))


def give(results: Sequence[FileResult], paths: Sequence[str]) -> None:
    """Write the table, print a line for each file, and say in how many there is a law."""
    import pandas as pd

    later = Artifacts()
    rows = [{"file": as_text(each.path), **row} for each in results for row in each.rows or [{"error": each.failure}]]
    later.save(paths, table=lambda: pd.DataFrame(rows, columns=COLUMNS))
    words = {True: "can be used", False: "cannot be used", None: "could not be assessed"}
    print_table(
        ["file", "law", "forecasts by it, or what is wrong"],
        [[each.path, each.law, words[each.usable] if each.law else each.failure] for each in results],
    )
    laws = sum(bool(each.law) for each in results)
    say(f"\n{counted(laws, 'law')} in {counted(len(results), 'file')}")
    files = dict[str, list[str]]()
    for each in results:
        for guess in each.guesses:
            files.setdefault(guess, []).append(each.path)
    notes = [f"in {shown(names)}: {guess}" for guess, names in files.items()]
    later.end(notes, reasons=() if laws else ("no file has a law",))


with_batch = as_one("batch", Batch, _BATCH_OPTIONS)
"""Adds further files and the options for them to a command, which receives them as `batch`."""


def _found_in_file(piece: Piece) -> FileResult:
    """Return what is found in a file."""
    from commonlaw.law.tables import coefficient_rows

    source, question = piece
    trials, later = source.load(), Artifacts()
    training = source.select(trials)
    law = question.explained(question.answer(training, lambda _: None), lambda _: None, later)
    verdict = later.take("the forecast assessment failed", lambda: law.assess(trials, training), None)
    said: dict[str, object] = {
        "verdict": verdict.sentences[0] if verdict else None,
        "error": "; ".join(later.failures) or None,
    }
    rows = coefficient_rows(law).to_dict(orient="records") or [{}]
    return FileResult(
        source.name,
        law="; ".join(law.structure),
        usable=verdict.usable if verdict else None,
        rows=[{str(name): value for name, value in row.items()} | said for row in rows],
        guesses=guesses(trials),
    )


@command
@with_table(*WITHOUT_LAW, "states", "inputs", "properties", "exclude", training=True)
@with_question
@with_outputs
@with_batch
@with_cluster
def discover(source: Source, question: Question, outputs: Outputs, batch: Batch, cluster: str | None) -> None:
    """Discover the law that the objects in TABLE share.

    TABLE has one row for each sample (CSV, TSV, Parquet, Excel). Several tables, or a folder of them, are read as
    one, and named after objects and trials: golf_1.csv, golf_2.csv, tennis_1.csv. The law is checked by forecasts of
    the trials that --hold-out names or --where leaves out, or if there are none, of its training data. Parquet files
    in a folder or a quoted pattern are streamed one by one, with --cluster by its workers.

    \b
    Examples:
      commonlaw discover drops.csv --object ball --trial drop --time t --state height --order 2 \\
          --save law.json --save law.png --save report.html
      commonlaw discover drops.csv --schema drops.toml --order 2 --exclude trial=3 --learn-until 1.5
      commonlaw discover drops/*.csv --save report.html
      commonlaw discover monday.csv tuesday.csv --each --order 2 --save results.csv
      commonlaw discover 'runs/*.parquet' --object car --trial run --time t --state x --cluster tcp://host:8786
      commonlaw discover dataset:ball-drops --where trial=1 --order 2 --set solver=group-stlsq:1.5
    """
    if not batch.each:
        source = replace(source, more=batch.more)
    streams = bool(cluster) or source.is_stream
    batch.check(source, outputs, cluster)
    if streams and not batch.each:
        source.check_streams()
    with working("Discovering ...") as show, on_cluster_at(cluster, show):
        if batch.each:
            results = batch.run(source, question, show)
        else:
            learned, later = find_law(source, outputs, show, streams, question.answer, question.explained)
    if batch.each:
        give(results, outputs.save)
    else:
        outputs.give(learned, later)
