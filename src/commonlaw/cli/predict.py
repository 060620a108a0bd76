"""`commonlaw predict`: forecast trials with a saved law."""

from contextlib import suppress
from dataclasses import replace
from math import ceil, isfinite
from typing import TYPE_CHECKING

import click

from commonlaw.cli.command import command
from commonlaw.cli.later import LaterSteps
from commonlaw.cli.output import print_frame, print_json, say
from commonlaw.cli.paths import ReadFile, WrittenFigure, WrittenFile
from commonlaw.cli.source import Source, with_source
from commonlaw.cli.working import working
from commonlaw.effort import check_memory
from commonlaw.errors import CommonlawError
from commonlaw.trials import Trials

if TYPE_CHECKING:
    from commonlaw.law import Law

_BYTES_A_VALUE = 200
"""Of a forecast, with what is made of it on the way."""


@command
@click.argument("law_path", metavar="LAW.json", type=ReadFile())
@with_source
@click.option(
    "--start",
    type=int,
    metavar="N",
    help="How many of a trial's first samples tell where its forecast starts: 1 for the first as measured; to more the"
    " law is fitted.  [default: 1, or for laws of second order that know their noise, what first rates would be "
    "estimated from; all that were measured where rows follow that were not]",
)
@click.option(
    "--from",
    "from_time",
    type=float,
    metavar="TIME",
    help="Forecast from this time on; what was measured before, or the last N samples of --start, tells the start.",
)
@click.option("--until", type=float, metavar="TIME", help="Forecast until this time, beyond the measurements.")
@click.option("--step", type=click.FloatRange(0, min_open=True), help="Step of these times.  [default: a hundredth]")
@click.option(
    "--input-between",
    type=click.Choice(["held", "linear", "cubic"]),
    help="Inputs between samples: held at the earlier value, as a controller does, on lines, or on a cubic spline.  "
    "[default: as the law was learned]",
)
@click.option("--discrepancy", is_flag=True, help="Forecast with the discrepancy that `discrepancy --save` found.")
@click.option("--save", type=WrittenFile(), metavar="FORECAST.csv", help="Write measured and forecast states.")
@click.option(
    "--plot", type=WrittenFigure(), metavar="FIGURE", help="Write a figure of the forecasts (.png, .svg, .pdf)."
)
@click.option("--json", "as_json", is_flag=True, help="Print the errors as JSON.")
def predict(
    law_path: str,
    source: Source,
    start: int | None,
    from_time: float | None,
    input_between: str | None,
    discrepancy: bool,
    save: str | None,
    plot: str | None,
    as_json: bool,
    **grid: float,
) -> None:
    """Forecast every trial in FILE with LAW.json, each from its own initial state.

    Columns are found by the names that the law was learned with; options name others. Rows without states
    after the measured ones are forecast. Where the law knows how accurate it is, the table that is written has the ends
    of 95 % bands, for the state itself (low, high) and for a measurement of it, with its noise (measured low, measured
    high); the figure shows the bands of measurements. Objects that the law does not know have the coefficients that
    follow from their properties, if it was explained, else the mean ones of the others.

    \b
    Example:
      commonlaw predict law.json drops.csv --save forecast.csv
      commonlaw predict law.json drops.csv --until 30 --step 0.1 --save forecast.csv
      commonlaw predict law.json lynx.csv --from 1920 --plot forecast.png
    """
    from commonlaw.law import Law

    law = Law.load(law_path)
    with working("Forecasting ..."):
        trials = source.select(_with_properties(source, law))
        return_std = bool(save or plot) and law.has_std
        times = _times(trials, from_time, **grid)
        forecast = law.predict(
            trials,
            times=times,
            start=start,
            from_time=from_time,
            return_std=return_std,
            input_between=input_between,
            discrepancy=discrepancy,
        )
        errors = forecast.errors()
        later = LaterSteps()
        later.write(save, lambda: forecast.to_frame().to_csv(index=False).encode())
        later.draw(plot, lambda plots: plots.plot_forecast(forecast))
    if as_json:
        print_json({"score": forecast.score(), "errors": errors.to_dict(orient="records")})
    else:
        print_frame(errors.dropna(axis=1, how="all"))
        say(f"R^2 of all forecasts: {forecast.score():.5g}")
    later.end((*forecast.trials.notes, *forecast.outcomes), silent=as_json)


def _with_properties(source: Source, law: "Law") -> Trials:
    """Return all trials, with the properties that the law's relations and discrepancy take, if the table has them.

    In a table of one object a column that does not change is a property only where one is looked for.
    """
    trials = source.load(law.schema)
    taken = law.explanation.properties if law.explanation else ()
    if law.with_discrepancy:
        taken = (*taken, *law.with_discrepancy.schema.inputs[len(law.schema.inputs) :])
    known = {name for values in trials.properties.values() for name in values}
    if source.path and not source.properties and not {*taken} <= known:
        with suppress(CommonlawError):
            return replace(source, properties=taken).load(law.schema)
    return trials


def _times(trials: Trials, first: float | None, until: float | None, step: float | None) -> list[float]:
    """Return the times that ``--until`` and ``--step`` ask for, from the first time on or that of all samples."""
    for name, value in (("--until", until), ("--step", step)):
        if value is not None and not isfinite(value):
            raise CommonlawError(f"{name} {value}: give a finite number")
    first = min(each.times[0] for each in trials) if first is None else first
    last = max(each.times[-1] for each in trials)
    span = (last if until is None else until) - first
    if until is step is None or span <= 0:
        return []
    step = step or span / 100
    size = _BYTES_A_VALUE * span / step * len(trials) * len(trials.schema.states)
    check_memory(f"forecasts at {span / step:.0f} times of {len(trials)} trials", size, "give a larger --step")
    return [first + i * step for i in range(ceil(span / step))] + [first + span]
