"""`commonlaw report`: from a table to a page on its law."""

import shlex
import sys

from commonlaw.cli.command import command
from commonlaw.cli.options import in_options, option
from commonlaw.cli.output import say, working
from commonlaw.cli.paths import ReadFile, WrittenFile
from commonlaw.cli.question import Question, with_question
from commonlaw.cli.source import Source, with_training_source
from commonlaw.files import write_whole


@command
@with_training_source
@with_question
@option("Output", "--out", metavar="REPORT.html", type=WrittenFile(), default="report.html", help="The page to write.")
@option(
    "Output",
    "--law",
    "law_path",
    metavar="LAW.json",
    type=ReadFile(),
    help="A saved law to report on; nothing is learned then.",
)
def report(source: Source, question: Question, out: str, law_path: str | None) -> None:
    """Find the law that the objects in FILE share, and write a page that says all about it.

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
    from commonlaw.report import check_packages, law_report, to_page

    check_packages()
    with working("Reporting ...") as show:
        law = Law.load(law_path) if law_path else None
        trials = source.load(law.schema if law else None)
        training = source.select(trials)
        law = question.answer(training, show) if law is None else law
        command = shlex.join(["commonlaw", *sys.argv[1:]])
        made = law_report(law, trials, training, command, source.path or "", in_options, show)
        page = to_page(made, lambda name: show(f"drawing {name}"))
    write_whole(out, page)
    say(f"Wrote {out}")
