"""`commonlaw study`: investigations that run from end to end and write a report."""

import click

from commonlaw.cli.output import progress


@click.group()
def study() -> None:
    """Run a whole investigation and write its report."""


@study.command("falling-balls")
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
    "--seed", default=100, show_default=True, type=click.IntRange(0, 2**32 - 1), help="Of the simulated noise."
)
@click.option("--json", "results", metavar="FILE", help="Write all results as JSON here too.")
def falling_balls(out: str, data: str | None, only: str | None, seed: int, results: str | None) -> None:
    """Redo the founding paper on measured and simulated drops of balls, each result beside what was printed.

    Writes FOLDER/report.html, which needs nothing else, and beside it the figures as SVG and PNG, the tables as CSV
    and all numbers as results.json.

    \b
    Example:
      commonlaw study falling-balls --out report/
    """
    from commonlaw.files import write_whole
    from commonlaw.report import Picture, Table, Text, to_json, write_report
    from commonlaw.studies.falling_balls import inquire, run

    inquiry = inquire(data, seed, simulated_only=only == "simulated")
    with progress() as show:
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
