"""Coefficients of a law with their intervals."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw.law import Law
from commonlaw.plots.dots import Coefficient, DotPlot
from commonlaw.plots.style import COLORS, add_legend, frozen_layout, styled
from commonlaw.spacing import evenly_spaced

_NAMED = 50
"""Objects with a line and a name each; more are drawn in order of their coefficients, without names."""

_DRAWN = 1000
"""Objects that are drawn, evenly by rank, of more: there are no more points across a page."""


@styled()
def plot_intervals(law: Law) -> Figure:
    """Plot every coefficient of every object as a dot, with its 95 % interval where that is known.

    Objects have a line each; more than fifty are in the order of each coefficient, and have no names.

    Parameters
    ----------
    law
        The law.
    """
    dots = DotPlot(law)
    if len(law.objects) > _NAMED:
        return _in_order(dots)
    figure = Figure(figsize=(dots.width, 0.8 + dots.height), layout="constrained")
    dots.draw(figure, figure.add_gridspec(1, 1)[0])
    add_legend(figure, dots.keys(), above=True)
    return frozen_layout(figure)


@dataclass(frozen=True, eq=False)
class IntervalPanels:
    """The panels of `plot_intervals` for a law of several objects, each as a small figure of its own.

    Parameters
    ----------
    law
        The law.
    """

    law: Law

    @cached_property
    def captions(self) -> list[str]:
        """What each panel shows."""
        before = "" if self.law.provenance.equations and self.law.explanation is None else "before "
        lefts = self.law.left_hand_sides
        return [f"{before}{each.name} in {lefts[each.equation]}" for each in self._dots.coefficients]

    @styled()
    def draw(self, panel: int) -> Figure:
        """Return the figure of a panel."""
        each, named = self._dots.coefficients[panel], len(self.law.objects) <= _NAMED
        figure = Figure(figsize=(3.6, 0.8 + 0.2 * len(self.law.objects) if named else 2.8), layout="constrained")
        axes = figure.add_subplot()
        if named:
            self._dots.draw_panel(axes, each)
        else:
            _draw_in_order(axes, each)
        return frozen_layout(figure)

    @cached_property
    def _dots(self) -> DotPlot:
        return DotPlot(self.law)


def _in_order(dots: DotPlot) -> Figure:
    """Return the figure of many objects: each coefficient in the order of its size."""
    figure = Figure(figsize=(dots.width, 0.6 + 2.6 * dots.lines), layout="constrained")
    panels = figure.subplots(dots.lines, dots.columns, squeeze=False)
    for panel in panels.flat[len(dots.coefficients) :]:
        panel.set_visible(False)
    for panel, each in zip(panels.flat, dots.coefficients, strict=False):
        _draw_in_order(panel, each)
        panel.set_title(dots.title(each))
    return frozen_layout(figure)


def _draw_in_order(panel: Axes, each: Coefficient) -> None:
    order = np.argsort(each.learned)
    ranks = np.array(evenly_spaced(len(order), _DRAWN))
    values, low, high = (own[order[ranks]] for own in (each.learned, each.low, each.high))
    panel.fill_betweenx(ranks, low, high, color=COLORS[0], alpha=0.25, linewidth=0)
    panel.plot(values, ranks, color=COLORS[0], linewidth=2)
    panel.set_xlabel(each.label)
    panel.locator_params(axis="x", nbins=4)
    panel.set_ylabel("objects in order")
