"""`commonlaw report`: from a table to a page on its law."""

import shlex
import sys
from functools import partial

import click

from commonlaw.cli.artifacts import LaterSteps
from commonlaw.cli.command import command, working
from commonlaw.cli.method_options import Question, with_question
from commonlaw.cli.options import ReadFile, WrittenFile, in_options, option
from commonlaw.cli.output import say
from commonlaw.cli.source import Source, guesses, on_cluster_at, stream_of, with_cluster, with_training_source
from commonlaw.runtime.progress import part
from commonlaw.text import as_text


@command
@with_training_source
@with_question
@option(
    "Output",
    "--out",
    everyday=True,
    metavar="REPORT.html",
    type=WrittenFile(),
    default="report.html",
    help="The page to write.",
)
@option("Output", "--save", everyday=True, metavar="LAW.json", type=WrittenFile(), help="Write the law that is found.")
@option(
    "Output",
    "--law",
    "law_path",
    everyday=True,
    metavar="LAW.json",
    type=ReadFile(),
    help="A saved law to report on; nothing is learned then.",
)
@with_cluster
def report(
    source: Source, question: Question, out: str, save: str | None, law_path: str | None, cluster: str | None
) -> None:
    """Find the law that the objects in FILE share, and write a page that says all about it.

    Of a folder of Parquet files, or a pattern in quotes, all trials are forecast, with --cluster by workers, and the
    page shows few objects that stand for all.

    The page needs nothing else: it opens offline, on a phone too, and prints. It has the verdict and the law as a
    formula, trials beside forecasts, coefficients, what else it could be, what the law leaves, where it may be used,
    what data checks found, every choice, and how to make it again. Options are those of `commonlaw discover`.

    \b
    Examples:
      commonlaw report drops.csv --object ball --trial drop --time t --state height --order 2 --out drops.html
      commonlaw report chicks.csv --learn-until 14
      commonlaw report drops.csv --law law.json
    """
    from commonlaw.law import Law
    from commonlaw.law.script import Source as Table
    from commonlaw.report import check_packages, law_report, to_page
    from commonlaw.report.document import Report
    from commonlaw.stream import find_by_stream
    from commonlaw.trials import Trials, TrialStream
    from commonlaw.verdict import find

    if save and law_path:
        raise click.UsageError("--save writes the law that is found, and with --law none is looked for: leave one out")
    check_packages()
    streams = bool(cluster) or source.is_stream
    if streams:
        source.check_streams()
    with working("Reporting ...") as show, on_cluster_at(cluster, show):
        given, later = Law.load(law_path) if law_path else None, LaterSteps()
        command = as_text(shlex.join(["commonlaw", *sys.argv[1:]]))

        def learned_from(training: Trials | TrialStream) -> Law:
            if given is not None:
                return given
            law = question.answer(training, part(show, 0.0, 0.5))
            later.write_law(save, law)
            law = question.explained(law, show, later)
            later.write_law(save, law)
            return law

        def of_stream(law: Law, stream: TrialStream, training: TrialStream) -> Report:
            learned = training if source.holds_out else None
            found = find_by_stream(law, source.held_out(stream), part(show, 0.5, 1.0), learned)
            table = Table(source.path or "", properties=source.properties, stream=True)
            return law_report(found.few, command, table, in_options, show, everything=found)

        def of_table(law: Law, trials: Trials, training: Trials) -> Report:
            table = source.program(trials) if source.path else ""
            return law_report(find(law, trials, training), command, table, in_options, show)

        known, guessed = given.schema if given else None, list[str]()
        if streams:
            stream = stream_of(source, known)
            some = source.select(stream)
            law = learned_from(some)
            made = partial(of_stream, law, stream, some)
        else:
            trials = source.load(known)
            guessed += guesses(trials)
            training = source.select(trials)
            law = learned_from(training)
            made = partial(of_table, law, trials, training)

        def page() -> bytes:
            show("assessing forecasts")
            return to_page(made(), lambda name: show(f"drawing {name}"))

        later.write(out, page)
    written = out in later.written
    if not written:
        say(str(law))
    later.end(guessed, reasons=() if written else later.failures)
