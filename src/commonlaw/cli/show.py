"""`commonlaw show`, `explain` and `report`: a saved law, what decides its coefficients, and a page on it."""

import json
from dataclasses import replace
from functools import partial

import click

from commonlaw.cli.artifacts import Artifacts
from commonlaw.cli.command import command, working
from commonlaw.cli.options import AS_JSON, HISTORY, LAW_ARGUMENT, ReadFile, saving
from commonlaw.cli.output import (
    parameter_columns,
    print_frame,
    print_history,
    print_json,
    print_quantities,
    print_table,
    say,
)
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
from commonlaw.law import average_law, relations_frame, to_json, to_latex
from commonlaw.runtime.progress import part
from commonlaw.text import in_line


@command
@LAW_ARGUMENT
@click.option("--latex", is_flag=True, help="Print LaTeX.")
@click.option("--select", "name", metavar="NAME", help="Only this object.")
@click.option("--average", is_flag=True, help="The mean of all objects' coefficients.")
@click.option("--history", is_flag=True, help="Every choice on the way to the law, and why.")
def show(law_path: str, latex: bool, name: str | None, average: bool, history: bool) -> None:
    """Print LAW.json: equations, coefficients and derived quantities with 95 % intervals, range of the data."""
    import pandas as pd

    from commonlaw.law import Law
    from commonlaw.law.parameters import units_with_rates

    if name and average:
        raise click.UsageError("give --select or --average, not both")
    law = Law.load(law_path)
    law = law.select([name]) if name else average_law(law) if average else law
    if not latex:
        say(str(law))
        if law.uncertainty.covariance is not None:
            averaged = ", averaged over the plausible laws" if law.uncertainty.other_laws else ""
            say(f"\n95 % intervals{averaged}:\n")
            print_frame(law.params)
        print_quantities(law)
        if law.uncertainty.other_laws:
            say("\nPlausible laws:\n")
            rows = [(share, "; ".join(each.structure)) for share, each in law.models]
            print_frame(pd.DataFrame(rows, columns=["probability", "law"]))
        if law.provenance.domain.visited:
            say("\nRange of the training data (forecasts outside it are extrapolations):\n")
            print_frame(law.provenance.domain.to_frame(units_with_rates(law)))
        if law.provenance.domain.horizon is not None:
            say(f"\n{law.provenance.domain.horizon_sentence(law.schema.units.get(law.schema.time, ''))}")
        if history:
            print_history(law)
        return
    if law.uncertainty.explanation is not None and len(law.objects) > 1:
        say(to_latex(law))
        return
    for each in law.objects:
        say(f"% {in_line(each)}\n{to_latex(law, each)}")


@command
@LAW_ARGUMENT
@click.option(
    "--property",
    "names",
    metavar="NAMES",
    multiple=True,
    help="Properties that coefficients may follow, commas between several; repeat for more; '' for none.  [default: "
    "all numbers that the law knows of its objects]",
)
@click.option(
    "--properties",
    "table",
    metavar="FILE",
    type=ReadFile(),
    help="A table with the objects' properties, a row for each, if the law does not hold them.",
)
@saving(law="the law with what decides its coefficients", figure="a figure of coefficients against properties")
@click.option("--latex", is_flag=True, help="Print LaTeX.")
@AS_JSON
@HISTORY
def explain(
    law_path: str,
    names: tuple[str, ...],
    table: str | None,
    save: tuple[str, ...],
    latex: bool,
    history: bool,
    as_json: bool,
) -> None:
    """Relate the coefficients of LAW.json to properties of the objects.

    Each coefficient is shared by all objects, a power law of properties (0.25 diameter^2/mass), an affine function of
    properties if signs differ, or object-specific. The evidence decides.

    \b
    Examples:
      commonlaw explain law.json --property diameter,mass
      commonlaw explain law.json --properties balls.csv --save explained.json
    """
    from commonlaw.law import Law
    from commonlaw.law.parameters import named_parameters
    from commonlaw.trials.properties import given_properties

    law = Law.load(law_path)
    with working("Explaining ..."):
        if table:
            found = given_properties(table, law.schema.object, law.objects)
            schema = replace(law.schema, units={**law.schema.units, **found.units})
            law = replace(law, properties=found.values, schema=schema)
        has_properties = any(law.properties.values())
        named = [name for text in names for part in text.split(",") if (name := part.strip())]
        law = law.explain(named if names or not has_properties else None)
        later = Artifacts()
        later.save(save, law=law, figure=lambda plots: plots.plot_relations(law))
    if as_json:
        relations = relations_frame(law).to_dict(orient="records")
        print_json({"law": json.loads(to_json(law)), "equations": list(law.equations()), "relations": relations})
    elif latex:
        say(to_latex(law))
    else:
        say(f"{law}\n")
        kinds = {"universal": "shared", "own": "object-specific"}
        shown = relations_frame(law).dropna(axis=1, how="all").replace({"kind": kinds})
        print_frame(shown, {"scatter": "SD between objects", "scatter error": "its standard error"})
        if law.provenance.equations and named_parameters(law).names:
            columns = parameter_columns(law)
            say(f"\nParameters of {'; '.join(law.provenance.equations)}:\n")
            print_table(list(columns), zip(*columns.values(), strict=True))
        print_quantities(law)
        if history:
            print_history(law)
    notes = () if has_properties else ("no property of the objects is known: give a table of them, --properties FILE",)
    later.end((*notes, *law.diagnostics), silent=as_json or latex)


@command
@with_table(*WITH_LAW, training=True)
@LAW_ARGUMENT
@saving(report="the page", default=("report.html",))
@with_cluster
def report(source: Source, law_path: str, save: tuple[str, ...], cluster: str | None) -> None:
    """Write a report on LAW.json and how it forecasts TABLE.

    The report is one self-contained page, also for phones and print: the law, the assessment of its forecasts,
    measurements and forecasts, coefficients, plausible alternatives, the discrepancy, the range of the training data,
    data checks, every choice of the search, and code to repeat it. --hold-out and --learn-until name data that were not
    used for training. For a folder of Parquet files, or a pattern in quotes, all trials are forecast (with --cluster by
    its workers), and the page shows representative objects. `discover --save report.html` discovers a law first.

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
        law, later, guessed = Law.load(law_path), Artifacts(), list[str]()
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
