"""`commonlaw discover`: from a table to a law."""

from functools import partial
from typing import TYPE_CHECKING

import click

from commonlaw.cli.learned import Learned, Outputs, with_outputs
from commonlaw.cli.methods import with_method
from commonlaw.cli.options import GroupedCommand, numbers, option
from commonlaw.cli.output import working
from commonlaw.cli.source import Source, with_training_source

if TYPE_CHECKING:
    from commonlaw.discovery import AbstractMethod


_law = partial(option, "Law")


@click.command(cls=GroupedCommand)
@with_training_source
@_law(
    "--order",
    type=click.IntRange(0, 2),
    default=1,
    help="Order of the law: 1 for x' = ..., 2 for x'' = ..., 0 for x[k+1] = ...",
)
@_law(
    "--library",
    metavar="SPEC",
    help="Candidate terms: poly:3, fourier:2, terms:1,v,v*abs(v), or sums such as 'poly:2 + fourier:1'.  "
    "[default: poly:3]",
)
@_law(
    "--known",
    metavar="TERM=VALUE",
    multiple=True,
    help="A known coefficient, 1=-9.8; with several states say the equation, x:1=-9.8; repeat for more.",
)
@_law(
    "--universal",
    metavar="TERM",
    multiple=True,
    help="A term with one coefficient for all objects: 1 for gravity; with several states x:1; repeat for more.",
)
@_law(
    "--explain",
    is_flag=True,
    help="Say what in the law is universal, what follows the objects' properties, and what is each object's own.",
)
@with_method
@with_outputs
def discover(
    source: Source,
    order: int,
    library: str | None,
    known: tuple[str, ...],
    universal: tuple[str, ...],
    explain: bool,
    method: "AbstractMethod | None",
    outputs: Outputs,
) -> None:
    """Find the law that the objects in FILE share.

    FILE is a table (CSV, TSV, Parquet, Excel) with one row for each sample. The law is checked by forecasting: the
    trials that --where leaves out or --hold-out names, or if there are none, those that it was learned from.

    \b
    Examples:
      commonlaw discover drops.csv --object ball --trial drop --time t --state height --order 2 \\
          --save law.json --plot law.png
      commonlaw discover drops.csv --order 2 --exclude trial=3 --learn-until 1.5
      commonlaw discover drops.csv --order 2 --property diameter --property mass --explain
      commonlaw discover --dataset ball-drops --where trial=1 --order 2 --solver group-stlsq:1.5
    """
    import commonlaw as cl

    with working("Discovering ...") as show:
        trials = source.load()
        training = source.select(trials)
        law = cl.discover(
            training,
            order=order,
            library=library,
            method=method,
            known={_key(name): value for name, value in numbers("--known", known).items()},
            universal=[_key(name) for name in universal],
            progress=show,
        )
        if explain:
            show("explaining coefficients")
            law = law.explain()
        learned = Learned.check(law, source, trials, training, bands=bool(outputs.plot))
    outputs.give(learned)


def _key(name: str) -> str | tuple[str, str]:
    """Return a term, or state and term of ``state:term``."""
    state, colon, term = name.partition(":")
    return (state, term) if colon else name
