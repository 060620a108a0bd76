"""Fits or forecasts of many objects: a small figure for each, all with the same axes."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from textwrap import shorten

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from commonlaw.forecast import Forecast
from commonlaw.names import in_line
from commonlaw.plots.forecast import Curve, Pair, curves_of, difference_of, draw_bands, draw_pair, limits_of
from commonlaw.plots.style import axis_label, styled

_WIDTH, _HEIGHT, _FOOT = 3.6, 2.3, 0.5
"""Of a figure, of the panels of a state, and of what stands below all of them, in inches."""

_MOST_TIMES, _MOST_POINTS = 60, 40
"""Of a curve, and measurements of a trial: small figures need no more."""

_CELLS, _CELL, _FEW_POINTS = 3, 0.75, 15
"""Cells side by side in an overview, the height of each in inches, and measurements of a trial in it."""

Limits = tuple[float, float]


@dataclass(frozen=True, eq=False)
class ForecastPanels:
    """The forecasts of each object's trials beside what was measured, drawn object by object.

    See `plot_forecast` for what is drawn; figures are as wide as a phone, and have no legend.

    Parameters
    ----------
    forecast
        What `Law.predict` returned.
    """

    forecast: Forecast

    @styled()
    def draw(self, name: str) -> Figure:
        """Return the figure of an object."""
        schema = self.forecast.trials.schema
        states, lower = schema.states, difference_of(self.forecast)
        height = _HEIGHT * len(states) + _FOOT
        figure = Figure(figsize=(_WIDTH, height))
        panels = figure.subplots(2 * len(states), 1, sharex=True, height_ratios=[2, 1] * len(states))
        figure.subplots_adjust(left=0.225, right=0.98, top=1 - 0.08 / height, bottom=_FOOT / height, hspace=0.18)
        for j, state in enumerate(states):
            pair = Pair(panels[2 * j], panels[2 * j + 1], self._curves[name, j])
            draw_pair(pair, _MOST_POINTS)
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
        """Return one figure of many objects: what was measured and forecast in a cell for each, below its name.

        Cells have the same axes, which are not drawn.

        Parameters
        ----------
        names
            Of the objects.
        """
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
                self._draw_cell(panel, self._curves[name, j], self._limits[j][0], (left, top + j))
        return figure

    def _draw_cell(self, panel: Axes, curves: list[Curve], limits: Limits, corner: tuple[int, int]) -> None:
        """Draw a state of an object into the unit square right of and below a corner."""
        (begin, end), (low, high) = self._times, limits
        for curve in curves:
            every = slice(None, None, -(-len(curve.times) // _FEW_POINTS))
            measured = (curve.times[every], curve.measured[every], ".")
            for times, values, style in (measured, (curve.at, np.clip(curve.forecast, low, high), "-")):
                across = corner[0] + 0.95 * (times - begin) / (end - begin)
                down = corner[1] + 0.97 - 0.7 * (values - low) / (high - low)
                panel.plot(across, down, style, color=curve.color, linewidth=0.7, markersize=1.5)

    @cached_property
    def _curves(self) -> dict[tuple[str, int], list[Curve]]:
        return curves_of(self.forecast, self.forecast.smooth(_MOST_TIMES))

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
