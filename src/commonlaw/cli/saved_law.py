"""Commands that take a saved law: what it is, how it fits and forecasts a table, and which experiment is next."""

import json
from collections.abc import Sequence
from dataclasses import asdict, replace
from functools import partial
from math import ceil, inf, isfinite
from typing import TYPE_CHECKING, Any, Literal

import click
import numpy as np

from commonlaw.cli.main import command, working
from commonlaw.cli.options import AS_JSON, LAW_ARGUMENT, ReadFile, by_name, is_of_kind, numbers, option, saving
from commonlaw.cli.output import Artifacts, print_frame, print_history, print_json, print_law, print_notes, say
from commonlaw.cli.results import page
from commonlaw.cli.source import WITH_LAW, Source, guesses, on_cluster_at, stream_of, with_cluster, with_table
from commonlaw.errors import CommonlawError
from commonlaw.law import Law, average_law, relations_frame, select_objects, to_json, to_latex
from commonlaw.law.parameters import units_with_rates
from commonlaw.law.text import Written
from commonlaw.runtime.progress import check_memory, part
from commonlaw.text import counted, in_line, number_or_text, r_squared, shown
from commonlaw.trials import Trials
from commonlaw.trials.properties import given_properties
from commonlaw.trials.trial import property_names

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.discrepancy.residual_tests import Pattern


@command
@LAW_ARGUMENT
@option("--latex", "Print LaTeX.", is_flag=True)
@option("--select NAME", "Only this object.", "name")
@option("--average", "The mean of all objects' coefficients.", is_flag=True)
@option("--history", "Every choice on the way to the law, and why.", is_flag=True)
def show(law_path: str, latex: bool, name: str | None, average: bool, history: bool) -> None:
    """Print LAW.json: equations, coefficients and derived quantities with 95 % intervals, range of the data."""
    import pandas as pd

    if name and average:
        raise click.UsageError("give --select or --average, not both")
    law = Law.load(law_path)
    law = select_objects(law, [name]) if name else average_law(law) if average else law
    if not latex:
        print_law(law)
        if law.uncertainty.other_laws:
            say("\nPlausible laws:\n")
            rows = [(share, "; ".join(model.structure)) for share, model in law.models]
            print_frame(pd.DataFrame(rows, columns=["probability", "law"]))
        if law.provenance.domain.visited:
            say("\nRange of the training data (forecasts outside it are extrapolations):\n")
            print_frame(law.provenance.domain.to_frame(units_with_rates(law)))
        if law.provenance.domain.horizon is not None:
            say(f"\n{law.provenance.domain.horizon_sentence(law.schema.units.get(law.schema.time, ''))}")
        if history:
            print_history(law)
        print_notes(law.diagnostics)
        return
    if law.uncertainty.explanation is not None and len(law.objects) > 1:
        say(to_latex(law))
        return
    for label in law.objects:
        say(f"% {in_line(label)}\n{to_latex(law, label)}")


@command
@LAW_ARGUMENT
@option(
    "--property NAMES...",
    "Properties that coefficients may follow, commas between several, '' for none  "
    "[default: all numbers that the law knows of its objects]",
    "names",
)
@option(
    "--properties FILE",
    "A table with the objects' properties, a row for each, if the law does not hold them.",
    "table",
    type=ReadFile(),
)
@saving(law="the law with what decides its coefficients", figure="a figure of coefficients against properties")
@option("--latex", "Print LaTeX.", is_flag=True)
@AS_JSON
def explain(
    law_path: str, names: tuple[str, ...], table: str | None, save: tuple[str, ...], latex: bool, as_json: bool
) -> None:
    """Relate the coefficients of LAW.json to properties of the objects.

    Each coefficient is shared by all objects, a power law of properties (0.25 diameter^2/mass), an affine function of
    properties if signs differ, or object-specific. The evidence decides.

    \b
    Examples:
      commonlaw explain law.json --property diameter,mass
      commonlaw explain law.json --properties balls.csv --save explained.json
    """
    law = Law.load(law_path)
    with working("Explaining ..."):
        if table:
            properties = given_properties(table, law.schema.object, law.objects)
            schema = replace(law.schema, units={**law.schema.units, **properties.units})
            law = replace(law, properties=properties.values, schema=schema)
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
        print_law(law)
        kinds = {"universal": "shared", "own": "object-specific"}
        shown = relations_frame(law).dropna(axis=1, how="all").replace({"kind": kinds})
        say("\nRelations of coefficients to properties:\n")
        print_frame(shown, {"scatter": "SD between objects", "scatter error": "its standard error"})
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
    its workers), and the page shows representative objects. An installed browser prints what is called report.pdf.
    `discover --save report.html` discovers a law first.

    \b
    Examples:
      commonlaw report drops.csv law.json --save drops.html
      commonlaw report chicks.csv law.json --learn-until 14
    """
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
            everything = find_by_stream(law, source.held_out(stream), part(show, 0.0, 1.0), training)
            made = partial(page, everything.few, source.streamed_program(), show, everything)
        else:
            trials = source.load(law.observation.measured)
            guessed += guesses(trials)
            program = source.program(trials) if source.path else ""
            made = partial(page, find(law, trials, source.select(trials)), program, show)
        later.save(save, report=made)
    if not {*save} <= {*later.written}:
        say(str(law))
    later.end(guessed)


class _FirstSamples(click.types.IntParamType):
    """A number of first samples, or ``"all"``."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        return value if value == "all" else super().convert(value, param, ctx)


@command
@with_table(*WITH_LAW)
@LAW_ARGUMENT
@option(
    "--initial-samples N|all",
    "How many first samples of a trial its initial conditions are fitted to: 1 for the first as "
    "measured; all for the fitted curve.  [default: 1; for laws of second order with known noise, as "
    "many as an estimate of the first rate takes; all measured ones where unmeasured rows follow]",
    "start",
    type=_FirstSamples(),
)
@option(
    "--from TIME",
    "Forecast from this time on, with initial conditions fitted to what was measured before, or to the "
    "last N of --initial-samples.",
    "from_time",
    type=float,
)
@option(
    "--until TIME", "Forecast until this time, beyond the measurements or without the samples after it.", type=float
)
@option("--step", "Step of these times.  [default: a hundredth]", type=click.FloatRange(0, min_open=True))
@option(
    "--input-interpolation",
    "Inputs between samples: held at the earlier value, as a controller does, on lines, on a cubic spline, or "
    "on splines between jumps at unknown times.  [default: as the law was learned]",
    type=click.Choice(["held", "linear", "cubic", "jumps"]),
)
@option("--discrepancy", "Forecast with the discrepancy that `discrepancy --save` found.", is_flag=True)
@option("--phase-plane", "Draw the phase plane into the figure: nullclines and fixed points.", is_flag=True)
@saving(
    table="measured and forecast states; of several files the errors of each trial", figure="a figure of the forecasts"
)
@option(
    "--folder FOLDER",
    "Of a folder or a pattern of files: write measured and forecast states, a Parquet file for each file.",
    type=click.Path(file_okay=False),
)
@AS_JSON
@with_cluster
def predict(
    source: Source,
    law_path: str,
    until: float | None,
    step: float | None,
    phase_plane: bool,
    save: tuple[str, ...],
    folder: str | None,
    as_json: bool,
    cluster: str | None,
    **how: Any,
) -> None:
    """Forecast the trials in TABLE with LAW.json, each from its initial state.

    Columns are found by the names that the law was learned with; a schema names others. Rows without states
    after the measured ones are forecast. Where the law knows how accurate it is, the table that is written has the ends
    of 95 % bands, for the state itself (low, high) and for a measurement of it, with its noise (measured low, measured
    high); the figure shows the bands of measurements. Objects that the law does not know have the coefficients that
    follow from their properties, if it was explained, else the mean ones of the others.

    \b
    Example:
      commonlaw predict drops.csv law.json --save forecast.csv --save forecast.png
      commonlaw predict drops.csv law.json --until 30 --step 0.1 --save forecast.csv
      commonlaw predict lynx.csv law.json --from 1920 --save forecast.png
      commonlaw predict pairs.csv law.json --initial-samples all --phase-plane --save plane.svg
      commonlaw predict 'runs/*.parquet' law.json --folder forecasts --save errors.parquet --cluster local:4
    """
    from commonlaw.law.tables import quantile_frame
    from commonlaw.stream import forecast_stream

    law = Law.load(law_path)
    if cluster or source.is_stream:
        given: dict[str, object] = {f"--save {file}": file for file in save if not is_of_kind(file, "table")}
        given |= {"--discrepancy": how.pop("discrepancy"), "--input-interpolation": how.pop("input_interpolation")}
        given |= {"--phase-plane": phase_plane, "--until": until, "--step": step}
        source.check_streams(given)
        later = Artifacts()
        with working("Forecasting ...") as show, on_cluster_at(cluster, show):
            stream = source.select(stream_of(source, law.schema))
            errors = forecast_stream(law, stream, folder=folder, progress=show, **how)
            later.save(save, table=lambda: errors)
        finite = errors.replace([np.inf, -np.inf], np.nan)
        if as_json:
            print_json({"errors": finite.to_dict(orient="records")})
        else:
            for state, rows in finite.groupby("state", sort=False):
                known = rows.dropna(subset="rms error")
                if len(known):
                    say(f"Errors of forecasts of {state}, by trial:\n")
                    kinds = ("rms error", "largest error", "last error")
                    print_frame(quantile_frame({name: known[name].to_numpy() for name in kinds}, "trial"))
            worst = errors.sort_values("rms error", ascending=False, kind="stable")[:10]
            say("\nThe worst:\n")
            print_frame(worst.dropna(axis=1, how="all"))
        later.end(silent=as_json)
        return
    if folder:
        raise click.UsageError("--folder is for a folder or a pattern of Parquet files: use --save")
    if phase_plane and not any(is_of_kind(path, "figure") for path in save):
        raise click.UsageError("--phase-plane is drawn into a figure: give a file for it, such as --save plane.png")
    with working("Forecasting ..."):
        trials = source.select(_with_properties(source, law))
        times = _times(trials, how["from_time"], until, step)
        if step is not None and not save:
            raise click.UsageError("--step sets the times in a file: give one, such as --save forecast.csv")
        trials = trials if until is None else _ended(trials, until)
        forecast = law.predict(trials, times=times, return_std=bool(save) and law.uncertainty.has_std, **how)
        errors, begin = forecast.errors(), forecast.title.removeprefix("forecast ")

        def figure(plots: Any) -> Any:
            return plots.plot_phase_plane(law, forecast) if phase_plane else plots.plot_forecast(forecast)

        later = Artifacts()
        later.save(save, table=forecast.to_frame, figure=figure)
    if as_json:
        print_json({"score": forecast.score(), "errors": errors.to_dict(orient="records")})
    else:
        say(f"{counted(len(forecast.trials), 'forecast')}, {begin}: {r_squared(forecast.score())}\n")
        print_frame(errors.dropna(axis=1, how="all"))
    later.end((*forecast.trials.notes, *forecast.outcomes), silent=as_json)


def _with_properties(source: Source, law: "Law") -> Trials:
    """Return all trials, with the properties that equations, relations and discrepancy take, if the table has them.

    In a table of one object a column that does not change is a property only where one is looked for.
    """
    trials = source.load(law.observation.measured)
    taken = law.uncertainty.explanation.properties if law.uncertainty.explanation else ()
    wider = law.provenance.with_discrepancy or law
    inside = [name for name in wider.terms.variables.parameters if name in property_names(wider.properties)]
    taken = (*taken, *inside, *wider.schema.inputs[len(law.schema.inputs) :])
    known = {name for values in trials.properties.values() for name in values}
    if not source.path or "properties" in source.roles or {*taken} <= known:
        return trials
    try:
        return source.reading(properties=list(taken)).load(law.observation.measured)
    except CommonlawError:  # The table lacks these columns
        return trials


def _ended(trials: Trials, until: float) -> Trials:
    """Return the samples of trials up to a time, with a note on trials that begin later."""
    later = [trial.label for trial in trials if trial.times[0] > until]
    note = f"trials not forecast, as they begin after --until {until:g}: {shown(later)}"
    ended = trials.until(until)
    return ended.with_trials(ended.trials, note) if later else ended


def _times(trials: Trials, first: float | None, until: float | None, step: float | None) -> list[float]:
    """Return the times that ``--until`` and ``--step`` ask for, from the first time on or that of all samples."""
    for name, value in (("--until", until), ("--step", step)):
        if value is not None and not isfinite(value):
            raise CommonlawError("finite-number", name=name, value=value)
    first = min(trial.times[0] for trial in trials) if first is None else first
    last = max(trial.times[-1] for trial in trials)
    span = (last if until is None else until) - first
    if until is not None and span <= 0:
        raise click.UsageError(f"--until {until:g} is not after {first:g}, where forecasts begin: give a later time")
    if until is step is None or span <= 0:
        return []
    step = step or span / 100
    # Bytes of a forecast value, with what is made of it on the way
    size = 200 * span / step * len(trials) * len(trials.schema.states)
    check_memory(f"forecasts at {span / step:.0f} times of {len(trials)} trials", size, "give a larger --step")
    return [first + i * step for i in range(ceil(span / step))] + [first + span]


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
    from commonlaw.law.tables import quantile_frame
    from commonlaw.stream import check_stream

    law = Law.load(law_path)
    later = Artifacts()
    if cluster or source.is_stream:
        source.check_streams({f"--save {file}": is_of_kind(file, "figure") for file in save})
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
            for state, rows in of_files.objects.groupby("state", sort=False):
                say(f"\nResiduals of {state}, by object:\n")
                print_frame(quantile_frame({name: rows[name].to_numpy() for name in columns}, "object"))
            say("\nThe largest:\n")
            print_frame(of_files.objects.sort_values("RMS over noise", ascending=False, kind="stable")[:10])
        later.end(silent=as_json)
        return
    with working("Checking ..."):
        trials = source.chosen(law.observation.measured)
        residuals = law.residuals(trials)
        later.save(save, table=residuals.to_frame, figure=lambda plots: plots.plot_residuals(residuals))
    if as_json:
        print_json({"patterns": _patterns_document(residuals.patterns)})
    else:
        say(f"{residuals}\n")
        print_frame(_readable(residuals.tests()), {"adjusted": "adjusted p-value"})
    later.end(residuals.trials.notes, silent=as_json)


def _readable(tests: "pd.DataFrame") -> "pd.DataFrame":
    """Return a table of tests with as many digits as decide."""
    import pandas as pd

    shown = tests.drop(columns="meaning")
    for name, least in (("statistic", -np.inf), ("p-value", 0.001), ("adjusted", 0.001)):
        texts = [Written(f"< {least:g}" if value < least else f"{value:z.3f}") for value in tests[name]]
        shown[name] = pd.Series(texts, tests.index, dtype=object)
    return shown


def _patterns_document(patterns: "Sequence[Pattern]") -> list[dict[str, object]]:
    return [asdict(pattern) | {"significant": pattern.significant} for pattern in patterns]


@command
@with_table(*WITH_LAW)
@LAW_ARGUMENT
@option(
    "--of COORDINATE",
    "What it is a function of: a state, its rate, an input, time, or an expression of these and of "
    "properties, 'abs(v)*diameter/1.5e-5'.  [default: the variable of largest evidence]",
)
@option("--times TERM", "What the function is multiplied with, 'v*abs(v)/mass'.", default="1")
@option("--equation STATE", "The state in whose equation it is.  [default: by evidence]")
@option(
    "--zero-at VALUE",
    "Where the function is zero, so that the law alone holds there; 'none' for nowhere, auto for zero "
    "where that was visited or nearly.",
    default="auto",
)
@option("--noise STATE=VALUE...", "Known standard deviation of a state's measurement noise  [default: estimated]")
@saving(law="the law with its discrepancy, for predict --discrepancy", figure="a figure of the function and its band")
@AS_JSON
def discrepancy(
    source: Source,
    law_path: str,
    zero_at: str,
    noise: tuple[str, ...],
    save: tuple[str, ...],
    as_json: bool,
    **settings: Any,
) -> None:
    """Estimate what LAW.json leaves unexplained in TABLE, as a smooth function that all objects share.

    The function is fitted together with the coefficients of the law. The evidence decides whether there is a
    discrepancy; a table lists terms that could replace it.

    \b
    Examples:
      commonlaw discrepancy drops.csv law.json --of v --save discrepancy.png
      commonlaw discrepancy drops.csv law.json --of "abs(v)*diameter/1.5e-5" --times "v*abs(v)*diameter^2/mass"
    """
    law = Law.load(law_path)
    with working("Seeking a discrepancy ..."):
        trials = source.chosen(law.observation.measured)
        levels = numbers("--noise", noise) if noise else None
        zero: float | Literal["auto"] | None = None if zero_at == "none" else "auto"
        if zero_at not in ("none", "auto"):
            if isinstance(number := number_or_text(zero_at), str):
                raise CommonlawError("zero-at", text=zero_at)
            zero = number
        estimate = law.discrepancy(trials, **settings, zero_at=zero, noise=levels)
        later = Artifacts()
        later.save(save, law=estimate.law, figure=lambda plots: plots.plot_discrepancy(estimate))
    if as_json:
        frames = {"function": estimate.to_frame(), "terms": estimate.terms_frame()}
        frames["compared"] = estimate.coordinates_frame()
        document = {"claimed": estimate.claimed, "equation": estimate.equation, "coordinate": estimate.basis.coordinate}
        document |= {"times": estimate.basis.times, "evidence": estimate.evidence, "zero at": estimate.zero_at}
        document |= {"holds nothing of": list(estimate.holds_nothing_of), "shares": estimate.shares}
        document |= {name: frame.to_dict(orient="records") for name, frame in frames.items()}
        print_json(document | {"law": json.loads(to_json(estimate.law))})
    else:
        say(str(estimate))
        if estimate.claimed:
            say("")
            print_frame(estimate.to_frame(10))
        if len(estimate.descriptions):
            say("\nTerms in place of the function:\n")
            print_frame(estimate.terms_frame())
        if len(estimate.compared) > 1:
            say("\nCoordinates compared:\n")
            print_frame(estimate.coordinates_frame())
        if estimate.claimed:
            say(f"\nThe law, estimated jointly with it:\n\n{estimate.law}")
    later.end((*trials.notes, *estimate.law.diagnostics), silent=as_json)


@command
@with_table(*WITH_LAW)
@LAW_ARGUMENT
@option("--term TERM...", "A term, v^2  [default: all]", "terms")
@option("--level", "Probability of the bounds and intervals.", type=float, default=0.95)
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

    law = Law.load(law_path)
    with working("Fitting ...") as show:
        trials = source.chosen(law.observation.measured)
        limits = found_by(law, trials, terms or None, level=level, progress=show)
        frame = limits.to_frame()
        later = Artifacts()
        later.save(save, table=lambda: frame)
    if as_json:
        print_json({"bounds": frame.to_dict(orient="records"), "sentences": list(limits.sentences)})
    else:
        say(f"{limits}\n")
        print_frame(frame)
    later.end(trials.notes, silent=as_json)


@command
@with_table(*WITH_LAW, required=False)
@LAW_ARGUMENT
@option(
    "--vary NAME=VALUES...",
    "What can be set: a range x=5..60, a list rate=15,30, or one value; NAME is a state or rate where "
    "trials start, duration, rate, samples, repeats, object (names, or each), object.PROPERTY of a new "
    "object, an input, INPUT.shape or INPUT.period, the amount of a dose, DOSE.at or DOSE.every",
)
@option("--within NAME=RANGE...", "A trial ends where a state leaves this range: x=0..100")
@option(
    "--start-std NAME=STD...",
    "Standard deviation of an initial value about the one that is set, v=0 for an exact one  "
    "[default: estimated from the experiment alone]",
)
@option(
    "--cost NAME=PRICE...",
    "Price of a trial, a sample, a unit of anything that is set, or a trial of an object by its name  "
    "[default: 1 for each trial]",
)
@option("--budget", "What all may cost together.", type=click.FloatRange(0, min_open=True), default=inf)
@option(
    "--at-most", "Experiments; fewer where the law is settled before.", "experiments", type=click.IntRange(1), default=1
)
@option(
    "--for WHAT",
    "What is to be learned: law, coefficients, one of them ('c of Ball 3'), or a forecast ('x at t=10 "
    "from 100').  [default: law, if that is in doubt, else coefficients]",
    "about",
)
@option("--rival LAW.json...", "Another law that is as probable", "rivals", type=ReadFile())
@option("--seed", "Of random numbers.", type=click.IntRange(0), default=0)
@saving(table="a table of the experiments", figure="a figure of what the laws forecast of them")
@AS_JSON
def design(
    source: Source,
    law_path: str,
    vary: tuple[str, ...],
    within: tuple[str, ...],
    start_std: tuple[str, ...],
    cost: tuple[str, ...],
    rivals: tuple[str, ...],
    save: tuple[str, ...],
    as_json: bool,
    **settings: Any,
) -> None:
    """Find the most informative experiment: on which law is right, on its coefficients, or on a quantity of interest.

    Each plausible law predicts the measurements with all errors; differences that refitting would remove do not count.
    With TABLE, settings that are not varied are those of its trials.

    \b
    Examples:
      commonlaw design drops.csv law.json --vary "x=5..60" --vary "duration=1..4" --within "x=0..60"
      commonlaw design law.json --vary x=5..60 --vary v=-10..0 --vary duration=1..6 --vary rate=15..240 --at-most 3
      commonlaw design drops.csv law.json --vary "x=5..60" --for "x at t=10 from 100"
    """
    import commonlaw as cl

    laws = [cl.Law.load(path) for path in (law_path, *rivals)]
    with working("Looking for experiments ...") as show:
        trials = source.chosen(laws[0].observation.measured) if source.path or source.dataset else None
        plan = cl.design(
            laws,
            by_name("--vary", vary),
            trials=trials,
            within=by_name("--within", within),
            start_std=numbers("--start-std", start_std),
            cost=numbers("--cost", cost) if cost else None,
            **settings,
            progress=show,
        )
        later = Artifacts()
        later.save(save, table=plan.to_frame, figure=lambda plots: plots.plot_design(plan))
    if as_json:
        plausible = [{"equations": list(law.law.structure), "probability": law.probability} for law in plan.laws]
        frame = plan.to_frame().assign(text=[experiment.text for experiment in plan.experiments])
        document = {"laws": plausible, "experiments": frame.to_dict(orient="records"), "chance now": plan.chance_now}
        document |= {name: getattr(plan, name) for name in ("chance", "repeats", "cost")}
        print_json(document | {"sentences": list(plan.sentences)})
    else:
        say(str(plan))
    later.end(trials.notes if trials else (), silent=as_json)
