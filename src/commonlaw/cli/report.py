"""`commonlaw report`: a page on a saved law."""

from functools import partial

from commonlaw.cli.artifacts import LaterSteps
from commonlaw.cli.command import command, working
from commonlaw.cli.options import LAW_ARGUMENT, saving
from commonlaw.cli.output import say
from commonlaw.cli.results import page
from commonlaw.cli.source import (
    WITH_LAW,
    Source,
    columns_of,
    guesses,
    on_cluster_at,
    stream_of,
    with_cluster,
    with_table,
)
from commonlaw.runtime.progress import part


@command
@with_table(*WITH_LAW, training=True)
@LAW_ARGUMENT
@saving(report="the page", default=("report.html",))
@with_cluster
def report(source: Source, law_path: str, save: tuple[str, ...], cluster: str | None) -> None:
    """Write a page that says all about LAW.json and how it forecasts TABLE.

    Of a folder of Parquet files, or a pattern in quotes, all trials are forecast, with --cluster by workers, and the
    page shows few objects that stand for all. --hold-out and --learn-until say what the law did not learn from.

    The page needs nothing else: it opens offline, on a phone too, and prints. It has the verdict and the law as a
    formula, trials beside forecasts, coefficients, what else it could be, what the law leaves, where it may be used,
    what data checks found, every choice, and how to make it again. `discover --save report.html` finds a law first.

    \b
    Examples:
      commonlaw report drops.csv law.json --save drops.html
      commonlaw report chicks.csv law.json --learn-until 14
    """
    from commonlaw.law import Law
    from commonlaw.stream import find_by_stream
    from commonlaw.verdict import find

    streams = bool(cluster) or source.is_stream
    if streams:
        source.check_streams()
    with working("Reporting ...") as show, on_cluster_at(cluster, show):
        law, later, guessed = Law.load(law_path), LaterSteps(), list[str]()
        show("assessing forecasts")
        if streams:
            stream = stream_of(source, law.schema)
            training = source.select(stream) if source.holds_out else None
            found = find_by_stream(law, source.held_out(stream), part(show, 0.0, 1.0), training)
            made = partial(page, found.few, source.stream_program(), show, found)
        else:
            trials = source.load(columns_of(law))
            guessed += guesses(trials)
            program = source.program(trials) if source.path else ""
            made = partial(page, find(law, trials, source.select(trials)), program, show)
        later.save(save, report=made)
    written = {*save} <= {*later.written}
    if not written:
        say(str(law))
    later.end(guessed, reasons=() if written else later.failures)
