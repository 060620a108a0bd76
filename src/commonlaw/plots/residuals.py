"""What measurements are off the trajectories of a law."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import NormalDist

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw.array_types import Floats
from commonlaw.discrepancy.patterns import Residuals
from commonlaw.plots.style import COLORS, GREY, axis_label, frozen_layout, plain, styled

_MOST = 1500
"""Residuals that are drawn in a panel."""

_PARTS, _IN_PART = 10, 4
"""Means are of so many parts of what was visited, each of so many residuals at least."""

_AT_ENDS = 50
"""Of the largest and smallest residuals."""

_LAGS = 20


@styled()
def plot_residuals(residuals: Residuals) -> Figure:
    """Plot residuals over noise, one row for each state.

    Against time since the trial's start, states, rates and inputs, with means and their 95 % intervals in tenths of
    what was visited; against the next state's, if there are several; the correlation of neighbours, with the range in
    which 95 % lie by chance; and their quantiles beside those of a normal distribution.

    Parameters
    ----------
    residuals
        What `Law.residuals` returned.
    """
    states = residuals.trials.schema.states
    rows = [_panels(residuals, j) for j in range(len(states))]
    columns = len(rows[0])
    figure = Figure(figsize=(1.2 + 2.3 * columns, 0.6 + 2.2 * len(states)), layout="constrained")
    grid = figure.add_gridspec(len(states), columns)
    for j, row in enumerate(rows):
        for k, (_, draw) in enumerate(row):
            draw(figure.add_subplot(grid[j, k]))
        figure.axes[-columns].set_ylabel(plain(f"residual of {states[j]} / noise"))
    return frozen_layout(figure)


@dataclass(frozen=True, eq=False)
class ResidualPanels:
    """The panels of `plot_residuals`, each as a small figure of its own.

    Parameters
    ----------
    residuals
        What `Law.residuals` returned.
    """

    residuals: Residuals

    def captions(self, state: int) -> list[str]:
        """Return what each panel of a state shows."""
        return [caption for caption, _ in _panels(self.residuals, state)]

    @styled()
    def draw(self, state: int, panel: int) -> Figure:
        """Return the figure of a panel of a state."""
        figure = Figure(figsize=(3.6, 2.4), layout="constrained")
        axes = figure.add_subplot()
        _panels(self.residuals, state)[panel][1](axes)
        if not axes.get_ylabel():
            axes.set_ylabel("residual / noise")
        return frozen_layout(figure)


def _panels(residuals: Residuals, j: int) -> list[tuple[str, Callable[[Axes], None]]]:
    """Return what the panels of a state show, and what draws them."""
    schema, whole = residuals.trials.schema, np.concatenate(residuals.standardized)
    found: list[tuple[str, Callable[[Axes], None]]] = []
    for name, values in residuals.columns.items():
        since = " since the start of the trial" if name == schema.time else ""
        label = axis_label(name, schema.units.get(name, ""))
        found.append((f"Against {name}{since}.", partial(_against, values=values, own=whole[:, j], label=label)))
    if len(schema.states) > 1:
        following = (j + 1) % len(schema.states)
        label = plain(f"residual of {schema.states[following]} / noise")
        caption = f"Against the residuals of {schema.states[following]}."
        found.append((caption, partial(_against, values=whole[:, following], own=whole[:, j], label=label)))
    chance = "Correlation with residuals so many samples later; 95 % lie in the grey range by chance."
    quantiles = "Sorted, beside the line on which normal errors lie."
    return [
        *found,
        (chance, partial(_memory, residuals=residuals, j=j)),
        (quantiles, partial(_quantiles, own=whole[:, j])),
    ]


def _against(panel: Axes, values: Floats, own: Floats, label: str) -> None:
    panel.set_xlabel(label)
    seen = np.flatnonzero(np.isfinite(own) & np.isfinite(values))
    some = seen[:: -(-len(seen) // _MOST) or 1]
    panel.plot(values[some], own[some], ".", color=GREY, markersize=2)
    panel.axhline(0.0, color="black", linewidth=0.8)
    count = min(_PARTS, max(1, len(seen) // _IN_PART))
    parts = [part for part in np.array_split(seen[np.argsort(values[seen])], count) if len(part)]
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
    some = np.unique(np.concatenate([np.arange(len(ordered))[part] for part in _parts(len(ordered))]))
    panel.plot(np.array(normal)[some], ordered[some], ".", color=COLORS[0], markersize=2)
    panel.axline((0.0, 0.0), slope=1.0, color="black", linewidth=0.8)
    panel.set_xlabel("normal quantile")
    panel.set_ylabel("residual / noise")


def _parts(count: int) -> tuple[slice, slice, slice]:
    """Return which of many sorted values are drawn: all at the ends, and some between."""
    return slice(_AT_ENDS), slice(None, None, -(-count // _MOST) or 1), slice(-_AT_ENDS, None)
