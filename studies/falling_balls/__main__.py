"""Run the study and write its report: `python -m studies.falling_balls --out report/`, or `make study`."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click
from rich.console import Console

from commonlaw.errors import CommonlawError
from commonlaw.report import Picture, Table, Text
from commonlaw.runtime.files import check_targets, write_whole
from studies.falling_balls.report import to_json, write_report
from studies.falling_balls.settings import SEED
from studies.falling_balls.study import inquire, run


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.option("--out", default="report", show_default=True, metavar="FOLDER", help="Receives the report.")
@click.option(
    "--data", metavar="FOLDER", help="Holds Ball_drops_data.xls and balls.txt; default: as data set ball-drops."
)
@click.option(
    "--only",
    type=click.Choice(["tables", "figures", "simulated"]),
    help="Only tables or figures of all parts, or only what needs no measured drops.",
)
@click.option(
    "--seed", default=SEED, show_default=True, type=click.IntRange(0, 2**32 - 1), help="Of the simulated noise."
)
@click.option("--json", "results", metavar="FILE", help="Write all results as JSON here too.")
def falling_balls(out: str, data: str | None, only: str | None, seed: int, results: str | None) -> None:
    """Redo the founding paper on measured and simulated drops of balls, each result beside what was printed.

    Writes FOLDER/report.html, which needs nothing else, and beside it the figures as SVG and PNG, the tables as CSV
    and all numbers as results.json.

    \b
    Example:
      make study ARGS="--out report/ --only tables"
    """
    check_targets([] if results is None else [results])
    inquiry = inquire(data, seed, simulated_only=only == "simulated")
    with _progress() as show:
        report = run(inquiry, show)
        if only in ("tables", "figures"):
            report = report.keep(Text, Table if only == "tables" else Picture)
        written = write_report(report, out, lambda name: show(f"Drawn: {name}"))
    if results is not None:
        write_whole(results, to_json(report.results))
    for section in report.sections:
        for verdict in section.verdicts:
            click.echo(f"{section.title}: {verdict.kind}")
    click.echo(f"Wrote {written[0]}, and {len(written) - 1} files of figures, tables and results beside it")


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """Show on stderr how far long work has come; yields what takes the text of each step."""
    if not sys.stderr.isatty():
        yield lambda text: click.echo(text, err=True)
        return
    with Console(stderr=True).status("") as status:
        yield status.update


if __name__ == "__main__":
    try:
        falling_balls(prog_name="python -m studies.falling_balls")
    except CommonlawError as error:
        click.echo(f"falling balls: {error}", err=True)
        sys.exit(1)
