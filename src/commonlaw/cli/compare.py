"""`commonlaw compare`: which of several laws the measurements are for."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import click

from commonlaw.cli.command import command
from commonlaw.cli.comparing import compared, load, print_compared
from commonlaw.cli.later import LaterSteps
from commonlaw.cli.methods import with_comparison
from commonlaw.cli.output import print_json, say
from commonlaw.cli.paths import ReadLaw, WrittenFile, is_law_file
from commonlaw.cli.source import Source, with_source
from commonlaw.cli.working import working
from commonlaw.errors import CommonlawError
from commonlaw.runtime.progress import Stage, part

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.law import Law
    from commonlaw.trials import Trials

T = TypeVar("T")


@command
@with_source
@click.argument("laws", nargs=-1, metavar="LAW LAW...", type=ReadLaw())
@with_comparison
@click.option("--save", type=WrittenFile(), metavar="TABLE.csv", help="Write the table.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def compare(source: Source, laws: tuple[str, ...], settings: dict[str, Any], save: str | None, as_json: bool) -> None:
    """Say which of several laws the measurements in FILE are for, and how strongly.

    A LAW is equations as for `commonlaw fit`, or a saved law, LAW.json. The coefficients of all are fitted to the same
    trials under the same noise, so that what is compared is their form. The table has the most probable law first.

    \b
    Examples:
      commonlaw compare drops.csv "x'' = -g" "x'' = -g - c v" "x'' = -g - c v*abs(v)"
      commonlaw compare drops.csv discovered.json "x'' = -9.81 - c v"
      commonlaw compare --dataset linear-drag:noise=0.05 "x'' = -g" "x'' = -g - c v"
    """
    if source.dataset and source.path:
        laws = source.path, *laws
        source = replace(source, path=None)
    if len({*laws}) < max(2, len(laws)):
        raise click.UsageError("give FILE and two laws or more that differ: \"x'' = -g\" \"x'' = -g - c v\"")
    later = LaterSteps()
    with working("Comparing ...") as show:
        training, found = _fitted(source, laws, settings, show)
        show(Stage("comparing evidence", len(laws) / (len(laws) + 1)))
        frame = compared(found, training, settings)
        later.write(save, lambda: frame.to_csv(index=False).encode())
    if as_json:
        print_json({"laws": frame.to_dict(orient="records")})
    else:
        say("\n".join(_sentences(frame)))
        print_compared(frame if any(map(is_law_file, laws)) else frame.drop(columns="equations"))
    later.end(training.notes, silent=as_json)


def _fitted(
    source: Source, laws: tuple[str, ...], settings: dict[str, Any], show: Callable[[str], None]
) -> "tuple[Trials, dict[str, Law]]":
    """Return the trials, and all laws, those in words fitted to these."""
    import commonlaw as cl
    from commonlaw.law.parse import read_equations

    saved = {each: cl.Law.load(each) for each in laws if is_law_file(each)}
    texts = [each for each in laws if each not in saved]
    training = source.select(load(source, texts, saved.values()))
    for each in texts:  # What cannot be read is refused before the others are fitted
        _naming(each, read_equations, training.schema)
    found = {}
    for number, each in enumerate(laws):
        share = part(show, number / (len(laws) + 1), (number + 1) / (len(laws) + 1))
        share(f"fitting {each}")
        found[each] = saved.get(each) or _naming(each, cl.fit, training, **settings, progress=share)
    return training, found


def _naming(law: str, work: Callable[..., T], *given: Any, **settings: Any) -> T:
    """Return what work makes of a law; an error says of which law it is."""
    try:
        return work(law, *given, **settings)
    except CommonlawError as error:
        raise error.at(law) from error


def _sentences(frame: "pd.DataFrame") -> list[str]:
    """Return in words which law is the most probable, and how the others stand to it."""
    first, *others = zip(frame["law"], frame["2 log B"], strict=True)
    words = (
        (2.0, "not distinguishable from it with these data"),
        (6.0, "less probable: positive evidence against it"),
        (10.0, "less probable: strong evidence against it"),
        (float("inf"), "less probable: very strong evidence against it"),
    )
    said = [f"{first[0]} is the most probable of these laws."]
    return said + [f"{name} is {next(text for most, text in words if below <= most)}." for name, below in others]
