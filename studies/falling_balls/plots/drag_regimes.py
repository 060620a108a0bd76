"""The drag coefficient of a sphere against the Reynolds number."""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw.datasets.sphere_drag import MAX_REYNOLDS, STOKES, drag_coefficient
from commonlaw.plots.style import COLORS, GREY, add_legend, frozen_layout, key, looks, plain, styled

_SPAN = (1e-1, 1e7)

REGIMES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "attached, or\nsteady separation": (_SPAN[0], 300.0),
        "unsteady\nlaminar": (300.0, 800.0),
        "chaotic wake": (800.0, MAX_REYNOLDS),
        "turbulent\nboundary layer": (MAX_REYNOLDS, _SPAN[1]),
    }
)
"""Regimes of the flow around a smooth sphere and the Reynolds numbers of their ends, which are soft.

The wake sheds vortices from 300 on and becomes turbulent from 800 on (Sakamoto and Haniu, A study on vortex shedding
from spheres in a uniform flow, J. Fluids Eng. 112 (1990) 386).
"""

_NONE: Mapping[str, tuple[float, float]] = MappingProxyType({})


@styled()
def plot_drag_regimes(ranges: Mapping[str, tuple[float, float]] = _NONE) -> Figure:
    """Plot the drag coefficient of a smooth sphere, and below it where objects move in it.

    The curve is `commonlaw.datasets.sphere_drag.drag_coefficient`, dashed where it does not hold, beside Stokes' law
    for slow flow; the regimes of the flow are shaded (the founding paper's figure of the sphere's drag).

    Parameters
    ----------
    ranges
        Smallest and largest Reynolds number of each object.
    """
    heights = [4.4, 0.4 + 0.26 * len(ranges)][: 2 if ranges else 1]
    figure = Figure(figsize=(9, sum(heights)), layout="constrained")
    panels = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    _draw_curve(panels[0])
    if ranges:
        _draw_ranges(panels[1], ranges)
    for panel in panels:
        for i, (start, stop) in enumerate(REGIMES.values()):
            panel.axvspan(start, stop, color=COLORS[0], alpha=0.04 + 0.05 * (i % 2), linewidth=0)
    panels[-1].set_xlabel("Reynolds number")
    add_legend(
        figure,
        [
            key("smooth sphere", color=COLORS[0], linewidth=2),
            key("beyond its range:\nno drag crisis", color=COLORS[0], linewidth=2, linestyle="--"),
            key("Stokes: 24/Re", color=GREY, linestyle="-."),
        ],
    )
    return frozen_layout(figure)


def _draw_curve(panel: Axes) -> None:
    for start, stop, line in ((_SPAN[0], MAX_REYNOLDS, "-"), (MAX_REYNOLDS, _SPAN[1], "--")):
        numbers = np.geomspace(start, stop, 200)
        panel.plot(numbers, drag_coefficient(numbers), line, color=COLORS[0], linewidth=2)
    panel.set(xscale="log", yscale="log", xlim=_SPAN, ylim=(0.05, 400), ylabel="drag coefficient")
    slow = np.array([_SPAN[0], 1e3])
    panel.plot(slow, STOKES / slow, "-.", color=GREY)
    for name, (start, stop) in REGIMES.items():
        panel.text(np.sqrt(start * stop), 300, name, ha="center", va="top", fontsize=9, color="#333333")


def _draw_ranges(panel: Axes, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Draw a bar for each object, the first at the top."""
    look = looks(list(ranges))
    for i, (name, (low, high)) in enumerate(ranges.items()):
        panel.plot([low, high], [i, i], color=look[name]["color"], linewidth=6, solid_capstyle="butt")
    panel.set_yticks(range(len(ranges)), [plain(name, 60) for name in ranges])
    panel.set_ylim(len(ranges) - 0.4, -0.6)
    panel.grid(False, axis="y")
