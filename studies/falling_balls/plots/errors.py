"""Errors of several objects under several models: dots by category."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw.array_types import Floats
from commonlaw.plots.style import SETTINGS, add_legend, columns_for, frozen_layout, key, looks, plain, styled

_APART = 1.3 * SETTINGS["lines.markersize"]
"""Least distance between the middles of two dots, points."""

_MEDIAN: Mapping[str, Any] = {"color": "black", "linewidth": 2.2}


@styled()
def plot_errors(panels: Mapping[str, Mapping[str, Mapping[str, float]]], y_label: str) -> Figure:
    """Plot one number for each object as a dot, by category, with a line at each category's median.

    Dots that would cover each other stand side by side; their place across a category means nothing else. An infinite
    number, such as the error of a forecast that diverged, is an open mark at the upper edge, and a median that is
    infinite is not drawn.

    Parameters
    ----------
    panels
        By title of the panel, category and object: a number that is not negative.
    y_label
        Label of the y axes with its unit, such as ``"error (m)"``.
    """
    columns = columns_for(len(panels), 2)
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(2 + 4 * columns, 0.7 + 3.6 * lines), layout="constrained")
    drawn: list[Axes] = []
    values = np.array([each for groups in panels.values() for group in groups.values() for each in group.values()])
    finite = values[np.isfinite(values)]
    for i, (title, groups) in enumerate(panels.items()):
        panel = figure.add_subplot(lines, columns, i + 1)
        panel.set_title(plain(title, 60))
        panel.set_xlim(-0.5, len(groups) - 0.5)
        panel.set_ylim(0, 1.08 * finite.max() if finite.any() else 1)
        panel.set_xticks(range(len(groups)), [plain(name, 14) for name in groups])
        panel.grid(False, axis="x")
        if i % columns == 0:
            panel.set_ylabel(y_label)
        drawn.append(panel)
    look = looks(list(dict.fromkeys(name for groups in panels.values() for group in groups.values() for name in group)))
    keys = [key(plain(name), **each, linestyle="") for name, each in look.items()]
    keys.append(key("median", **_MEDIAN))
    if len(finite) < len(values):
        keys.append(key("infinite", color="black", marker="o", linestyle="", markerfacecolor="none"))
    add_legend(figure, keys)
    # Dots are spread by their size on paper, which is known when the layout is frozen
    frozen_layout(figure)
    for panel, groups in zip(drawn, panels.values(), strict=True):
        for index, group in enumerate(groups.values()):
            _draw(panel, index, group, look)
    return figure


def _draw(panel: Axes, index: int, group: Mapping[str, float], look: Mapping[str, Mapping[str, Any]]) -> None:
    """Draw the dots and the median of one category."""
    values = np.array(list(group.values()))
    heights = np.where(np.isfinite(values), values, panel.get_ylim()[1])
    scale = np.abs(np.diff(panel.transData.transform([(0, 0), (1, 1)]), axis=0)[0]) * 72 / panel.figure.dpi
    across = index + _spread(heights * scale[1]) / scale[0]
    for name, value, x, y in zip(group, values, across, heights, strict=True):
        fill = look[name]["color"] if np.isfinite(value) else "none"
        panel.plot(x, y, **look[name], linestyle="", markerfacecolor=fill, clip_on=False, zorder=3, label=name)
    median = np.median(values)
    if np.isfinite(median):
        panel.plot([index - 0.3, index + 0.3], [median, median], **_MEDIAN)


def _spread(heights: Floats) -> Floats:
    """Return how far each dot stands from the middle so that none covers another, in points as the heights are."""
    across = np.zeros(len(heights))
    placed: list[int] = []
    for i in np.argsort(heights, kind="stable"):
        step = 0
        while any(np.hypot(across[i] - across[k], heights[i] - heights[k]) < 0.99 * _APART for k in placed):
            step += 1
            # 0, 1, -1, 2, -2, ...
            across[i] = _APART * ((step + 1) // 2) * (1 if step % 2 else -1)
        placed.append(int(i))
    return across
