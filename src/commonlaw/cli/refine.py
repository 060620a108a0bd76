"""`commonlaw refine`: fit the coefficients of a saved law to trajectories."""

from typing import Any

import click

from commonlaw.cli.command import command
from commonlaw.cli.later import LaterSteps
from commonlaw.cli.methods import with_likelihood
from commonlaw.cli.on_cluster import on_cluster_at, stream_of, with_cluster
from commonlaw.cli.output import print_history, say
from commonlaw.cli.paths import ReadFile, WrittenFile
from commonlaw.cli.source import Source, with_source
from commonlaw.cli.working import working


@command
@click.argument("law_path", metavar="LAW.json", type=ReadFile())
@with_source
@with_likelihood
@click.option("--save", type=WrittenFile(), metavar="REFINED.json", help="Write the law.")
@click.option("--history", is_flag=True, help="Print every choice on the way to the law, and why.")
@with_cluster
def refine(
    law_path: str, source: Source, settings: dict[str, Any], save: str | None, history: bool, cluster: str | None
) -> None:
    """Fit the coefficients of LAW.json to FILE.

    They become those of maximum likelihood of the trajectories. The terms stay as they are, whatever found them; the
    law gets standard errors. With --cluster Parquet files are fitted one by one; their objects need not be in the law.

    \b
    Example:
      commonlaw discover drops.csv --order 2 --solver group-stlsq:1.5 --save law.json
      commonlaw refine law.json drops.csv --save refined.json
      commonlaw refine law.json 'runs/*.parquet' --save refined.parquet --cluster local:4
    """
    import commonlaw as cl

    law = cl.Law.load(law_path)
    if cluster:
        source.check_streams()
    with working("Refining ...") as show, on_cluster_at(cluster, show):
        trials = source.select(stream_of(source, law.schema)) if cluster else source.chosen(law.schema)
        law = cl.refine(law, trials, **settings, progress=show)
        later = LaterSteps()
        later.write_law(save, law)
    say(str(law))
    if history:
        print_history(law)
    later.end((*(trials.notes if isinstance(trials, cl.Trials) else ()), *law.diagnostics))
