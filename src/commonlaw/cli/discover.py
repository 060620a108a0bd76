"""`commonlaw discover`: from a table to a law."""

from commonlaw.cli.batch import Batch, table_bytes, with_batch
from commonlaw.cli.by_stream import learned_by_stream
from commonlaw.cli.command import command
from commonlaw.cli.later import LaterSteps
from commonlaw.cli.learned import Learned, Outputs, with_outputs
from commonlaw.cli.on_cluster import on_cluster_at, with_cluster
from commonlaw.cli.question import Question, with_question
from commonlaw.cli.source import Source, with_training_source
from commonlaw.cli.working import working
from commonlaw.runtime.progress import ProgressCallback, part


@command
@with_training_source
@with_question
@with_outputs
@with_batch
@with_cluster
def discover(source: Source, question: Question, outputs: Outputs, batch: Batch, cluster: str | None) -> None:
    """Find the law that the objects in FILE share.

    FILE is a table (CSV, TSV, Parquet, Excel) with one row for each sample. The law is checked by forecasting: the
    trials that --where leaves out or --hold-out names, or if there are none, those that it was learned from. A folder
    of Parquet files, or a pattern in quotes, is gone through file by file, with --cluster by workers.

    \b
    Examples:
      commonlaw discover drops.csv --object ball --trial drop --time t --state height --order 2 \\
          --save law.json --plot law.png
      commonlaw discover drops.csv --order 2 --exclude trial=3 --learn-until 1.5
      commonlaw discover drops.csv --order 2 --property diameter --property mass --explain
      commonlaw discover monday.csv tuesday.csv --each --order 2 --out results.csv
      commonlaw discover 'runs/*.parquet' --object car --trial run --time t --state x --cluster tcp://host:8786
      commonlaw discover --dataset ball-drops --where trial=1 --order 2 --solver group-stlsq:1.5
    """
    streams = bool(cluster) or source.is_stream
    batch.check(source, outputs.named, cluster, streams)
    if streams and not batch.each:
        source.check_streams()
    with working("Discovering ...") as show, on_cluster_at(cluster, show):
        if batch.each:
            results = batch.run(source, question, show)
        else:
            learned, later = (_by_stream if streams else _here)(source, question, outputs, show)
    if batch.each:
        results.give(batch.out, LaterSteps())
    else:
        later.write(batch.out, lambda: _coefficients(learned, str(batch.out)))
        outputs.give(learned, later)


def _here(source: Source, question: Question, outputs: Outputs, show: ProgressCallback) -> tuple[Learned, LaterSteps]:
    """Find a law in a table."""
    show("reading the table")
    trials, later = source.load(), LaterSteps()
    training = source.select(trials)
    law = question.answer(training, part(show, 0.05, 0.9))
    outputs.keep(law, later)
    law = question.explained(law, show, later)
    show("checking the law by forecasts")
    return Learned.check(law, source, trials, training, bool(outputs.plot), later), later


def _by_stream(
    source: Source, question: Question, outputs: Outputs, show: ProgressCallback
) -> tuple[Learned, LaterSteps]:
    """Find a law in files that are gone through one by one."""
    return learned_by_stream(
        source, outputs, show, question.answer, lambda law, later: question.explained(law, show, later)
    )


def _coefficients(learned: Learned, path: str) -> bytes:
    """Return a table with a row for each coefficient of each object."""
    from commonlaw.law.tables import coefficient_rows

    return table_bytes(coefficient_rows(learned.law), path)
