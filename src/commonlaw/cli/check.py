"""`commonlaw check`: how well a saved law fits trials, by its residuals."""

from dataclasses import asdict

import click

from commonlaw.cli.command import command
from commonlaw.cli.later import LaterSteps
from commonlaw.cli.output import print_frame, print_json, say
from commonlaw.cli.paths import ReadFile, WrittenFigure, WrittenFile
from commonlaw.cli.source import Source, with_source
from commonlaw.cli.working import working


@command
@click.argument("law_path", metavar="LAW.json", type=ReadFile())
@with_source
@click.option(
    "--save",
    type=WrittenFile(),
    metavar="RESIDUALS.csv",
    help="Write measured and fitted states, and residuals over noise.",
)
@click.option(
    "--plot", type=WrittenFigure(), metavar="FIGURE", help="Write a figure of the residuals (.png, .svg, .pdf)."
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def check(law_path: str, source: Source, save: str | None, plot: str | None, as_json: bool) -> None:
    """Say how well LAW.json fits FILE: what its trajectories leave of the measurements, and which patterns that has.

    Each trial's start is fitted, the coefficients stay. Residuals are compared with the noise, and held against time,
    states, rates, inputs and each other; tests look for memory, growing scatter, and errors that are not normal.

    \b
    Example:
      commonlaw check law.json drops.csv --plot residuals.png
    """
    from commonlaw.law import Law

    law = Law.load(law_path)
    with working("Checking ..."):
        trials = source.select(source.load(law.schema))
        found = law.residuals(trials)
        later = LaterSteps()
        later.write(save, lambda: found.to_frame().to_csv(index=False).encode())
        later.draw(plot, lambda plots: plots.plot_residuals(found))
    if as_json:
        print_json({"patterns": [asdict(each) | {"significant": each.significant} for each in found.patterns]})
    else:
        print_frame(found.tests().drop(columns="meaning"))
        say(f"\n{found}")
    later.end(found.trials.notes, silent=as_json)
