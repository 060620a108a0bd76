"""Curves with bands: one quantity against another, several panels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from commonlaw.plots.style import COLORS, MARKERS, add_legend, columns_for, frozen_layout, key, plain, styled


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve; those with the same label look alike in every panel.

    Parameters
    ----------
    label
        What it is, for the legend.
    x, y
        Points, each of shape (n,); the curve is broken where one is not finite.
    low, high
        Ends of an interval around each point, each of shape (n,); none by default.
    line
        How points are joined: a matplotlib line style, or ``""`` for points only.
    points
        Whether each point gets a marker.
    step
        Whether the curve keeps each value until the next x.
    """

    label: str
    x: ArrayLike
    y: ArrayLike
    low: ArrayLike | None = None
    high: ArrayLike | None = None
    line: str = "-"
    points: bool = False
    step: bool = False


@styled()
def plot_curves(
    panels: Mapping[str, Sequence[Curve]],
    x_label: str | Mapping[str, str],
    y_label: str | Mapping[str, str],
    *,
    log_x: bool = False,
    log_y: bool = False,
    columns: int | None = None,
    y_limits: tuple[float, float] | None = None,
    share_x: bool = True,
    share_y: bool = True,
) -> Figure:
    """Plot curves, one panel for each title, with one legend for all beside them.

    Parameters
    ----------
    panels
        Curves by the title of their panel; an empty title is not shown.
    x_label, y_label
        Labels of the axes with their units, such as ``"t (s)"``, or one by title.
    log_x, log_y
        Whether an axis is logarithmic.
    columns
        Panels side by side; by default as many as there are, up to three.
    y_limits
        Ends of the y axes.
    share_x, share_y
        Whether panels have the same scale.
    """
    columns = columns or columns_for(len(panels), 3)
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(1.9 + 3.4 * columns, 0.7 + 2.9 * lines), layout="constrained")
    labels = list(dict.fromkeys(curve.label for curves in panels.values() for curve in curves))
    indices = {label: i for i, label in enumerate(labels)}
    drawn: list[Axes] = []
    shared = [axis for axis, wanted in (("sharex", share_x), ("sharey", share_y)) if wanted]
    for i, (title, curves) in enumerate(panels.items()):
        panel = figure.add_subplot(lines, columns, i + 1, **dict.fromkeys(shared, drawn[0]) if drawn else {})
        for curve in curves:
            _draw(panel, curve, indices[curve.label])
        panel.set_title(plain(title, 60))
        panel.set_xlabel(x_label if isinstance(x_label, str) else x_label[title])
        y_name = y_label if isinstance(y_label, str) else y_label[title]
        if not (isinstance(y_label, str) and share_y and i % columns):
            panel.set_ylabel(y_name)
        if log_x:
            panel.set_xscale("log")
        if log_y:
            panel.set_yscale("log")
        if y_limits is not None:
            panel.set_ylim(y_limits)
        drawn.append(panel)
    shown = {curve.label: curve for curves in panels.values() for curve in curves}
    add_legend(figure, [key(plain(label), **_look(curve, indices[label])) for label, curve in shown.items()])
    return frozen_layout(figure)


def _draw(panel: Axes, curve: Curve, index: int) -> None:
    look = _look(curve, index)
    style = "steps-post" if curve.step else "default"
    panel.plot(np.asarray(curve.x), np.asarray(curve.y), drawstyle=style, **look)
    if curve.low is not None and curve.high is not None:
        step: Literal["post"] | None = "post" if curve.step else None
        panel.fill_between(curve.x, curve.low, curve.high, color=look["color"], alpha=0.18, linewidth=0, step=step)


def _look(curve: Curve, index: int) -> dict[str, Any]:
    marker = MARKERS[index % len(MARKERS)] if curve.points or not curve.line else ""
    return {"color": COLORS[index % len(COLORS)], "linestyle": curve.line, "marker": marker}
