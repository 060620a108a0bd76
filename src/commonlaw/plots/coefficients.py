"""Coefficients of a law: heat maps."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.gridspec import SubplotSpec
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogLocator

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import unknown
from commonlaw.law import Law
from commonlaw.plots.equations import left_hand_sides, term_labels
from commonlaw.plots.style import ABSENT, COLORS, frozen_layout, key, number_text, plain, styled


@styled()
def plot_coefficients(law: Law, terms: Literal["all", "support"] = "all") -> Figure:
    """Plot the magnitude of every coefficient, objects by terms, one panel for each equation.

    Colours are logarithmic, grey cells are terms that are not in an object's equation, and the values are printed
    where they fit (the founding paper's heat maps of learned coefficients).

    Parameters
    ----------
    law
        The law.
    terms
        ``"all"`` candidate terms, or the ``"support"``: those that are in one of the law's equations.

    Raises
    ------
    CommonlawError
        If the choice of terms is not one of these.
    """
    if terms not in ("all", "support"):
        raise unknown("choice of terms", terms, ("all", "support"))
    maps = HeatMaps(law, law.support.any(axis=0) | np.full(len(law.terms), terms == "all"))
    figure = Figure(figsize=(maps.width, maps.height), layout="constrained")
    maps.draw(figure, figure.add_gridspec(1, 1)[0])
    return frozen_layout(figure)


@dataclass(frozen=True, eq=False)
class HeatMaps:
    """Magnitudes of coefficients, objects by terms, one panel for each equation.

    The terms `chosen`, shape (terms,), get a column, all of them if it is none; terms of the true law get a frame.
    """

    law: Law
    chosen: Bools
    truth: Law | None = None

    @cached_property
    def shown(self) -> Bools:
        """Which terms get a column: those chosen, or all of them to show that none is there."""
        return self.chosen if self.chosen.any() else np.ones_like(self.chosen)

    @cached_property
    def cell(self) -> float:
        """Width of a cell in inches."""
        return float(np.clip(13 / self.shown.sum(), 0.2, 0.66))

    @property
    def fits(self) -> bool:
        """Whether a number fits into a cell."""
        return self.cell > 0.6

    @cached_property
    def names(self) -> list[str]:
        """The objects as labels."""
        return [plain(name, 34) for name in self.law.objects]

    @property
    def width(self) -> float:
        """Width in inches."""
        margin = 0.5 + 0.08 * max(len(line) for name in self.names for line in name.split("\n"))
        return float(margin + max(self.cell * self.shown.sum(), 3.5))

    @property
    def height(self) -> float:
        """Height in inches."""
        return 1 + len(self.law.states) * (0.7 + 0.34 * len(self.names))

    def draw(self, figure: Figure, index: SubplotSpec) -> None:
        """Draw into a part of a figure."""
        panels = index.subgridspec(len(self.law.states), 1).subplots(squeeze=False)[:, 0]
        norm = scale(self.law.coefficients)
        labels = [label for label, shown in zip(term_labels(self.law.terms), self.shown, strict=True) if shown]
        for j, (panel, left) in enumerate(zip(panels, left_hand_sides(self.law), strict=True)):
            values = self.law.coefficients[:, j, self.shown]
            mesh = heat_map(panel, values, norm)
            panel.set_title(f"terms of {left}" + ("" if values.any() else ": none is there"), loc="left")
            panel.set_xticks(np.arange(len(labels)) + 0.5, labels, rotation=0 if self.fits else 90)
            panel.set_yticks(np.arange(len(self.names)) + 0.5, self.names)
            if self.fits:
                _print_values(panel, values, mesh)
            if self.truth is not None:
                self._frame_truth(panel, self.truth, j)
        if self.law.support.any():
            add_color_bar(figure, mesh, list(panels), self.width)

    def keys(self) -> list[Line2D]:
        """Return what belongs into the legend."""
        if self.truth is None:
            return []
        frame = {"marker": "s", "markersize": 9, "markerfacecolor": "none", "markeredgewidth": 2, "linestyle": ""}
        return [key("true term", color=COLORS[1], **frame)]

    def _frame_truth(self, panel: Axes, truth: Law, equation: int) -> None:
        names = [name for name, shown in zip(self.law.terms.names, self.shown, strict=True) if shown]
        true = np.transpose([true_values(self.law, truth, equation, name) for name in names])
        for i, k in np.argwhere(np.isfinite(true)):
            panel.add_patch(Rectangle((k, i), 1, 1, fill=False, edgecolor=COLORS[1], linewidth=2))


def true_values(law: Law, truth: Law, equation: int, term: str) -> Floats:
    """Return the true coefficients of a term for the law's objects, shape (objects,); NaN where it is not there."""
    if term not in truth.terms.names:
        return np.full(len(law.objects), np.nan)
    index = truth.terms.index(term)
    values = [truth.coefficients_of(name)[equation, index] if name in truth.objects else 0.0 for name in law.objects]
    return absent_as_nan(np.array(values))


def absent_as_nan(values: Floats) -> Floats:
    """Return the values with NaN for zeros."""
    return np.where(values == 0, np.nan, values)


def scale(coefficients: Floats) -> LogNorm:
    """Return a scale of colours over all magnitudes, at least a decade wide."""
    present = np.abs(coefficients[coefficients != 0])
    low, high = (present.min(), present.max()) if present.size else (1.0, 1.0)
    middle = np.sqrt(low) * np.sqrt(high)
    return LogNorm(float(min(low, middle / np.sqrt(10))), float(max(high, middle * np.sqrt(10))))


def heat_map(panel: Axes, values: Floats, norm: LogNorm) -> QuadMesh:
    """Draw cells of shape (objects, terms), the first object at the top."""
    colors = colormaps["cividis"].with_extremes(bad=ABSENT)
    mesh = panel.pcolormesh(_magnitudes(values), norm=norm, cmap=colors, edgecolors="white", linewidth=1)
    panel.invert_yaxis()
    panel.grid(False)
    panel.tick_params(length=0)
    panel.spines[:].set_visible(False)
    return mesh


def add_color_bar(figure: Figure, mesh: QuadMesh, panels: Sequence[Axes], width: float) -> None:
    """Put the scale of colours below panels that are so many inches wide."""
    low, high = mesh.get_clim()
    ticks = LogLocator(subs=(1, 3) if high < 1e3 * low else (1,))
    bar = figure.colorbar(mesh, ax=list(panels), location="bottom", aspect=4 * width, ticks=ticks, format="%g")
    bar.minorticks_off()
    bar.set_label("magnitude of coefficient (grey: term absent)")


def _print_values(panel: Axes, values: Floats, mesh: QuadMesh) -> None:
    """Print each coefficient in its cell, white on dark colours."""
    lightness = mesh.to_rgba(_magnitudes(values))[..., :3] @ (0.299, 0.587, 0.114)
    for i, k in np.argwhere(values):
        color = "white" if lightness[i, k] < 0.5 else "black"
        panel.text(k + 0.5, i + 0.5, number_text(values[i, k], 3), ha="center", va="center", fontsize=9, color=color)


def _magnitudes(values: Floats) -> Floats:
    return np.ma.masked_equal(np.abs(values), 0)
