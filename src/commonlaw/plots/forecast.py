"""Forecasts beside measurements."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from commonlaw.forecast import Forecast
from commonlaw.plots.style import (
    COLORS,
    GREY,
    add_legend,
    axis_label,
    columns_for,
    key,
    plain,
    settled,
    show_lowest_ticks,
    styled,
)
from commonlaw.trials import Trials

Floats = NDArray[np.float64]

_MOST_POINTS = 150
"""Measured points that are drawn of one trial; more would hide the forecast."""


@styled()
def plot_forecast(forecast: Forecast, objects: Sequence[str] | None = None) -> Figure:
    """Plot measured points and forecast lines, and below them the error, one pair of panels for each object and state.

    A forecast that diverged ends at a cross; values that are not finite are not drawn, and axes are set by what was
    measured.

    Parameters
    ----------
    forecast
        What `Law.predict` returned.
    objects
        Some of its objects; all by default.

    Raises
    ------
    CommonlawError
        If there is no such object.
    """
    shown = forecast if objects is None else _of_objects(forecast, objects)
    columns, lines = forecast_grid(shown)
    figure = Figure(figsize=(1.4 + 2.4 * max(columns, 2), 1 + 3 * lines), layout="constrained")
    draw_forecast(figure, figure.add_gridspec(1, 1)[0], shown, columns)
    add_legend(figure, forecast_keys(shown), above=True)
    return settled(figure)


def forecast_grid(forecast: Forecast, most: int = 5) -> tuple[int, int]:
    """Return the number of columns, if possible not above `most`, and of lines of pairs of panels.

    The states of an object stand in one line.
    """
    states, objects = len(forecast.trials.schema.states), len(forecast.trials.objects)
    across = columns_for(objects, max(1, most // states))
    return across * states, -(-objects // across)


def draw_forecast(figure: Figure, place: SubplotSpec, forecast: Forecast, columns: int) -> None:
    """Draw all pairs of panels into a part of a figure."""
    schema, colors = forecast.trials.schema, _trial_colors(forecast.trials)
    states = len(schema.states)
    lines = -(-len(forecast.trials.objects) * states // columns)
    grid = place.subgridspec(2 * lines, columns, height_ratios=[2, 1] * lines)
    first: dict[int, tuple[Axes, Axes]] = {}
    lower = []
    for i, (name, j) in enumerate(product(forecast.trials.objects, range(states))):
        line, column = divmod(i, columns)
        like = first.get(j, (None, None))
        above = figure.add_subplot(grid[2 * line, column], sharex=like[0], sharey=like[0])
        below = figure.add_subplot(grid[2 * line + 1, column], sharex=above, sharey=like[1])
        first.setdefault(j, (above, below))
        lower.append(below)
        _draw_pair(above, below, _curves(forecast, name, j, colors))
        above.set_title(plain(name, 24))
        above.tick_params(labelbottom=False)
        # Panels of one state share their axes, so those of the first object speak for the others in the line
        for panel, what in ((above, schema.states[j]), (below, "error")):
            panel.tick_params(labelleft=column < states)
            if column < states:
                panel.set_ylabel(axis_label(what, schema.units.get(schema.states[j], "")))
    for j, pair in first.items():
        _set_limits(*pair, [each for name in forecast.trials.objects for each in _curves(forecast, name, j, colors)])
    show_lowest_ticks(lower, columns, axis_label(schema.time, schema.units.get(schema.time, "")))


@dataclass(frozen=True)
class _Curve:
    """One state of one trial: measured, and forecast as far as it is finite."""

    times: Floats
    measured: Floats
    forecast: Floats
    diverged: bool
    color: str

    @property
    def error(self) -> Floats:
        """Forecast minus measured, as far as there is a forecast."""
        return np.asarray(self.forecast - self.measured[: len(self.forecast)])


def _curves(forecast: Forecast, name: str, j: int, colors: Mapping[str, str]) -> list[_Curve]:
    """Return the curves of state `j` of one object."""
    curves = []
    for trial, trajectory in zip(forecast.trials, forecast.trajectories, strict=True):
        if trial.object == name:
            states = trajectory.states[:, j]
            reached = states[: int(np.argmin(np.isfinite(np.append(states, np.nan))))]
            diverged = trajectory.outcome is not None
            curves.append(_Curve(trial.times, trial.states[:, j], reached, diverged, colors[trial.name]))
    return curves


def _draw_pair(state: Axes, error: Axes, curves: Sequence[_Curve]) -> None:
    """Draw measurements and forecasts above, errors below, and where a forecast diverged in both."""
    error.axhline(0, color=GREY, linewidth=0.8)
    for curve in curves:
        every = -(-len(curve.times) // _MOST_POINTS)
        state.plot(
            curve.times,
            curve.measured,
            "o",
            color=curve.color,
            markersize=3,
            alpha=0.45,
            markeredgewidth=0,
            markevery=every,
        )
    for curve in curves:
        reached = curve.times[: len(curve.forecast)]
        for panel, values in ((state, curve.forecast), (error, curve.error)):
            panel.plot(reached, values, color=curve.color)
            if curve.diverged:
                panel.axvline(reached[-1], color=curve.color, linestyle=":")
                # The cross stands at the foot of the panel: the last value may be far outside
                panel.plot(
                    reached[-1], 0.08, "X", color=curve.color, transform=panel.get_xaxis_transform(), clip_on=False
                )


def _set_limits(state: Axes, error: Axes, curves: Sequence[_Curve]) -> None:
    """Show all that was measured, and of forecasts what lies within half of its span from it."""
    measured = np.concatenate([curve.measured for curve in curves])
    forecasts = np.concatenate([curve.forecast for curve in curves])
    low, high = measured.min(), measured.max()
    span = (high - low) or abs(high) or 1.0
    low, high = max(min(low, forecasts.min()), low - span / 2), min(max(high, forecasts.max()), high + span / 2)
    state.set_ylim(low - span / 20, high + span / 20)
    largest = np.max(np.abs(np.concatenate([curve.error for curve in curves])))
    bound = 1.1 * (min(largest, span) or span / 100)
    error.set_ylim(-bound, bound)


def _trial_colors(trials: Trials) -> dict[str, str]:
    """Return a colour for each trial label."""
    names = dict.fromkeys(trial.name for trial in trials)
    return {name: COLORS[i % len(COLORS)] for i, name in enumerate(names)}


def forecast_keys(forecast: Forecast) -> list[Line2D]:
    """Return the legend: what points and lines are, and the trials if there are several, but not very many."""
    colors = _trial_colors(forecast.trials)
    keys = [
        key("measured", color=GREY, marker="o", markersize=4, linestyle=""),
        key("forecast", color=GREY),
    ]
    if forecast.outcomes:
        keys.append(key("forecast diverged", color=GREY, marker="X", linestyle=":"))
    if 1 < len(colors) <= len(COLORS):
        word = forecast.trials.schema.trial
        keys += [key(plain(f"{word} {name}"), color=color, linewidth=4) for name, color in colors.items()]
    return keys


def _of_objects(forecast: Forecast, objects: Sequence[str]) -> Forecast:
    trials = forecast.trials.select(object=objects if isinstance(objects, str) else list(objects))
    kept = [
        trajectory
        for trial, trajectory in zip(forecast.trials, forecast.trajectories, strict=True)
        if trial.object in trials.objects
    ]
    return Forecast(trials, tuple(kept))
