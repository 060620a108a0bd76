"""`commonlaw check`, `discrepancy` and `bounds`: what a saved law leaves unexplained."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Literal

import click
import numpy as np

from commonlaw.cli.artifacts import Artifacts
from commonlaw.cli.command import command, working
from commonlaw.cli.options import AS_JSON, LAW_ARGUMENT, is_of_kind, numbers, saving
from commonlaw.cli.output import print_frame, print_json, say
from commonlaw.cli.source import WITH_LAW, Source, columns_of, on_cluster_at, stream_of, with_cluster, with_table
from commonlaw.errors import CommonlawError
from commonlaw.law import to_json

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.discrepancy.residual_tests import Pattern


@command
@with_table(*WITH_LAW)
@LAW_ARGUMENT
@saving(
    table="measured and fitted states, and residuals over noise; of several files a row for each object and state",
    figure="a figure of the residuals",
)
@AS_JSON
@with_cluster
def check(source: Source, law_path: str, save: tuple[str, ...], as_json: bool, cluster: str | None) -> None:
    """Check how well LAW.json fits TABLE: test the residuals for patterns.

    The initial condition of each trial is fitted, the coefficients are fixed. The residuals are compared with the
    noise, and tested for trends with time, states, rates and inputs, autocorrelation, heteroscedasticity and
    non-normality. For a folder of Parquet files, or a pattern in quotes, all trials are tested together, and objects
    whose residuals exceed the noise are named.

    \b
    Example:
      commonlaw check drops.csv law.json --save residuals.png
      commonlaw check 'runs/*.parquet' law.parquet --save objects.csv --cluster local:4
    """
    from commonlaw.law import Law
    from commonlaw.law.tables import letter_values
    from commonlaw.stream import check_stream

    law = Law.load(law_path)
    later = Artifacts()
    if cluster or source.is_stream:
        source.check_streams()
        if figures := [each for each in save if is_of_kind(each, "figure")]:
            raise click.UsageError(f"--save {figures[0]} with a stream of files: leave it out, or check single files")
        with working("Checking ...") as show, on_cluster_at(cluster, show):
            of_files = check_stream(law, source.select(stream_of(source, law.schema)), progress=show)
            later.save(save, table=lambda: of_files.objects)
        if as_json:
            objects = of_files.objects.to_dict(orient="records")
            print_json({"patterns": _patterns_document(of_files.patterns), "objects": objects})
        else:
            say(f"{of_files}\n")
            print_frame(_readable(of_files.tests()), {"adjusted": "adjusted p-value"})
            columns = ("RMS over noise", "autocorrelation")
            for state, own in of_files.objects.groupby("state", sort=False):
                say(f"\nResiduals of {state}, by object:\n")
                print_frame(letter_values({name: own[name].to_numpy() for name in columns}, "object"))
            say("\nThe largest:\n")
            largest = of_files.objects.sort_values("RMS over noise", ascending=False, kind="stable")
            print_frame(largest[:10])
        later.end(silent=as_json)
        return
    with working("Checking ..."):
        trials = source.chosen(columns_of(law))
        found = law.residuals(trials)
        later.save(save, table=found.to_frame, figure=lambda plots: plots.plot_residuals(found))
    if as_json:
        print_json({"patterns": _patterns_document(found.patterns)})
    else:
        say(f"{found}\n")
        print_frame(_readable(found.tests()), {"adjusted": "adjusted p-value"})
    later.end(found.trials.notes, silent=as_json)


def _readable(tests: "pd.DataFrame") -> "pd.DataFrame":
    """Return a table of tests with as many digits as decide."""
    import pandas as pd

    from commonlaw.law.text import Written

    shown = tests.drop(columns="meaning")
    for name, least in (("statistic", -np.inf), ("p-value", 0.001), ("adjusted", 0.001)):
        texts = [Written(f"< {least:g}" if each < least else f"{each:z.3f}") for each in tests[name]]
        shown[name] = pd.Series(texts, tests.index, dtype=object)
    return shown


def _patterns_document(patterns: "Sequence[Pattern]") -> list[dict[str, object]]:
    return [asdict(pattern) | {"significant": pattern.significant} for pattern in patterns]


@command
@with_table(*WITH_LAW)
@LAW_ARGUMENT
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
@saving(law="the law with its discrepancy, for predict --discrepancy", figure="a figure of the function and its band")
@AS_JSON
def discrepancy(
    source: Source,
    law_path: str,
    of: str | None,
    times: str,
    equation: str | None,
    zero_at: str,
    noise: tuple[str, ...],
    save: tuple[str, ...],
    as_json: bool,
) -> None:
    """Estimate what LAW.json leaves unexplained in TABLE, as a smooth function that all objects share.

    The function is fitted together with the coefficients of the law. The evidence decides whether there is a
    discrepancy; a table lists terms that could replace it.

    \b
    Examples:
      commonlaw discrepancy drops.csv law.json --of v --save discrepancy.png
      commonlaw discrepancy drops.csv law.json --of "abs(v)*diameter/1.5e-5" --times "v*abs(v)*diameter^2/mass"
    """
    from commonlaw.law import Law

    law = Law.load(law_path)
    with working("Seeking a discrepancy ..."):
        trials = source.chosen(columns_of(law))
        levels = numbers("--noise", noise) if noise else None
        found = law.discrepancy(trials, of, times=times, equation=equation, zero_at=_zero(zero_at), noise=levels)
        later = Artifacts()
        later.save(save, law=found.law, figure=lambda plots: plots.plot_discrepancy(found))
    if as_json:
        frames = {"function": found.to_frame(), "terms": found.terms_frame(), "compared": found.coordinates_frame()}
        print_json(
            {
                "claimed": found.claimed,
                "equation": found.equation,
                "coordinate": found.basis.coordinate,
                "times": found.basis.times,
                "evidence": found.evidence,
                "zero at": found.zero_at,
                "holds nothing of": list(found.holds_nothing_of),
                "shares": found.shares,
                **{name: frame.to_dict(orient="records") for name, frame in frames.items()},
                "law": json.loads(to_json(found.law)),
            }
        )
    else:
        say(str(found))
        if found.claimed:
            say("")
            print_frame(found.to_frame(10))
        if len(found.descriptions):
            say("\nTerms in place of the function:\n")
            print_frame(found.terms_frame())
        if len(found.compared) > 1:
            say("\nCoordinates compared:\n")
            print_frame(found.coordinates_frame())
        if found.claimed:
            say(f"\nThe law, estimated jointly with it:\n\n{found.law}")
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


@command
@with_table(*WITH_LAW)
@LAW_ARGUMENT
@click.option("--term", "terms", metavar="TERM", multiple=True, help="A term, v^2; repeat for more.  [default: all]")
@click.option("--level", type=float, default=0.95, help="Probability of the bounds and intervals.")
@saving(table="the table")
@AS_JSON
def bounds(
    source: Source, law_path: str, terms: tuple[str, ...], level: float, save: tuple[str, ...], as_json: bool
) -> None:
    """Limit the coefficients of terms that are not in LAW.json by TABLE.

    Each term is fitted together with those of the law. The limit is the 95 % upper limit of the absolute value of its
    coefficient; the contribution is the largest that the term then makes to the equation.

    \b
    Examples:
      commonlaw bounds drops.csv law.json
      commonlaw bounds drops.csv law.json --term "v^2" --term "x"
    """
    from commonlaw.inference import bounds as found_by
    from commonlaw.law import Law

    law = Law.load(law_path)
    with working("Fitting ...") as show:
        trials = source.chosen(columns_of(law))
        found = found_by(law, trials, terms or None, level=level, progress=show)
        frame = found.to_frame()
        later = Artifacts()
        later.save(save, table=lambda: frame)
    if as_json:
        print_json({"bounds": frame.to_dict(orient="records"), "sentences": list(found.sentences)})
    else:
        say(f"{found}\n")
        print_frame(frame)
    later.end(trials.notes, silent=as_json)
