"""`commonlaw fit`: from equations in mind and a table to a law."""

from dataclasses import replace
from typing import Any

import click

from commonlaw.cli.by_stream import learned_by_stream
from commonlaw.cli.command import command
from commonlaw.cli.comparing import compared, load
from commonlaw.cli.later import LaterSteps
from commonlaw.cli.learned import Learned, Outputs, with_outputs
from commonlaw.cli.methods import with_likelihood
from commonlaw.cli.on_cluster import on_cluster_at, with_cluster
from commonlaw.cli.options import by_name, number_or_text, numbers, option
from commonlaw.cli.paths import ReadFile
from commonlaw.cli.source import Source, with_training_source
from commonlaw.cli.working import working
from commonlaw.trials.doses import without_notes_on


@command
@click.argument("equations")
@with_training_source
@option(
    "Table",
    "--start",
    "starts",
    metavar="STATE=VALUE",
    multiple=True,
    help="Where trials start in a state that nobody measured, in their first sample: a number, a property of the "
    "objects, depot=dose, or depot=free for what the measurements are to tell; repeat for more.",
)
@option(
    "Table",
    "--starts-at",
    type=float,
    metavar="TIME",
    help="The time of these starts, if it comes before the first sample of a trial, such as that of an injection.",
)
@option(
    "Table",
    "--dose",
    "doses",
    metavar="COLUMN",
    multiple=True,
    help='An input that holds amounts which are added at once, at the times of their rows, "c\' = -k c + dose/V"; '
    "repeat for more.",
)
@option(
    "Table",
    "--universal",
    metavar="LETTER",
    multiple=True,
    help="A coefficient of the equations that all objects have in common; repeat for more.",
)
@option(
    "Table",
    "--guess",
    "guesses",
    metavar="LETTER=VALUE",
    multiple=True,
    help="Where the fit begins with a constant inside of a term, a frequency w=0.3; repeat for more.  [default: all "
    "values that samples tell apart are tried]",
)
@with_likelihood
@option(
    "Output",
    "--against",
    metavar="LAW.json",
    type=ReadFile(),
    help="Say how the fitted law stands in evidence beside another.",
)
@with_outputs
@with_cluster
def fit(
    equations: str,
    source: Source,
    starts: tuple[str, ...],
    starts_at: float | None,
    doses: tuple[str, ...],
    universal: tuple[str, ...],
    guesses: tuple[str, ...],
    settings: dict[str, Any],
    against: str | None,
    outputs: Outputs,
    cluster: str | None,
) -> None:
    """Fit a law that you have in mind to the trials in FILE.

    EQUATIONS has one for each state, between semicolons: "T' = a + b T", "x'' = -9.81 - c v", "dH/dt = a H - b H P;
    dP/dt = c H P - d P", "s' = -V s/(K + s)". Letters are coefficients and constants to be found, numbers are known;
    v is the rate of x. Unless --state says otherwise, columns with an equation are states, and others that occur are
    inputs. The law is checked like one of `commonlaw discover`. With --cluster Parquet files are fitted one by one.

    \b
    Examples:
      commonlaw fit "T' = -k (T - 20)" cups.csv --save law.json
      commonlaw fit "T' = a + b T" cups.csv --against discovered.json
      commonlaw fit "s' = -V s/(K + s)" enzymes.csv
      commonlaw fit "d' = -a d; c' = b d - k c" doses.csv --start d=dose
      commonlaw fit "x'' = -g - c v" --dataset linear-drag:noise=0.05
    """
    import commonlaw as cl

    if cluster:
        source.check_streams()
        alone = {"--start": starts, "--starts-at": starts_at, "--dose": doses, "--against": against}
        alone |= {"--universal": universal, "--guess": guesses}
        if given := [name for name, value in alone.items() if value]:
            raise click.UsageError(f"{', '.join(given)} with --cluster: leave it out, or fit single files")
        with working("Fitting ...") as show, on_cluster_at(cluster, show):
            found = learned_by_stream(
                source, outputs, show, lambda trials, tell: cl.fit(equations, trials, **settings, progress=tell)
            )
        outputs.give(*found)
        return
    with working("Fitting ...") as show:
        other = cl.Law.load(against) if against else None
        source = replace(source, inputs=tuple(dict.fromkeys((*source.inputs, *doses))))
        later = LaterSteps()
        known = {name: number_or_text(value) for name, value in by_name("--start", starts).items()}
        trials = without_notes_on(doses, load(source, [equations], [other] if other else (), known))
        training = source.select(trials)
        settings |= {"starts_at": starts_at, "doses": doses, "universal": universal}
        settings |= {"guesses": numbers("--guess", guesses) or None}
        law = cl.fit(equations, training, starts=known, **settings, progress=show)
        outputs.keep(law, later)
        learned = Learned.check(law, source, trials, training, bool(outputs.plot), later)
        if against and other:
            laws = {"fitted": law, against: other}
            comparison = later.take("the laws were not compared", lambda: compared(laws, training, settings), None)
            learned = replace(learned, compared=comparison)
    outputs.give(learned, later)
