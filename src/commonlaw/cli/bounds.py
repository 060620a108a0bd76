"""`commonlaw bounds`: how large coefficients of absent terms could be."""

import click

from commonlaw.cli.command import command
from commonlaw.cli.later import LaterSteps
from commonlaw.cli.output import print_frame, print_json, say
from commonlaw.cli.paths import ReadFile, WrittenFile
from commonlaw.cli.source import Source, with_source
from commonlaw.cli.working import working


@command
@click.argument("law_path", metavar="LAW.json", type=ReadFile())
@with_source
@click.option("--term", "terms", metavar="TERM", multiple=True, help="A term, v^2; repeat for more.  [default: all]")
@click.option("--level", type=float, default=0.95, help="Probability of the bounds and intervals.")
@click.option("--save", type=WrittenFile(), metavar="BOUNDS.csv", help="Write the table.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def bounds(
    law_path: str, source: Source, terms: tuple[str, ...], level: float, save: str | None, as_json: bool
) -> None:
    """Say how large coefficients of terms that are not in LAW.json could be, without FILE showing it.

    Each term is fitted beside those of the law. A bound is what the size of the coefficient stays below at 95 %, and
    beside it stands what the term then adds to the equation at most.

    \b
    Examples:
      commonlaw bounds law.json drops.csv
      commonlaw bounds law.json drops.csv --term "v^2" --term "x"
    """
    from commonlaw.inference import bounds as found_by
    from commonlaw.law import Law

    law = Law.load(law_path)
    with working("Fitting ...") as show:
        trials = source.chosen(law.schema)
        found = found_by(law, trials, terms or None, level=level, progress=show)
        frame = found.to_frame()
        later = LaterSteps()
        later.write(save, lambda: frame.to_csv(index=False).encode())
    if as_json:
        print_json({"bounds": frame.to_dict(orient="records"), "sentences": list(found.sentences)})
    else:
        print_frame(frame)
        say(f"\n{found}")
    later.end(trials.notes, silent=as_json)
