"""`commonlaw show`: print a saved law."""

import click

from commonlaw.cli.command import quick_command
from commonlaw.cli.output import print_frame, print_history, say
from commonlaw.cli.paths import ReadFile
from commonlaw.text import in_line


@quick_command
@click.argument("law_path", metavar="LAW.json", type=ReadFile())
@click.option("--latex", is_flag=True, help="Print LaTeX.")
@click.option("--object", "name", metavar="NAME", help="Only this object.")
@click.option("--average", is_flag=True, help="The mean of all objects' coefficients.")
@click.option("--history", is_flag=True, help="Every choice on the way to the law, and why.")
def show(law_path: str, latex: bool, name: str | None, average: bool, history: bool) -> None:
    """Print the law in LAW.json, and the 95 % intervals of its coefficients where they are known."""
    import pandas as pd

    from commonlaw.law import Law

    if name and average:
        raise click.UsageError("give --object or --average, not both")
    law = Law.load(law_path)
    law = law.select([name]) if name else law.average() if average else law
    if not latex:
        say(str(law))
        if law.uncertainty.covariance is not None:
            averaged = ", averaged over what the law could be" if law.uncertainty.other_laws else ""
            say(f"\nIntervals that hold the coefficients with a probability of 95 %{averaged}:\n")
            print_frame(law.params)
        if law.uncertainty.other_laws:
            say("\nWhat the law could be, and how probable each is:\n")
            rows = [(share, "; ".join(each.structure)) for share, each in law.models]
            print_frame(pd.DataFrame(rows, columns=["probability", "law"]))
        if law.provenance.domain.visited:
            say("\nRanges of what it has learned; nothing tells how good it is beyond:\n")
            print_frame(law.domain())
        if law.provenance.domain.horizon is not None:
            say(f"\n{law.provenance.domain.horizon_sentence(law.schema.units.get(law.schema.time, ''))}")
        if history:
            print_history(law)
        return
    if law.uncertainty.explanation is not None and len(law.objects) > 1:
        say(law.to_latex())
        return
    for each in law.objects:
        say(f"% {in_line(each)}\n{law.to_latex(each)}")
