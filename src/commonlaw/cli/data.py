"""`commonlaw data`: look at tables and data sets before learning from them."""

import click

from commonlaw.cli.command import Commands
from commonlaw.cli.options import WrittenFile, WrittenTable, in_options
from commonlaw.cli.output import print_frame, print_json, print_notes, say
from commonlaw.cli.source import Source, with_source, written_schema
from commonlaw.runtime.files import write_whole
from commonlaw.text import counted, in_line


@click.group(cls=Commands)
def data() -> None:
    """Look at measurements before learning from them."""


@data.command(works=False)
@with_source
@click.option(
    "--order",
    type=click.IntRange(0, 2),
    help="Of the laws for which to say what the trials cannot tell apart; 0 says nothing.  [default: 2 for a single "
    "state, 1 for several]",
)
@click.option("--library", metavar="SPEC", help="Their candidate terms, as in discover.  [default: poly:3]")
@click.option(
    "--save",
    metavar="SCHEMA.toml",
    type=WrittenFile(),
    help="Write the roles of the columns and how the table is read, for --schema of all commands.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def check(source: Source, order: int | None, library: str | None, save: str | None, as_json: bool) -> None:
    """Say what is in FILE, what data checks find, and what --clip would cut.

    Where trials visit little more than one curve, variables stand in for each other on it, and laws in the one and in
    the other fit alike: that is said too, with the starts that would tell.

    \b
    Example:
      commonlaw data check drops.csv --object ball --trial drop --time t --state height --save schema.toml
      commonlaw discover drops.csv --schema schema.toml --order 2
    """
    trials = source.chosen()
    report = trials.check(order=order, library=library)
    if save:
        write_whole(save, written_schema(source, trials))
    if as_json:
        print_json(report.to_dict())
        return
    say(
        f"{in_line(source.name)}: {counted(len(trials), 'trial')} of {counted(len(trials.objects), 'object')}, "
        f"measured: {in_line(', '.join(trials.schema.states))}"
    )
    for line in report.lines():
        say(in_line(f"Data check: {in_options(line)}"))
    if not report.findings:
        say("Data checks: no problem found.")
    say("")
    frame = report.to_frame()
    print_frame(frame, {name: name.replace("_", " ") for name in map(str, frame)})
    if save:
        say(f"Wrote {save}")
    print_notes(trials.notes)


@data.command(name="list", works=False)
def list_() -> None:
    """List the data sets that --dataset knows, with their options and their sources."""
    from inspect import signature

    from commonlaw.datasets import DATASETS

    for name, dataset in DATASETS.items():
        options = ", ".join(f"{each.name}={each.default}" for each in signature(dataset.load).parameters.values())
        say(f"{name}: {dataset.summary}\n    options: {options}\n    source: {dataset.citation}\n")


@data.command(works=False)
@with_source
@click.option("--save", required=True, metavar="FILE", type=WrittenTable(), help="The table: .csv or .parquet.")
def export(source: Source, save: str) -> None:
    """Write trials as a table that commonlaw and others read without loss.

    \b
    Example:
      commonlaw data export --dataset linear-drag:noise=0.05 --save drops.csv
    """
    trials = source.chosen()
    write = trials.to_csv if save.endswith(".csv") else trials.to_parquet
    write(save)
    say(f"Wrote {save}")
    print_notes(trials.notes)
