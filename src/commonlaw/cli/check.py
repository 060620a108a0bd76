"""`commonlaw check`: how well a saved law fits trials, by its residuals."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from commonlaw.cli.command import command
from commonlaw.cli.later import LaterSteps
from commonlaw.cli.on_cluster import on_cluster_at, stream_of, with_cluster
from commonlaw.cli.output import print_frame, print_json, say
from commonlaw.cli.paths import ReadFile, WrittenFigure, WrittenFile
from commonlaw.cli.source import Source, with_source
from commonlaw.cli.working import working

if TYPE_CHECKING:
    from commonlaw.discrepancy import StreamResiduals
    from commonlaw.discrepancy.residual_tests import Pattern
    from commonlaw.law import Law

_STRANGEST = 10
"""Objects that are shown themselves."""


@command
@click.argument("law_path", metavar="LAW.json", type=ReadFile())
@with_source
@click.option(
    "--save",
    type=WrittenFile(),
    metavar="RESIDUALS.csv",
    help="Write measured and fitted states, and residuals over noise; of files a row for each object and state.",
)
@click.option(
    "--plot", type=WrittenFigure(), metavar="FIGURE", help="Write a figure of the residuals (.png, .svg, .pdf)."
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@with_cluster
def check(
    law_path: str, source: Source, save: str | None, plot: str | None, as_json: bool, cluster: str | None
) -> None:
    """Say how well LAW.json fits FILE: what its trajectories leave of the measurements, and which patterns that has.

    Each trial's start is fitted, the coefficients stay. Residuals are compared with the noise, and held against time,
    states, rates, inputs and each other; tests look for memory, growing scatter, and errors that are not normal. Of a
    folder of Parquet files, or a pattern in quotes, all trials are tested together, file by file, and objects whose
    residuals are larger than the noise are named.

    \b
    Example:
      commonlaw check law.json drops.csv --plot residuals.png
      commonlaw check law.parquet 'runs/*.parquet' --save objects.csv --cluster local:4
    """
    from commonlaw.law import Law

    law = Law.load(law_path)
    if cluster or source.is_stream:
        _check_stream(law, source, save, plot, as_json, cluster)
        return
    with working("Checking ..."):
        trials = source.chosen(law.schema)
        found = law.residuals(trials)
        later = LaterSteps()
        later.write(save, lambda: found.to_frame().to_csv(index=False).encode())
        later.draw(plot, lambda plots: plots.plot_residuals(found))
    if as_json:
        print_json({"patterns": _document(found.patterns)})
    else:
        print_frame(found.tests().drop(columns="meaning"))
        say(f"\n{found}")
    later.end(found.trials.notes, silent=as_json)


def _check_stream(
    law: "Law", source: Source, save: str | None, plot: str | None, as_json: bool, cluster: str | None
) -> None:
    """Check the trials of files, one file after the other or by workers."""
    from commonlaw.discrepancy import check_stream

    source.check_streams()
    if plot:
        raise click.UsageError("--plot with a stream of files: leave it out, or check single files")
    later = LaterSteps()
    with working("Checking ...") as show, on_cluster_at(cluster, show):
        found = check_stream(law, source.select(stream_of(source, law.schema)), progress=show)
        later.write(save, lambda: found.objects.to_csv(index=False).encode())
    if as_json:
        objects = found.objects.to_dict(orient="records")
        print_json({"patterns": _document(found.patterns), "objects": objects})
    else:
        _show(found)
    later.end(silent=as_json)


def _document(patterns: "Sequence[Pattern]") -> list[dict[str, object]]:
    return [asdict(each) | {"significant": each.significant} for each in patterns]


def _show(found: "StreamResiduals") -> None:
    """Print patterns, letter values of what residuals of objects are over noise, and the largest."""
    from commonlaw.law.tables import letter_values

    print_frame(found.tests().drop(columns="meaning"))
    say(f"\n{found}")
    columns = ("size over noise", "correlation of neighbours")
    for state, own in found.objects.groupby("state", sort=False):
        say(f"\nResiduals of {state}, by object:\n")
        print_frame(letter_values({name: own[name].to_numpy() for name in columns}, "object"))
    say("\nThe largest:\n")
    print_frame(found.objects.sort_values("size over noise", ascending=False, kind="stable")[:_STRANGEST])
