"""What measurements are off the trajectories of a law."""

from statistics import NormalDist

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw.array_types import Floats
from commonlaw.law.residuals import Residuals
from commonlaw.plots.style import COLORS, GREY, axis_label, frozen_layout, plain, styled

_MOST = 3000
"""Residuals that are drawn in a panel."""

_LAGS = 20


@styled()
def plot_residuals(residuals: Residuals) -> Figure:
    """Plot residuals over noise, one row for each state.

    Against time since the trial's start, states, rates and inputs, with the mean in tenths of what was visited; against
    the next state's, if there are several; the correlation of neighbours, with the range in which 95 % lie by chance;
    and their quantiles beside those of a normal distribution.

    Parameters
    ----------
    residuals
        What `Law.residuals` returned.
    """
    schema, whole = residuals.trials.schema, np.concatenate(residuals.standardized)
    states, columns = schema.states, residuals.columns
    panels = len(columns) + (len(states) > 1) + 2
    figure = Figure(figsize=(1.2 + 2.3 * panels, 0.6 + 2.2 * len(states)), layout="constrained")
    grid = figure.add_gridspec(len(states), panels)
    for j, name in enumerate(states):
        row = [figure.add_subplot(grid[j, k]) for k in range(panels)]
        row[0].set_ylabel(plain(f"residual of {name} / noise"))
        for panel, (other, values) in zip(row, columns.items(), strict=False):
            _against(panel, values, whole[:, j])
            panel.set_xlabel(axis_label(other, schema.units.get(other, "")))
        if len(states) > 1:
            following = (j + 1) % len(states)
            _against(row[len(columns)], whole[:, following], whole[:, j])
            row[len(columns)].set_xlabel(plain(f"residual of {states[following]} / noise"))
        _memory(row[-2], residuals, j)
        _quantiles(row[-1], whole[:, j])
    return frozen_layout(figure)


def _against(panel: Axes, values: Floats, own: Floats) -> None:
    seen = np.flatnonzero(np.isfinite(own) & np.isfinite(values))
    some = seen[:: -(-len(seen) // _MOST) or 1]
    panel.plot(values[some], own[some], ".", color=GREY, markersize=2)
    panel.axhline(0.0, color="black", linewidth=0.8)
    parts = [part for part in np.array_split(seen[np.argsort(values[seen])], 10) if len(part)]
    means = [[values[part].mean(), own[part].mean(), own[part].std() / np.sqrt(len(part))] for part in parts]
    middle, mean, error = np.array(means).reshape(-1, 3).T
    panel.errorbar(middle, mean, 1.96 * error, color=COLORS[1], capsize=2, markersize=3, marker="o")


def _memory(panel: Axes, residuals: Residuals, j: int) -> None:
    # Farther apart there are too few pairs to tell
    lags = min(_LAGS, max(1, max(map(len, residuals.trials)) // 2))
    count = np.isfinite(np.concatenate(residuals.standardized)[:, j]).sum()
    panel.bar(np.arange(1, lags + 1), residuals.correlations(j, lags), color=COLORS[0], width=0.6)
    panel.axhspan(-1.96 / np.sqrt(max(count, 1)), 1.96 / np.sqrt(max(count, 1)), color=GREY, alpha=0.25)
    panel.set_xlabel("samples later")
    panel.set_ylabel("correlation")


def _quantiles(panel: Axes, own: Floats) -> None:
    ordered = np.sort(own[np.isfinite(own)])
    normal = [NormalDist().inv_cdf((i + 0.5) / len(ordered)) for i in range(len(ordered))]
    panel.plot(normal, ordered, ".", color=COLORS[0], markersize=2)
    panel.axline((0.0, 0.0), slope=1.0, color="black", linewidth=0.8)
    panel.set_xlabel("normal quantile")
    panel.set_ylabel("residual / noise")
