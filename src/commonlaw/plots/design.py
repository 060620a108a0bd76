"""What plausible laws forecast of experiments that are still to be made."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw.experiments.plan import Design, Forecasts
from commonlaw.law.quantiles import two_sided
from commonlaw.plots.style import COLORS, DASHES, axis_label, fitting, frozen_layout, key, plain, styled

_MAX_DRAWN = 4
"""Of experiments, and of laws, that are drawn."""


@styled()
def plot_design(design: Design) -> Figure:
    """Plot each plausible law's forecast of the first trials of the design, with 95 % bands of the measurements.

    Shown are differences from the forecast of the most probable law, or ratios on a logarithmic scale. Where bands
    part, one measurement distinguishes the laws. Of an experiment with every object, the first one is drawn.
    """
    drawn, schema = design.experiments[:_MAX_DRAWN], design.laws[0].law.schema
    states = drawn[0].forecasts.states
    size = fitting(max(5.4, 3.4 * len(states)), 0.8 + 2.5 * len(drawn))
    figure = Figure(figsize=size, layout="constrained")
    panels = figure.subplots(len(drawn), len(states), squeeze=False)
    for i, each in enumerate(drawn):
        for j, name in enumerate(states):
            _draw(panels[i, j], each.forecasts, j)
            panels[i, j].set_ylabel(_label(each.forecasts, name, schema.units.get(name, "")))
        panels[i, 0].set_title(plain(f"{i + 1}. {each.text}", 60 * len(states)), loc="left", fontsize=9)
    for panel in panels[-1]:
        panel.set_xlabel(axis_label(schema.time, schema.units.get(schema.time, "")))
    laws = enumerate(design.laws[:_MAX_DRAWN])
    keys = [key(plain(f"{'; '.join(own.law.structure)}  ({own.probability:.2f})", 60), **_look(k)) for k, own in laws]
    figure.legend(handles=keys, loc="outside upper left")
    return frozen_layout(figure)


def _look(index: int) -> dict[str, Any]:
    return {"color": COLORS[index % len(COLORS)], "linestyle": DASHES[index % len(DASHES)]}


def _label(forecasts: Forecasts, name: str, unit: str) -> str:
    if name in forecasts.logarithmic:
        return axis_label(f"{name} / first law")
    return axis_label(f"{name} − first law", unit)


def _draw(panel: Axes, forecasts: Forecasts, state: int) -> None:
    half, first = two_sided(0.95), forecasts.means[0]
    for k, (mean, std) in enumerate(zip(forecasts.means[:_MAX_DRAWN], forecasts.std[:_MAX_DRAWN], strict=True)):
        low, middle, high = ((mean - first + side * half * std)[:, state] for side in (-1, 0, 1))
        if forecasts.states[state] in forecasts.logarithmic:
            low, middle, high = np.exp(low), np.exp(middle), np.exp(high)
        panel.fill_between(forecasts.times, low, high, color=COLORS[k % len(COLORS)], alpha=0.18, linewidth=0)
        panel.plot(forecasts.times, middle, **_look(k))
