"""`commonlaw data`: look at tables and data sets before learning from them."""

import click

from commonlaw.cli.command import Commands
from commonlaw.cli.options import AS_JSON, in_options, option, saving
from commonlaw.cli.output import print_frame, print_json, print_notes, say
from commonlaw.cli.source import EVERY_OPTION, WITH_LAW, Source, with_table, written_schema
from commonlaw.runtime.files import write_whole
from commonlaw.text import counted, in_line


@click.group(cls=Commands)
def data() -> None:
    """Look at measurements before learning from them."""


@data.command()
@with_table(*EVERY_OPTION)
@option(
    "--order",
    "Order of the laws that are tested for confounded variables; 0 for no test.  [default: 2 for a "
    "single state, 1 for several]",
    type=click.IntRange(0, 2),
)
@option("--library SPEC", "Their candidate terms, as in discover.  [default: poly:3]")
@saving(schema="the roles of the columns and how the table is read, for --schema of all commands")
@AS_JSON
def check(source: Source, order: int | None, library: str | None, save: tuple[str, ...], as_json: bool) -> None:
    """Summarize TABLE, run the data checks, and list what --clip would cut.

    The check also lists confounded variables: in these trials one determines the other, so that laws in either fit
    equally well; and initial values that would separate them.

    \b
    Example:
      commonlaw data check drops.csv --object ball --trial drop --time t --state height --save schema.toml
      commonlaw discover drops.csv --schema schema.toml --order 2
    """
    trials = source.chosen()
    report = trials.check(order=order, library=library)
    for path in save:
        write_whole(path, written_schema(source, trials))
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
    for path in save:
        say(f"Wrote {path}")
    print_notes(trials.notes)


@data.command(name="list")
def list_() -> None:
    """List the data sets that can be used as a table, dataset:NAME, with their options and sources."""
    from inspect import signature

    from commonlaw.datasets import DATASETS

    for name, dataset in DATASETS.items():
        options = ", ".join(
            f"{parameter.name}={parameter.default}" for parameter in signature(dataset.load).parameters.values()
        )
        say(f"{name}: {dataset.summary}\n    options: {options}\n    source: {dataset.citation}\n")


@data.command()
@with_table(*WITH_LAW)
@saving(table="the table", required=True)
def export(source: Source, save: tuple[str, ...]) -> None:
    """Write trials as a table, without loss.

    \b
    Example:
      commonlaw data export dataset:linear-drag:noise=0.05 --save drops.csv
    """
    trials = source.chosen()
    for path in save:
        write = trials.to_csv if path.lower().endswith(".csv") else trials.to_parquet
        write(path)
        say(f"Wrote {path}")
    print_notes(trials.notes)
