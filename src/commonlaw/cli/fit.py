"""`commonlaw fit`, `compare` and `refine`: laws whose terms are given."""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import click

from commonlaw.cli.artifacts import LaterSteps
from commonlaw.cli.command import command, working
from commonlaw.cli.method_options import with_comparison, with_likelihood
from commonlaw.cli.options import ReadFile, ReadLaw, WrittenFile, by_name, is_law_file, number_or_text, numbers, option
from commonlaw.cli.output import print_history, print_json, say
from commonlaw.cli.results import Learned, Outputs, compared, learned_by_stream, load, print_compared, with_outputs
from commonlaw.cli.source import Source, on_cluster_at, stream_of, with_cluster, with_source, with_training_source
from commonlaw.errors import CommonlawError
from commonlaw.runtime.progress import Stage, part
from commonlaw.trials.transformations import without_notes_on

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.law import Law
    from commonlaw.trials import Trials


@command
@click.argument("equations")
@with_training_source
@option(
    "Table",
    "--start",
    "starts",
    everyday=True,
    metavar="STATE=VALUE",
    multiple=True,
    help="Initial value of a latent state, at the first sample of each trial: a number, a property of the "
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
    everyday=True,
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
    help="Compare the evidence of the fitted law with that of another.",
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


T = TypeVar("T")


@command
@with_source
@click.argument("laws", nargs=-1, metavar="LAW LAW...", type=ReadLaw())
@with_comparison
@click.option("--save", type=WrittenFile(), metavar="TABLE.csv", help="Write the table.")
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def compare(source: Source, laws: tuple[str, ...], settings: dict[str, Any], save: str | None, as_json: bool) -> None:
    """Compare the evidence for several laws in FILE.

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
    """Return in words which law is the most probable, and how strong the evidence against the others is."""
    first, *others = zip(frame["law"], frame["2 log B"], strict=True)
    grades = (
        (2.0, "Not distinguishable from it with these data"),
        (6.0, "Positive evidence against"),
        (10.0, "Strong evidence against"),
        (float("inf"), "Very strong evidence against"),
    )
    found = dict[str, list[str]]()
    for name, below in others:
        found.setdefault(next(grade for most, grade in grades if below <= most), []).append(name)
    said = [f"{first[0]} is the most probable of these laws."]
    return said + [f"{grade}: {', '.join(names)}." for grade, names in found.items()]


@command
@click.argument("law_path", metavar="LAW.json", type=ReadFile())
@with_source
@with_likelihood
@click.option("--save", type=WrittenFile(), metavar="REFINED.json", help="Write the law.")
@click.option("--history", is_flag=True, help="Print every choice on the way to the law, and why.")
@with_cluster
def refine(
    law_path: str, source: Source, settings: dict[str, Any], save: str | None, history: bool, cluster: str | None
) -> None:
    """Fit the coefficients of LAW.json to FILE.

    They become those of maximum likelihood of the trajectories. The terms stay as they are, whatever found them; the
    law gets standard errors. With --cluster Parquet files are fitted one by one; their objects need not be in the law.

    \b
    Example:
      commonlaw discover drops.csv --order 2 --solver group-stlsq:1.5 --save law.json
      commonlaw refine law.json drops.csv --save refined.json
      commonlaw refine law.json 'runs/*.parquet' --save refined.parquet --cluster local:4
    """
    import commonlaw as cl

    law = cl.Law.load(law_path)
    if cluster:
        source.check_streams()
    with working("Refining ...") as show, on_cluster_at(cluster, show):
        trials = source.select(stream_of(source, law.schema)) if cluster else source.chosen(law.schema)
        law = cl.refine(law, trials, **settings, progress=show)
        later = LaterSteps()
        later.write_law(save, law)
    say(str(law))
    if history:
        print_history(law)
    later.end((*(trials.notes if isinstance(trials, cl.Trials) else ()), *law.diagnostics))
