"""`commonlaw predict`: forecast trials with a saved law."""

from contextlib import suppress
from math import ceil, isfinite
from typing import TYPE_CHECKING, Any, Literal

import click
import numpy as np

from commonlaw.cli.artifacts import Artifacts
from commonlaw.cli.command import command, working
from commonlaw.cli.options import AS_JSON, LAW_ARGUMENT, is_of_kind, saving
from commonlaw.cli.output import print_frame, print_json, say
from commonlaw.cli.source import WITH_LAW, Source, columns_of, on_cluster_at, stream_of, with_cluster, with_table
from commonlaw.errors import CommonlawError
from commonlaw.runtime.progress import check_memory
from commonlaw.text import counted, r_squared
from commonlaw.trials import Trials
from commonlaw.trials.trial import property_names

if TYPE_CHECKING:
    from commonlaw.law import Law


class _FirstSamples(click.types.IntParamType):
    """A number of first samples, or all."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return a number, or ``"all"``."""
        return value if value == "all" else super().convert(value, param, ctx)


@command
@with_table(*WITH_LAW)
@LAW_ARGUMENT
@click.option(
    "--initial-samples",
    "start",
    type=_FirstSamples(),
    metavar="N|all",
    help="How many first samples of a trial its initial conditions are fitted to: 1 for the first as measured; "
    "all for the fitted curve.  [default: 1; for laws of second order with known noise, as many as an estimate of the "
    "first rate takes; all measured ones where unmeasured rows follow]",
)
@click.option(
    "--from",
    "from_time",
    type=float,
    metavar="TIME",
    help="Forecast from this time on, with initial conditions fitted to what was measured before, or to the last N of "
    "--initial-samples.",
)
@click.option("--until", type=float, metavar="TIME", help="Forecast until this time, beyond the measurements.")
@click.option("--step", type=click.FloatRange(0, min_open=True), help="Step of these times.  [default: a hundredth]")
@click.option(
    "--input-interpolation",
    type=click.Choice(["held", "linear", "cubic"]),
    help="Inputs between samples: held at the earlier value, as a controller does, on lines, or on a cubic spline.  "
    "[default: as the law was learned]",
)
@click.option("--discrepancy", is_flag=True, help="Forecast with the discrepancy that `discrepancy --save` found.")
@click.option("--phase-plane", is_flag=True, help="Draw the phase plane into the figure: nullclines and fixed points.")
@saving(
    table="measured and forecast states; of several files the errors of each trial", figure="a figure of the forecasts"
)
@click.option(
    "--folder",
    type=click.Path(file_okay=False),
    metavar="FOLDER",
    help="Of a folder or a pattern of files: write measured and forecast states, a Parquet file for each file.",
)
@AS_JSON
@with_cluster
def predict(
    source: Source,
    law_path: str,
    start: int | Literal["all"] | None,
    from_time: float | None,
    input_interpolation: str | None,
    discrepancy: bool,
    phase_plane: bool,
    save: tuple[str, ...],
    folder: str | None,
    as_json: bool,
    cluster: str | None,
    **grid: float,
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
    from commonlaw.law import Law
    from commonlaw.law.alignment import has_bands
    from commonlaw.law.tables import letter_values
    from commonlaw.stream import forecast_stream

    law = Law.load(law_path)
    if cluster or source.is_stream:
        given: dict[str, object] = {f"--save {each}": each for each in save if not is_of_kind(each, "table")}
        given |= {"--discrepancy": discrepancy, "--input-interpolation": input_interpolation}
        given |= {"--phase-plane": phase_plane, "--until": grid["until"], "--step": grid["step"]}
        source.check_streams()
        if refused := [name for name, value in given.items() if value]:
            names = ", ".join(refused)
            raise click.UsageError(f"{names} with a stream of files: leave it out, or forecast single files")
        later = Artifacts()
        with working("Forecasting ...") as show, on_cluster_at(cluster, show):
            stream = source.select(stream_of(source, law.schema))
            how: dict[str, Any] = {"start": start, "from_time": from_time}
            errors = forecast_stream(law, stream, folder=folder, progress=show, **how)
            later.save(save, table=lambda: errors)
        finite = errors.replace([np.inf, -np.inf], np.nan)
        if as_json:
            print_json({"errors": finite.to_dict(orient="records")})
        else:
            for state, own in finite.groupby("state", sort=False):
                known = own.dropna(subset="rms error")
                if len(known):
                    say(f"Errors of forecasts of {state}, by trial:\n")
                    kinds = ("rms error", "largest error", "last error")
                    print_frame(letter_values({name: known[name].to_numpy() for name in kinds}, "trial"))
            worst = errors.sort_values("rms error", ascending=False, kind="stable")[:10]
            say("\nThe worst:\n")
            print_frame(worst.dropna(axis=1, how="all"))
        later.end(silent=as_json)
        return
    if folder:
        raise click.UsageError("--folder is for a folder or a pattern of Parquet files: use --save")
    with working("Forecasting ..."):
        trials = source.select(_with_properties(source, law))
        return_std = bool(save) and has_bands(law)
        times = _times(trials, from_time, **grid)
        forecast = law.predict(
            trials,
            times=times,
            start=start,
            from_time=from_time,
            return_std=return_std,
            input_interpolation=input_interpolation,
            discrepancy=discrepancy,
        )
        errors, begin = forecast.errors(), forecast.title.removeprefix("forecast ")
        later = Artifacts()
        later.save(
            save,
            table=forecast.to_frame,
            figure=lambda plots: (
                plots.plot_phase_plane(law, forecast) if phase_plane else plots.plot_forecast(forecast)
            ),
        )
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
    trials = source.load(columns_of(law))
    taken = law.uncertainty.explanation.properties if law.uncertainty.explanation else ()
    wider = law.provenance.with_discrepancy or law
    inside = [name for name in wider.terms.variables.parameters if name in property_names(wider.properties)]
    taken = (*taken, *inside, *wider.schema.inputs[len(law.schema.inputs) :])
    known = {name for values in trials.properties.values() for name in values}
    if source.path and "properties" not in source.roles and not {*taken} <= known:
        with suppress(CommonlawError):
            return source.reading(properties=list(taken)).load(columns_of(law))
    return trials


def _times(trials: Trials, first: float | None, until: float | None, step: float | None) -> list[float]:
    """Return the times that ``--until`` and ``--step`` ask for, from the first time on or that of all samples."""
    for name, value in (("--until", until), ("--step", step)):
        if value is not None and not isfinite(value):
            raise CommonlawError("finite-number", name=name, value=value)
    first = min(trial.times[0] for trial in trials) if first is None else first
    last = max(trial.times[-1] for trial in trials)
    span = (last if until is None else until) - first
    if until is step is None or span <= 0:
        return []
    step = step or span / 100
    # Bytes of a forecast value, with what is made of it on the way
    size = 200 * span / step * len(trials) * len(trials.schema.states)
    check_memory(f"forecasts at {span / step:.0f} times of {len(trials)} trials", size, "give a larger --step")
    return [first + i * step for i in range(ceil(span / step))] + [first + span]
