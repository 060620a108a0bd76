"""`commonlaw discover`: from a table to a law."""

from commonlaw.cli.batch import Batch, with_batch
from commonlaw.cli.command import command
from commonlaw.cli.later import LaterSteps
from commonlaw.cli.learned import Learned, Outputs, with_outputs
from commonlaw.cli.question import Question, with_question
from commonlaw.cli.source import Source, with_training_source
from commonlaw.cli.working import working
from commonlaw.progress import part


@command
@with_training_source
@with_question
@with_outputs
@with_batch
def discover(source: Source, question: Question, outputs: Outputs, batch: Batch) -> None:
    """Find the law that the objects in FILE share.

    FILE is a table (CSV, TSV, Parquet, Excel) with one row for each sample. The law is checked by forecasting: the
    trials that --where leaves out or --hold-out names, or if there are none, those that it was learned from.

    \b
    Examples:
      commonlaw discover drops.csv --object ball --trial drop --time t --state height --order 2 \\
          --save law.json --plot law.png
      commonlaw discover drops.csv --order 2 --exclude trial=3 --learn-until 1.5
      commonlaw discover drops.csv --order 2 --property diameter --property mass --explain
      commonlaw discover monday.csv tuesday.csv --each --order 2 --out results.csv
      commonlaw discover --dataset ball-drops --where trial=1 --order 2 --solver group-stlsq:1.5
    """
    batch.check(source, outputs.named)
    if batch.each:
        with working("Discovering ...") as show:
            results = batch.run(source, question, show)
        results.give(batch.out, LaterSteps())
        return
    with working("Discovering ...") as show:
        show("reading the table")
        trials, later = source.load(), LaterSteps()
        training = source.select(trials)
        law = question.answer(training, part(show, 0.05, 0.9))
        outputs.keep(law, later)
        law = question.explained(law, show, later)
        show("checking the law by forecasts")
        learned = Learned.check(law, source, trials, training, bool(outputs.plot), later)
    outputs.give(learned, later)
