"""Trials, fitted curves and forecasts with measurements, and forecasts of planned experiments."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import compress, product
from textwrap import shorten
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats, evenly_spaced, thinned
from commonlaw.errors import unknown
from commonlaw.experiments.plan import Design, Forecasts
from commonlaw.forecast import Forecast
from commonlaw.forecast.forecast import squared_errors
from commonlaw.law.quantiles import two_sided
from commonlaw.plots.style import (
    BAND,
    COLORS,
    DASHES,
    GREY,
    add_legend,
    axis_label,
    columns_for,
    fitting,
    frozen_layout,
    key,
    looks,
    plain,
    show_lowest_ticks,
    styled,
)
from commonlaw.runtime.arguments import checks_types
from commonlaw.runtime.forking import cached_property
from commonlaw.text import in_line
from commonlaw.trials import Trials

_POINTS: Mapping[str, Any] = {"markersize": 3, "alpha": 0.45, "markeredgewidth": 0}


@styled()
@checks_types
def plot_forecast(forecast: Forecast, objects: Sequence[str] | None = None) -> Figure:
    """Plot forecasts or fits with the measurements, and below them the errors, for each object and state.

    Residuals of a fit are measured minus fitted states, errors of a forecast are forecast minus measured states. The 95
    % bands are those of a measurement, with its noise if it is known; in the panels of errors they are centred at zero.
    A diverged curve ends at a cross.

    Raises `CommonlawError` if there is no such object.

    Parameters
    ----------
    forecast
        From `Law.predict`; with ``start="all"`` it is the fit.
    objects
        Objects to show. Default: all, or if there are many, those evenly spaced by the rank of their RMS error.
    """
    names = representative(forecast) if objects is None else objects
    shown = of_objects(forecast, names)
    columns, height = forecast_grid(shown)
    figure = Figure(figsize=fitting(1.4 + 2.4 * max(columns, 2), 1 + height), layout="constrained")
    draw_forecast(figure, figure.add_gridspec(1, 1)[0], shown, columns)
    add_legend(figure, forecast_keys(shown), "above", "" if objects else omission(forecast, names))
    return frozen_layout(figure)


def relative_errors(forecast: Forecast) -> "pd.Series[float]":
    """Return the RMS error of each object, in units of the states' standard deviation, the smallest first."""
    squared, states = squared_errors(forecast), np.concatenate([trial.states for trial in forecast.trials])
    variances = pd.Series(np.nanvar(states, axis=0), forecast.trials.schema.states).replace(0.0, np.nan)
    scaled = squared.groupby(level=0, sort=False).mean() / variances[squared.columns]
    relative: pd.Series[float] = scaled.mean(axis=1).pow(0.5)
    return relative.sort_values(kind="stable")


def representative(forecast: Forecast) -> list[str]:
    """Return the objects of a figure: all, or of many those evenly spaced by the rank of their RMS error.

    A figure has twelve pairs of panels.
    """
    objects, most = forecast.trials.objects, max(1, 12 // len(forecast.trials.schema.states))
    if len(objects) <= most:
        return list(objects)
    ranked = [str(name) for name in relative_errors(forecast).index]
    return [ranked[i] for i in evenly_spaced(len(ranked), most)]


def omission(forecast: Forecast, shown: Sequence[str]) -> str:
    """Return how many objects a figure leaves out, in words; nothing if it shows all."""
    some, count = len(shown), len(forecast.trials.objects)
    return f"{some} of {count} objects, evenly spaced by the rank of their RMS error" if some < count else ""


def forecast_grid(forecast: Forecast) -> tuple[int, float]:
    """Return the columns of pairs of panels, at most four unless there are more states, and their height in inches."""
    states, objects = len(forecast.trials.schema.states), len(forecast.trials.objects)
    across = columns_for(objects, max(1, 4 // states))
    return across * states, 2.5 * -(-objects // across)


def draw_forecast(figure: Figure, index: SubplotSpec, forecast: Forecast, columns: int) -> None:
    """Draw all pairs of panels into a part of a figure."""
    schema, curves = forecast.trials.schema, curves_of(forecast, forecast.smooth())
    states = len(schema.states)
    lines = -(-len(forecast.trials.objects) * states // columns)
    grid = index.subgridspec(2 * lines, columns, height_ratios=[2, 1] * lines)
    pairs: dict[int, list[Pair]] = {}
    lower = []
    for i, (name, j) in enumerate(product(forecast.trials.objects, range(states))):
        line, column = divmod(i, columns)
        like = pairs[j][0] if j in pairs else None
        above = figure.add_subplot(grid[2 * line, column], sharex=like and like.above, sharey=like and like.above)
        below = figure.add_subplot(grid[2 * line + 1, column], sharex=above, sharey=like and like.below)
        pair = Pair(above, below, curves[name, j])
        pairs.setdefault(j, []).append(pair)
        lower.append(below)
        draw_pair(pair)
        above.set_title(plain(name if states == 1 else f"{name}: {schema.states[j]}", 24))
        above.tick_params(labelbottom=False)
        # As years are long, more labels would run into each other
        below.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        # Panels of one state share their axes, so those of the first object speak for the others in the line
        what = "residual" if forecast.is_fit else "error"
        for panel, text, width in ((above, schema.states[j], 20), (below, what, 13)):
            panel.tick_params(labelleft=column < states)
            if column < states:
                panel.set_ylabel(axis_label(text, schema.units.get(schema.states[j], ""), width))
    for alike in pairs.values():
        limits = limits_of([curve for pair in alike for curve in pair.curves])
        for panel, limit in zip((alike[0].above, alike[0].below), limits, strict=True):
            panel.set_ylim(*limit)
        for pair in alike:
            draw_bands(pair)
    show_lowest_ticks(lower, columns, axis_label(schema.time, schema.units.get(schema.time, "")))


@dataclass(frozen=True)
class Curve:
    """One state of one trial: measured, and fitted or forecast as far as it is finite, at more times."""

    times: Floats
    measured: Floats
    compared: Floats
    """Times at which it was measured and forecast."""
    error: Floats
    """Residuals at these, measured minus fitted; of a forecast its errors, forecast minus measured."""
    at: Floats
    forecast: Floats
    diverged: bool
    color: str
    low: Floats
    high: Floats
    """The ends of the band, as far as the forecast; the forecast itself without standard deviations."""


@dataclass(frozen=True)
class Pair:
    """The panels of one state of one object, the errors below, and what is drawn in them."""

    above: Axes
    below: Axes
    curves: Sequence[Curve]


def curves_of(forecast: Forecast, smooth: Forecast) -> dict[tuple[str, int], list[Curve]]:
    """Return the curves of all trials, by object and index of the state; `smooth` is the forecast at more times."""
    result: dict[tuple[str, int], list[Curve]] = {}
    sign = -1 if forecast.is_fit else 1
    colors, states = trial_colors(forecast.trials), len(forecast.trials.schema.states)
    known = None if smooth.std is None else smooth.bands(measured=smooth.noise is not None)
    known_ahead, drawn_ahead = forecast.ahead, smooth.ahead
    for i, (trial, trajectory) in enumerate(zip(smooth.trials, smooth.trajectories, strict=True)):
        measured, ahead = forecast.trials[i], known_ahead[i]
        missed = forecast.trajectories[i].states[:, :states] - measured.states
        for j in range(states):
            compared = np.isfinite(missed[:, j]) & ahead
            drawn = np.isfinite(trajectory.states[:, j]) & drawn_ahead[i]
            middle = trajectory.states[drawn, j]
            low, high = (middle, middle) if known is None else (end[drawn, j] for end in known[i])
            curve = Curve(
                times=measured.times,
                measured=measured.states[:, j],
                compared=measured.times[compared],
                error=sign * missed[compared, j],
                at=trial.times[drawn],
                forecast=middle,
                diverged=trajectory.outcome is not None,
                color=colors[trial.name],
                low=np.nan_to_num(low, nan=-np.inf),
                high=np.nan_to_num(high, nan=np.inf),
            )
            result.setdefault((trial.object, j), []).append(curve)
    return result


def draw_pair(pair: Pair, most: int = 150) -> None:
    """Draw measurements, at most so many, and forecasts above, errors below, and where a forecast diverged in both."""
    state, error, curves = pair.above, pair.below, pair.curves
    error.axhline(0, color=GREY, linewidth=0.8)
    for curve in curves:
        seen = ~np.isnan(curve.measured)
        every = thinned(len(curve.times[seen]), most).step
        state.plot(curve.times[seen], curve.measured[seen], "o", color=curve.color, markevery=every, **_POINTS)
    for curve in curves:
        for panel, times, values in ((state, curve.at, curve.forecast), (error, curve.compared, curve.error)):
            panel.plot(times, values, color=curve.color)
            if curve.diverged and len(curve.at):
                panel.axvline(curve.at[-1], color=curve.color, linestyle=":")
                # The cross stands at the foot of the panel: the last value may be far outside
                foot = panel.get_xaxis_transform()
                panel.plot(curve.at[-1], 0.08, "X", color=curve.color, transform=foot, clip_on=False)


def draw_bands(pair: Pair) -> None:
    """Draw the bands of forecasts, behind all else, no farther than a panel's height outside of it."""
    for curve in pair.curves:
        if (curve.high > curve.low).any():
            for panel, above in ((pair.above, 0.0), (pair.below, curve.forecast)):
                low, high = panel.get_ylim()
                bounds = 2 * low - high, 2 * high - low
                ends = np.clip([curve.low - above, curve.high - above], *bounds)
                panel.fill_between(curve.at, *ends, color=curve.color, zorder=1, **BAND)


def limits_of(curves: Sequence[Curve]) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return the limits of the panels of a state and of its errors.

    They show all that was measured, and of forecasts and bands what lies within half of its span from it; all errors,
    and of bands around them those up to three times the median.
    """
    measured = np.concatenate([curve.measured for curve in curves])
    forecasts = np.concatenate([values for curve in curves for values in (curve.low, curve.high)])
    low, high = np.nanmin(measured), np.nanmax(measured)
    span = (high - low) or abs(high) or 1.0
    low = max(forecasts.min(initial=low), low - span / 2)
    high = min(forecasts.max(initial=high), high + span / 2)
    widths = [np.max([curve.forecast - curve.low, curve.high - curve.forecast], initial=0) for curve in curves]
    usual = min(np.max(widths), 3 * np.median(widths))
    largest = np.max(np.abs(np.concatenate([curve.error for curve in curves])), initial=float(usual))
    bound = 1.1 * (min(largest, span) or span / 100)
    return (low - span / 20, high + span / 20), (-bound, bound)


def trial_colors(trials: Trials) -> dict[str, str]:
    """Return a colour for each trial label."""
    return {name: COLORS[i % len(COLORS)] for i, name in enumerate(dict.fromkeys(trial.name for trial in trials))}


def forecast_keys(forecast: Forecast) -> list[Line2D]:
    """Return the legend: what points and lines are, and the trials if there are several, but not very many."""
    colors = trial_colors(forecast.trials)
    keys = [key("measured", color=GREY, marker="o", markersize=4, linestyle=""), key(forecast.title, color=GREY)]
    if forecast.std is not None:
        of = "states" if forecast.noise is None else "measured"
        keys.append(key(f"95 % band ({of})", color=GREY, linewidth=8, alpha=BAND["alpha"]))
    if forecast.outcomes:
        keys.append(key("diverged", color=GREY, marker="X", linestyle=":"))
    if 1 < len(colors) <= len(COLORS):
        word = forecast.trials.schema.trial
        keys += [key(plain(f"{word} {name}"), color=color, linewidth=4) for name, color in colors.items()]
    return keys


def of_objects(forecast: Forecast, objects: Sequence[str]) -> Forecast:
    """Return the forecasts of some objects."""
    if list(objects) == list(forecast.trials.objects):
        return forecast
    trials = forecast.trials.select(object=objects if isinstance(objects, str) else list(objects))
    kept, again = [trial.object in trials.objects for trial in forecast.trials], forecast.at_more_times

    def at_more_times(times: Sequence[Floats]) -> Forecast:
        by_index = dict(zip(np.flatnonzero(kept).tolist(), times, strict=True))
        assert again is not None
        return of_objects(again([by_index.get(i, np.empty(0)) for i in range(len(kept))]), objects)

    return replace(
        forecast,
        trials=trials,
        trajectories=tuple(compress(forecast.trajectories, kept)),
        std=None if forecast.std is None else tuple(compress(forecast.std, kept)),
        at_more_times=None if again is None else at_more_times,
        followed=None if forecast.followed is None else of_objects(forecast.followed, objects),
        parts=tuple(
            part._replace(forecast=of_objects(part.forecast, objects), weights=tuple(compress(part.weights, kept)))
            for part in forecast.parts
        ),
        horizons=tuple(compress(forecast.horizons, kept)),
    )


@styled()
@checks_types
def plot_design(design: Design) -> Figure:
    """Plot the forecasts of plausible laws for the experiments of a design, four of each, with 95 % bands.

    The y axis is the difference from the forecast of the most probable law, or the ratio on a logarithmic scale. Where
    bands do not overlap, one measurement discriminates between the laws. Only the first object of an experiment is
    drawn.
    """
    drawn, laws, schema = design.experiments[:4], design.laws[:4], design.laws[0].law.observation.measured
    states = drawn[0].forecasts.states
    figure = Figure(figsize=fitting(max(5.4, 3.4 * len(states)), 0.8 + 2.5 * len(drawn)), layout="constrained")
    panels = figure.subplots(len(drawn), len(states), squeeze=False)
    for i, planned in enumerate(drawn):
        for j, name in enumerate(states):
            _draw(panels[i, j], planned.forecasts, j, len(laws))
            is_ratio = name in planned.forecasts.logarithmic
            label = f"{name} / first law" if is_ratio else f"{name} − first law"
            panels[i, j].set_ylabel(axis_label(label, "" if is_ratio else schema.units.get(name, "")))
        panels[i, 0].set_title(plain(f"{i + 1}. {planned.text}", 60 * len(states)), loc="left", fontsize=9)
    for panel in panels[-1]:
        panel.set_xlabel(axis_label(schema.time, schema.units.get(schema.time, "")))
    texts = [f"{'; '.join(model.law.structure)}  ({model.probability:.2f})" for model in laws]
    keys = [key(plain(text, 60), **_look(k)) for k, text in enumerate(texts)]
    figure.legend(handles=keys, loc="outside upper left")
    return frozen_layout(figure)


def _look(index: int) -> dict[str, Any]:
    return {"color": COLORS[index], "linestyle": DASHES[index]}


def _draw(panel: Axes, forecasts: Forecasts, state: int, laws: int) -> None:
    half, first = two_sided(0.95), forecasts.means[0]
    for k, (mean, std) in enumerate(zip(forecasts.means[:laws], forecasts.std[:laws], strict=True)):
        low, middle, high = ((mean - first + side * half * std)[:, state] for side in (-1, 0, 1))
        if forecasts.states[state] in forecasts.logarithmic:
            low, middle, high = np.exp(low), np.exp(middle), np.exp(high)
        panel.fill_between(forecasts.times, low, high, color=COLORS[k], **BAND)
        panel.plot(forecasts.times, middle, **_look(k))


Limits = tuple[float, float]


@dataclass(frozen=True, eq=False)
class ForecastPanels:
    """Panels of `plot_forecast`, one figure for each object, without a legend, in the width of a phone."""

    forecast: Forecast

    @styled()
    def draw(self, name: str) -> Figure:
        """Return the figure of one object."""
        schema = self.forecast.trials.schema
        states, lower = schema.states, "residual" if self.forecast.is_fit else "error"
        foot = 0.5  # Inches, of the labels below all panels
        height = 2.3 * len(states) + foot
        figure = Figure(figsize=(3.6, height))
        panels = figure.subplots(2 * len(states), 1, sharex=True, height_ratios=[2, 1] * len(states))
        figure.subplots_adjust(left=0.225, right=0.98, top=1 - 0.08 / height, bottom=foot / height, hspace=0.18)
        for j, state in enumerate(states):
            pair = Pair(panels[2 * j], panels[2 * j + 1], self._curves[name, j])
            draw_pair(pair, 40)
            labels = (pair.above, state, 20), (pair.below, lower, 13)
            for limits, (panel, what, width) in zip(self._limits[j], labels, strict=True):
                panel.set_ylim(*limits)
                panel.set_ylabel(axis_label(what, schema.units.get(state, ""), width))
            draw_bands(pair)
        panels[-1].set_xlim(*self._times)
        panels[-1].xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
        panels[-1].set_xlabel(axis_label(schema.time, schema.units.get(schema.time, "")))
        figure.align_ylabels()
        return figure

    @styled()
    def overview(self, names: Sequence[str]) -> Figure:
        """Return one figure with a small cell for each of these objects, all with the same hidden axes."""
        states = range(len(self.forecast.trials.schema.states))
        columns = 3
        lines = -(-len(names) // columns)
        figure = Figure(figsize=(3.6, 0.75 * len(states) * lines))
        panel = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        panel.set(xlim=(0, columns), ylim=(lines * len(states), 0))
        panel.set_axis_off()
        for i, name in enumerate(names):
            column, top = i % columns, i // columns * len(states)
            panel.text(column + 0.03, top + 0.05, shorten(in_line(name), 24, placeholder=" …"), fontsize=7, va="top")
            for j in states:
                # Draw a state of an object into the unit square right of and below a corner
                (begin, end), (low, high) = self._times, self._limits[j][0]
                for curve in self._curves[name, j]:
                    every = thinned(len(curve.times), 15)
                    measured = (curve.times[every], curve.measured[every], ".")
                    for times, values, style in (measured, (curve.at, np.clip(curve.forecast, low, high), "-")):
                        across = column + 0.95 * (times - begin) / (end - begin)
                        down = top + j + 0.97 - 0.7 * (values - low) / (high - low)
                        panel.plot(across, down, style, color=curve.color, linewidth=0.7, markersize=1.5)
        return figure

    @cached_property
    def _curves(self) -> dict[tuple[str, int], list[Curve]]:
        return curves_of(self.forecast, self.forecast.smooth(60))

    @cached_property
    def _limits(self) -> list[tuple[Limits, Limits]]:
        trials = self.forecast.trials
        states = range(len(trials.schema.states))
        return [limits_of([curve for name in trials.objects for curve in self._curves[name, j]]) for j in states]

    @cached_property
    def _times(self) -> Limits:
        first = min(trial.times[0] for trial in self.forecast.trials)
        last = max(trial.times[-1] for trial in self.forecast.trials)
        margin = 0.03 * (last - first)
        return float(first - margin), float(last + margin)


@styled()
@checks_types
def plot_trials(
    trials: Trials,
    state: str | None = None,
    objects: Sequence[str] | None = None,
    references: Mapping[str, tuple[ArrayLike, ArrayLike]] | None = None,
) -> Figure:
    """Plot measured states against time: a colour and marker for each object, a line style for each trial.

    Raises `CommonlawError` if the state or an object is not among the trials'.

    Parameters
    ----------
    trials
        The measurements.
    state, objects
        The state and the objects to show; default: all.
    references
        Reference curves by label, times and values of shape (n,); black lines in every panel.
    """
    schema = trials.schema
    if state is not None and state not in schema.states:
        raise unknown("state", state, schema.states)
    states = schema.states if state is None else (state,)
    chosen = trials if objects is None else trials.select(object=objects if isinstance(objects, str) else list(objects))
    figure = Figure(figsize=(9, 2 + 3 * len(states)), layout="constrained")
    panels = figure.subplots(len(states), 1, sharex=True, squeeze=False)[:, 0]
    look, labels, references = looks(trials.objects), dict.fromkeys(trial.name for trial in chosen), references or {}
    dashes = dict(zip(labels, DASHES, strict=False)) if 1 < len(labels) <= len(DASHES) else {}
    for panel, name in zip(panels, states, strict=True):
        column, unit = schema.states.index(name), schema.units.get(name, "")
        for trial in chosen:
            dash, every = dashes.get(trial.name, "-"), max(1, len(trial) // 12)
            panel.plot(trial.times, trial.states[:, column], dash, markevery=every, **look[trial.object])
        for i, curve in enumerate(references.values()):
            panel.plot(*map(np.asarray, curve), **_reference(i))
        panel.set_ylabel(axis_label(name, unit))
    panels[-1].set_xlabel(axis_label(schema.time, schema.units.get(schema.time, "")))
    keys = [key(plain(name), **look[name]) for name in chosen.objects]
    keys += [key(plain(f"{schema.trial} {name}"), color=GREY, linestyle=dash) for name, dash in dashes.items()]
    keys += [key(plain(label), **_reference(i)) for i, label in enumerate(references)]
    add_legend(figure, keys)
    return frozen_layout(figure)


def _reference(index: int) -> dict[str, Any]:
    """Return how a curve to compare with looks: wider than those of the trials, and above them."""
    return {"color": "black", "linestyle": DASHES[index % len(DASHES)], "linewidth": 2.4, "zorder": 3}
