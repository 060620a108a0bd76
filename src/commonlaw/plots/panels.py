"""Panels of trials, small or large, and trials in them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from textwrap import shorten
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike

from commonlaw.errors import unknown
from commonlaw.forecast import Forecast
from commonlaw.plots.forecast import Curve, Pair, curves_of, difference_of, draw_bands, draw_pair, limits_of
from commonlaw.plots.style import DASHES, GREY, add_legend, axis_label, frozen_layout, key, looks, plain, styled
from commonlaw.text import in_line
from commonlaw.trials import Trials

_WIDTH, _HEIGHT, _FOOT = 3.6, 2.3, 0.5
"""Of a figure, of the panels of a state, and of what stands below all of them, in inches."""


_CELLS, _CELL, _MAX_CELL_POINTS = 3, 0.75, 15
"""Cells side by side in an overview, the height of each in inches, and measurements of a trial in it."""

Limits = tuple[float, float]


@dataclass(frozen=True, eq=False)
class ForecastPanels:
    """Panels of `plot_forecast`, one figure for each object, without a legend, in the width of a phone."""

    forecast: Forecast

    @styled()
    def draw(self, name: str) -> Figure:
        """Return the figure of one object."""
        schema = self.forecast.trials.schema
        states, lower = schema.states, difference_of(self.forecast)
        height = _HEIGHT * len(states) + _FOOT
        figure = Figure(figsize=(_WIDTH, height))
        panels = figure.subplots(2 * len(states), 1, sharex=True, height_ratios=[2, 1] * len(states))
        figure.subplots_adjust(left=0.225, right=0.98, top=1 - 0.08 / height, bottom=_FOOT / height, hspace=0.18)
        for j, state in enumerate(states):
            pair = Pair(panels[2 * j], panels[2 * j + 1], self._curves[name, j])
            draw_pair(pair, 40)
            for panel, limits, what in zip((pair.above, pair.below), self._limits[j], (state, lower), strict=True):
                panel.set_ylim(*limits)
                panel.set_ylabel(axis_label(what, schema.units.get(state, "")))
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
        lines = -(-len(names) // _CELLS)
        figure = Figure(figsize=(_WIDTH, _CELL * len(states) * lines))
        panel = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        panel.set(xlim=(0, _CELLS), ylim=(lines * len(states), 0))
        panel.set_axis_off()
        for i, name in enumerate(names):
            left, top = i % _CELLS, i // _CELLS * len(states)
            panel.text(left + 0.03, top + 0.05, shorten(in_line(name), 24, placeholder=" …"), fontsize=7, va="top")
            for j in states:
                # Draw a state of an object into the unit square right of and below a corner
                curves = self._curves[name, j]
                limits = self._limits[j][0]
                corner = (left, top + j)
                (begin, end), (low, high) = self._times, limits
                for curve in curves:
                    every = slice(None, None, -(-len(curve.times) // _MAX_CELL_POINTS))
                    measured = (curve.times[every], curve.measured[every], ".")
                    for times, values, style in (measured, (curve.at, np.clip(curve.forecast, low, high), "-")):
                        across = corner[0] + 0.95 * (times - begin) / (end - begin)
                        down = corner[1] + 0.97 - 0.7 * (values - low) / (high - low)
                        panel.plot(across, down, style, color=curve.color, linewidth=0.7, markersize=1.5)
        return figure

    @cached_property
    def _curves(self) -> dict[tuple[str, int], list[Curve]]:
        return curves_of(self.forecast, self.forecast.smooth(60))

    @cached_property
    def _limits(self) -> list[tuple[Limits, Limits]]:
        """The limits of the panels of each state and of its errors."""
        trials = self.forecast.trials
        return [
            limits_of([curve for name in trials.objects for curve in self._curves[name, j]])
            for j in range(len(trials.schema.states))
        ]

    @cached_property
    def _times(self) -> Limits:
        first = min(trial.times[0] for trial in self.forecast.trials)
        last = max(trial.times[-1] for trial in self.forecast.trials)
        margin = 0.03 * (last - first)
        return float(first - margin), float(last + margin)


@styled()
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
    look, labels, references = looks(trials.objects), dict.fromkeys(each.name for each in chosen), references or {}
    dashes = dict(zip(labels, DASHES, strict=False)) if 1 < len(labels) <= len(DASHES) else {}
    for panel, name in zip(panels, states, strict=True):
        column, unit = schema.states.index(name), schema.units.get(name, "")
        for trial in chosen:
            panel.plot(
                trial.times,
                trial.states[:, column],
                dashes.get(trial.name, "-"),
                markevery=max(1, len(trial) // 12),
                **look[trial.object],
            )
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
