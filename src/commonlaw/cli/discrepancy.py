"""`commonlaw discrepancy`: what a saved law leaves unexplained, as a function that objects share."""

import json
from typing import TYPE_CHECKING, Literal

import click

from commonlaw.cli.command import command
from commonlaw.cli.later import LaterSteps
from commonlaw.cli.options import numbers
from commonlaw.cli.output import print_frame, print_json, say
from commonlaw.cli.paths import ReadFile, WrittenFigure, WrittenFile
from commonlaw.cli.source import Source, with_source
from commonlaw.cli.working import working
from commonlaw.errors import CommonlawError

if TYPE_CHECKING:
    from commonlaw.discrepancy.function import Discrepancy
    from commonlaw.law import Law


@command
@click.argument("law_path", metavar="LAW.json", type=ReadFile())
@with_source
@click.option(
    "--of",
    metavar="COORDINATE",
    help="What it is a function of: a state, its rate, an input, time, or an expression of these and of properties, "
    "'abs(v)*diameter/1.5e-5'.  [default: the variable of largest evidence]",
)
@click.option("--times", metavar="TERM", default="1", help="What the function is multiplied with, 'v*abs(v)/mass'.")
@click.option("--equation", metavar="STATE", help="The state in whose equation it is.  [default: by evidence]")
@click.option(
    "--zero-at",
    metavar="VALUE",
    default="auto",
    help="Where the function is zero, so that the law alone holds there; 'none' for nowhere, auto for zero where that "
    "was visited or nearly.",
)
@click.option(
    "--noise",
    metavar="STATE=VALUE",
    multiple=True,
    help="Known standard deviation of a state's measurement noise; repeat for each state.  [default: estimated]",
)
@click.option(
    "--save",
    type=WrittenFile(),
    metavar="WITH.json",
    help="Write the law with its discrepancy, for predict --discrepancy.",
)
@click.option(
    "--plot",
    type=WrittenFigure(),
    metavar="FIGURE",
    help="Write a figure of the function and its band (.png, .svg, .pdf).",
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def discrepancy(
    law_path: str,
    source: Source,
    of: str | None,
    times: str,
    equation: str | None,
    zero_at: str,
    noise: tuple[str, ...],
    save: str | None,
    plot: str | None,
    as_json: bool,
) -> None:
    """Find what LAW.json leaves unexplained in FILE, as a smooth function that all objects share.

    The function is fitted together with the law's coefficients. Evidence says whether there is any; a table says which
    terms would do the same.

    \b
    Examples:
      commonlaw discrepancy law.json drops.csv --of v --plot discrepancy.png
      commonlaw discrepancy law.json drops.csv --of "abs(v)*diameter/1.5e-5" --times "v*abs(v)*diameter^2/mass"
    """
    from commonlaw.law import Law

    law = Law.load(law_path)
    with working("Seeking a discrepancy ..."):
        trials = source.chosen(law.schema)
        levels = numbers("--noise", noise) if noise else None
        found = law.discrepancy(trials, of, times=times, equation=equation, zero_at=_zero(zero_at), noise=levels)
        later = LaterSteps()
        later.write_law(save, found.law)
        later.draw(plot, lambda plots: plots.plot_discrepancy(found))
    if as_json:
        print_json(_document(found))
    else:
        _show(found)
    later.end((*trials.notes, *found.law.diagnostics), silent=as_json)


def _zero(text: str) -> float | Literal["auto"] | None:
    if text == "auto":
        return "auto"
    if text == "none":
        return None
    try:
        return float(text)
    except ValueError:
        raise CommonlawError("zero-at", text=text) from None


def _show(found: "Discrepancy[Law]") -> None:
    say(f"{found}\n")
    print_frame(found.to_frame(10))
    say("\nTerms that would say the same, and 2 log B for each against the smooth function:\n")
    print_frame(found.terms_frame())
    if len(found.compared) > 1:
        say("\nFunctions of these were compared, 2 log B against the law alone:\n")
        print_frame(found.coordinates_frame())
    say(f"\nThe law beside it:\n\n{found.law}")


def _document(found: "Discrepancy[Law]") -> dict[str, object]:
    frames = {"function": found.to_frame(), "terms": found.terms_frame(), "compared": found.coordinates_frame()}
    return {
        "claimed": found.claimed,
        "equation": found.equation,
        "coordinate": found.basis.coordinate,
        "times": found.basis.times,
        "evidence": found.evidence,
        "zero at": found.zero_at,
        "holds nothing of": list(found.holds_nothing_of),
        "shares": found.shares,
        **{name: frame.to_dict(orient="records") for name, frame in frames.items()},
        "law": json.loads(found.law.to_json()),
    }
