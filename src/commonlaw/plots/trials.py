"""Measured states against time."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from commonlaw.array_types import Floats
from commonlaw.errors import unknown
from commonlaw.plots.curves import Curve
from commonlaw.plots.style import DASHES, GREY, add_legend, axis_label, key, looks, plain, settled, styled
from commonlaw.trials import Trial, Trials


@styled()
def plot_trials(
    trials: Trials,
    state: str | None = None,
    objects: Sequence[str] | None = None,
    displacement: bool = False,
    references: Sequence[Curve] = (),
) -> Figure:
    """Plot measured states against time: a colour and marker for each object, a line style for each trial.

    Parameters
    ----------
    trials
        What was measured.
    state
        One state; all of them by default, one panel each.
    objects
        Some of the objects; they keep the colours that they have among all.
    displacement
        Plot the distance from the first sample on logarithmic axes, with guide lines of constant rate (slope one)
        and constant acceleration (slope two), as in the founding paper's figure of the ball drops.
    references
        Curves to compare with, such as a simulated fall: black, in their own line styles, in every panel.

    Raises
    ------
    CommonlawError
        If the state or an object is not among the trials'.
    """
    schema = trials.schema
    if state is not None and state not in schema.states:
        raise unknown("state", state, schema.states)
    states = schema.states if state is None else (state,)
    chosen = trials if objects is None else trials.select(object=objects if isinstance(objects, str) else list(objects))
    figure = Figure(figsize=(9, 2 + 3 * len(states)), layout="constrained")
    panels = figure.subplots(len(states), 1, sharex=True, squeeze=False)[:, 0]
    look, dashes = looks(trials.objects), _dashes(chosen)
    for panel, name in zip(panels, states, strict=True):
        column, unit = schema.states.index(name), schema.units.get(name, "")
        for trial in chosen:
            times, values = _displacement(trial, column) if displacement else (trial.times, trial.states[:, column])
            panel.plot(
                times,
                values,
                dashes.get(trial.name, "-"),
                color=look[trial.object].color,
                marker=look[trial.object].marker,
                markevery=max(1, len(trial) // 12),
            )
        for curve in references:
            panel.plot(np.asarray(curve.x), np.asarray(curve.y), **_reference(curve))
        panel.set_ylabel(axis_label(f"|{name} − {name}(start)|" if displacement else name, unit))
        if displacement:
            _guide(panel, name)
    time = f"{schema.time} since start" if displacement else schema.time
    panels[-1].set_xlabel(axis_label(time, schema.units.get(schema.time, "")))
    keys = [key(plain(name), color=look[name].color, marker=look[name].marker) for name in chosen.objects]
    keys += [key(plain(f"{schema.trial} {name}"), color=GREY, linestyle=dash) for name, dash in dashes.items()]
    keys += [key(plain(curve.label), **_reference(curve)) for curve in references]
    add_legend(figure, keys)
    return settled(figure)


def _reference(curve: Curve) -> dict[str, Any]:
    """Return how a curve to compare with looks: wider than those of the trials, and above them."""
    return {"color": "black", "linestyle": curve.line, "linewidth": 2.4, "zorder": 3}


def _dashes(trials: Trials) -> dict[str, str]:
    """Return the line style of each trial label; none if there is one label, or more labels than line styles."""
    names = list(dict.fromkeys(trial.name for trial in trials))
    return dict(zip(names, DASHES, strict=False)) if 1 < len(names) <= len(DASHES) else {}


def _displacement(trial: Trial, column: int) -> tuple[Floats, Floats]:
    """Return time since the first measured sample and the distance from it, where both are above zero."""
    values = trial.states[:, column]
    first = int(np.argmin(np.isnan(values)))
    distance = np.abs(values - values[first])
    moved = distance > 0
    return trial.times[moved] - trial.times[first], distance[moved]


def _guide(panel: Axes, name: str) -> None:
    """Make the axes logarithmic, show the later segments, and draw the guide lines above the curves."""
    points = np.concatenate([np.asarray(line.get_xydata()) for line in panel.get_lines()])
    if not len(points):
        panel.text(0.5, 0.5, plain(f"{name} does not change"), ha="center", transform=panel.transAxes)
        return
    panel.set(xscale="log", yscale="log")
    end = points[:, 0].max()
    shown = points[points[:, 0] >= end / 15]
    later = points[points[:, 0] >= end / 8]
    highest = 1.3 * np.max(later[:, 1] * (end / later[:, 0]) ** 2)
    for slope, what in ((1, "constant rate, slope 1"), (2, "constant acceleration, slope 2")):
        start = (end / 8, highest / 8**slope)
        panel.plot((start[0], end), (start[1], highest), color="#bbbbbb", linewidth=2.5)
        panel.text(
            *start,
            f"  {what}",
            color="#555555",
            rotation=np.degrees(np.arctan2(slope * start[1], start[0])),
            rotation_mode="anchor",
            transform_rotates_text=True,
            verticalalignment="bottom",
        )
    panel.set_xlim(end / 16, end * 1.1)
    panel.set_ylim(max(shown[:, 1].min() / 1.2, highest / 1e4), highest * 1.3)
    for axis in (panel.xaxis, panel.yaxis):
        axis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())
