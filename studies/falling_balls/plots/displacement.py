"""Distance from the start against time, on logarithmic axes."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from commonlaw.array_types import Floats
from commonlaw.plots.style import add_legend, axis_label, frozen_layout, key, looks, plain, styled
from commonlaw.trials import Trial, Trials


@styled()
def plot_displacement(trials: Trials) -> Figure:
    """Plot how far the first state of every trial is from its first sample, on logarithmic axes.

    Guide lines show constant rate (slope one) and constant acceleration (slope two), as in the paper's figure of the
    ball drops.
    """
    schema, look = trials.schema, looks(trials.objects)
    figure = Figure(figsize=(9, 5), layout="constrained")
    panel = figure.subplots()
    for trial in trials:
        panel.plot(*_displacement(trial), **look[trial.object], markevery=max(1, len(trial) // 12))
    name, time = schema.states[0], schema.time
    panel.set_ylabel(axis_label(f"|{name} − {name}(start)|", schema.units.get(name, "")))
    panel.set_xlabel(axis_label(f"{time} since start", schema.units.get(time, "")))
    _guide(panel, name)
    add_legend(figure, [key(plain(each), **own) for each, own in look.items()])
    return frozen_layout(figure)


def _displacement(trial: Trial) -> tuple[Floats, Floats]:
    """Return time since the first measured sample and the distance from it, where both are above zero."""
    values = trial.states[:, 0]
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
