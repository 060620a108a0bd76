"""Commands that learn laws from tables, and the list of named models."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import click

from commonlaw.cli.batch import Batch, give, with_batch
from commonlaw.cli.main import command, working
from commonlaw.cli.options import (
    AS_JSON,
    LAW_ARGUMENT,
    ReadLaw,
    by_name,
    is_of_kind,
    numbers,
    option,
    saving,
)
from commonlaw.cli.output import Artifacts, print_json, print_law, say
from commonlaw.cli.question import Question, with_question, with_settings
from commonlaw.cli.results import FitResult, Outputs, compared, find_law, load, over_table, print_compared, with_outputs
from commonlaw.cli.source import WITH_LAW, WITHOUT_LAW, Source, on_cluster_at, stream_of, with_cluster, with_table
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.law.models import named_models
from commonlaw.law.restrictions import ALL
from commonlaw.runtime.progress import Stage, part
from commonlaw.text import number_or_text
from commonlaw.trials.transformations import without_notes_on
from commonlaw.trials.trial import property_names


@command
@with_table(*WITHOUT_LAW, "states", "inputs", "properties", "exclude", training=True)
@with_question
@with_outputs
@with_batch
@with_cluster
def discover(source: Source, question: Question, outputs: Outputs, batch: Batch, cluster: str | None) -> None:
    """Discover the law that the objects in TABLE share.

    TABLE has one row for each sample (CSV, TSV, Parquet, Excel). Several tables, or a folder of them, are read as
    one, and named after objects and trials: golf_1.csv, golf_2.csv, tennis_1.csv. The law is checked by forecasts of
    the trials that --hold-out names or --where leaves out, or if there are none, of its training data. Parquet files
    in a folder or a quoted pattern are streamed one by one, with --cluster by its workers.

    \b
    Examples:
      commonlaw discover drops.csv --object ball --trial drop --time t --state height --order 2 \\
          --save law.json --save law.png --save report.html
      commonlaw discover drops.csv --schema drops.toml --order 2 --exclude trial=3 --learn-until 1.5
      commonlaw discover drops/*.csv --save report.html
      commonlaw discover monday.csv tuesday.csv --each --order 2 --save results.csv
      commonlaw discover 'runs/*.parquet' --object car --trial run --time t --state x --cluster tcp://host:8786
      commonlaw discover dataset:ball-drops --where trial=1 --order 2 --set solver=group-stlsq:1.5
    """
    if not batch.each:
        source = replace(source, more=batch.more)
    streams = bool(cluster) or source.is_stream
    batch.check(source, question, outputs, cluster)
    if streams and not batch.each:
        source.check_streams()
    with working("Discovering ...") as show, on_cluster_at(cluster, show):
        if batch.each:
            results = batch.run(source, question, show)
        else:
            learned, later = find_law(source, outputs, show, streams, question.answer, question.explained)
    if batch.each:
        give(results, outputs.save)
    else:
        outputs.give(learned, later)


@command
@with_table(*WITHOUT_LAW, "states", "inputs", "exclude", training=True)
@click.argument("equations", required=False, metavar="EQUATIONS")
@option(
    "--initial-value STATE=VALUE...",
    "Initial value of a state, at time 0 of each trial: a number, a property of the objects, "
    "depot=dose, a parameter, x=x0, or depot=free to estimate it",
    "initial_values",
    group="Law",
    everyday=True,
)
@option(
    "--initial-time TIME",
    "Time of these initial values, and of those in equations, x(0) = 1; first for that of the first sample of each "
    "trial  [default: 0]",
    "initial_time",
    group="Law",
)
@option(
    "--dose COLUMN...",
    'An input that holds amounts which are added at once, at the times of their rows, "c\' = -k c + dose/V"',
    "doses",
    group="Law",
)
@option(
    "--shared PARAMETER[=COLUMN]...",
    "A coefficient of the equations that all objects have in common, k, or objects and trials with one "
    "value of a column, k=strain; k=trial is one for each trial",
    group="Law",
    everyday=True,
)
@option(
    "--guess PARAMETER=VALUE...",
    "Initial guess of a nonlinear parameter, a frequency w=0.3  [default: a grid of values]",
    "guesses",
    group="Law",
)
@with_settings("fit")
@with_outputs
@with_cluster
def fit(
    source: Source,
    equations: str,
    initial_values: tuple[str, ...],
    initial_time: str | None,
    doses: tuple[str, ...],
    shared: tuple[str, ...],
    guesses: tuple[str, ...],
    settings: dict[str, Any],
    outputs: Outputs,
    cluster: str | None,
) -> None:
    """Fit given equations to the trials in TABLE.

    EQUATIONS has one for each state, between semicolons: "T' = a + b T", "x'' = -9.81 - c v", "dH/dt = a H - b H P;
    dP/dt = c H P - d P", "s' = -V s/(K + s)". Letters are parameters to be estimated, numbers are fixed; v is
    the rate of x. By default, columns with an equation are states, and others that occur are inputs. Observation
    equations, initial values, events and bounds may follow. In place of equations, the name of a model that `commonlaw
    models` lists: logistic. Forecasts are checked as by `commonlaw discover`. With --cluster Parquet files are fitted
    one by one.

    \b
    Examples:
      commonlaw fit cups.csv "T' = -k (T - 20)" --save law.json
      commonlaw fit enzymes.csv "s' = -V s/(K + s)"
      commonlaw fit mice.csv logistic:x=weight
      commonlaw fit doses.csv "d' = -a d; c' = b d - k c" --initial-value d=dose
      commonlaw fit cells.csv "x' = -k x; signal = c x (1 + x); x(0) = 1"
      commonlaw fit ball.csv "x'' = -g; x < 0: x = 0, v = -c v"
      commonlaw fit dataset:linear-drag:noise=0.05 "x'' = -g - c v"
    """
    import commonlaw as cl

    if cluster:
        alone = {"--initial-value": initial_values, "--initial-time": initial_time, "--dose": doses}
        source.check_streams(alone | {"--shared": shared, "--guess": guesses})
        with working("Fitting ...") as show, on_cluster_at(cluster, show):
            outcome = find_law(
                source, outputs, show, True, lambda trials, tell: cl.fit(equations, trials, **settings, progress=tell)
            )
        outputs.give(*outcome)
        return
    with working("Fitting ...") as show:
        equations, of_model = over_table(source, equations)
        doses = doses or of_model
        if doses:
            source = source.reading(inputs=tuple(dict.fromkeys((*source.roles.get("inputs", ()), *doses))))
        later = Artifacts()
        known = {name: number_or_text(value) for name, value in by_name("--initial-value", initial_values).items()}
        groups = {name: by or ALL for name, _, by in (group.partition("=") for group in shared)}
        trials = without_notes_on(doses, load(source, [equations], (), known, groups.values(), bool(doses)))
        training = source.select(trials)
        origin = None if initial_time is None else number_or_text(initial_time)
        settings |= {"initial_time": origin, "doses": doses, "guesses": numbers("--guess", guesses) or None}
        settings["shared"] = groups
        law = cl.fit(equations, training, initial_values=known, **settings, progress=show)
        later.save(outputs.save, law=law)
        learned = FitResult.check(law, source, trials, training, outputs.draws, later)
    outputs.give(learned, later)


_GRADES = (
    (2.0, "Not distinguishable from it with these data"),
    (6.0, "Positive evidence against"),
    (10.0, "Strong evidence against"),
    (float("inf"), "Very strong evidence against"),
)
"""Of 2 log B, up to which (Kass and Raftery 1995)."""


@command
@with_table(*WITHOUT_LAW)
@click.argument("laws", nargs=-1, metavar="LAW LAW...", type=ReadLaw())
@with_settings("fit")
@saving(table="the table")
@AS_JSON
def compare(
    source: Source, laws: tuple[str, ...], settings: dict[str, Any], save: tuple[str, ...], as_json: bool
) -> None:
    """Compare laws by their evidence in TABLE.

    A LAW is equations as for `commonlaw fit`, or a saved law, LAW.json. All coefficients are fitted to the same
    trials under the same noise, so that only the equations differ. The most probable law comes first.
    Saved laws keep their observation equations, shared parameters and bounds.

    \b
    Examples:
      commonlaw compare drops.csv "x'' = -g" "x'' = -g - c v" "x'' = -g - c v*abs(v)"
      commonlaw compare drops.csv discovered.json "x'' = -9.81 - c v"
      commonlaw compare dataset:linear-drag:noise=0.05 "x'' = -g" "x'' = -g - c v"
      commonlaw compare cells.csv "x' = -k x; signal = c x; x(0) = 1" "x' = -k x^2; signal = c x; x(0) = 1"
    """
    import commonlaw as cl
    from commonlaw.estimation.doses import with_doses_in_equations
    from commonlaw.estimation.model import ModelText, read_model
    from commonlaw.inference.verbs.comparison import outcomes_of_scale
    from commonlaw.law.alignment import without_strange
    from commonlaw.law.parse import read_equations

    if len({*laws}) < max(2, len(laws)):
        raise click.UsageError("give TABLE and two laws or more that differ: \"x'' = -g\" \"x'' = -g - c v\"")
    later = Artifacts()
    with working("Comparing ...") as show:
        saved = {law: cl.Law.load(law) for law in laws if is_of_kind(law, "law")}
        texts = {law: over_table(source, law)[0] for law in laws if law not in saved}
        training = source.select(load(source, [*texts.values()], saved.values()))
        for compared_law in saved.values():
            training = without_strange(compared_law, training)
        for text in texts.values():  # What cannot be read is refused before the others are fitted
            with _naming(text):
                written, dosed = with_doses_in_equations(text, training)
                if not ((model := ModelText.of(written)).beyond_equations or dosed.schema.doses):
                    read_equations(written, dosed.schema)
                else:
                    read_model(model, dosed.schema, property_names(training.properties))
        fitted = {}
        for number, law in enumerate(laws):
            share = part(show, number / (len(laws) + 1), (number + 1) / (len(laws) + 1))
            share(f"fitting {law}")
            with _naming(texts.get(law, law)):
                fitted[law] = saved.get(law) or cl.fit(texts[law], training, **settings, progress=share)
        show(Stage("comparing evidence", len(laws) / (len(laws) + 1)))
        frame = compared(fitted, training, settings)
        later.save(save, table=lambda: frame)
    if as_json:
        print_json({"laws": frame.to_dict(orient="records")})
    else:
        first, *others = zip(frame["law"], frame["2 log B"], strict=True)
        against = dict[str, list[str]]()
        for name, below in others:
            against.setdefault(next(grade for most, grade in _GRADES if below <= most), []).append(name)
        say(f"{first[0]} is the most probable of these laws.")
        for grade, names in against.items():
            say(f"{grade}: {', '.join(names)}.")
        print_compared(frame if any(is_of_kind(law, "law") for law in laws) else frame.drop(columns="equations"))
    later.end((*training.notes, *outcomes_of_scale(fitted, training, **settings)), silent=as_json)


@contextmanager
def _naming(law: str) -> Iterator[None]:
    """Have errors say of which law they are."""
    try:
        yield
    except CommonlawError as error:
        raise error.at(law) from error


@command
@with_table(*WITH_LAW)
@LAW_ARGUMENT
@with_settings("refine")
@saving(law="the law", program="the law as a program or workbook")
@with_cluster
def refine(source: Source, law_path: str, settings: dict[str, Any], save: tuple[str, ...], cluster: str | None) -> None:
    """Refit the coefficients of LAW.json to TABLE.

    They are estimated by maximum likelihood of the trajectories. The terms are fixed; the law gets standard errors.
    With --cluster Parquet files are fitted one by one; their objects need not be in the law.

    \b
    Example:
      commonlaw discover drops.csv --order 2 --set solver=group-stlsq:1.5 --save law.json
      commonlaw refine drops.csv law.json --save refined.json
      commonlaw refine 'runs/*.parquet' law.json --save refined.parquet --cluster local:4
    """
    import commonlaw as cl

    law = cl.Law.load(law_path)
    if cluster:
        source.check_streams()
    with working("Refining ...") as show, on_cluster_at(cluster, show):
        trials = source.select(stream_of(source, law.schema)) if cluster else source.chosen(law.observation.measured)
        law = cl.refine(law, trials, **settings, progress=show)
        later = Artifacts()
        later.save(save, law=law)
    print_law(law)
    later.end((*(trials.notes if isinstance(trials, cl.Trials) else ()), *law.diagnostics))


@command
@click.argument("names", nargs=-1, metavar="[NAME...]")
def models(names: tuple[str, ...]) -> None:
    """List the textbook models that `commonlaw fit` takes by name, or describe some of them.

    \b
    Example:
      commonlaw models logistic
      commonlaw fit mice.csv logistic:x=weight
    """
    for name in names:
        check_choice("named model", name, named_models)
    for name in names:
        model = named_models[name]
        say(f"{name}: {model.title}\n  {model.equations}")
        for symbol, meaning in {**model.variables, **model.parameters}.items():
            say(f"  {symbol}: {meaning}")
        say(f"  source: {model.source}\n")
    if not names:
        width, heading = max(map(len, named_models)), ""
        for model in named_models.values():
            if model.field != heading:
                heading = model.field
                say(f"\n{heading}:")
            say(f"  {model.name:{width}}  {'; '.join(model.without_bounds)}")
