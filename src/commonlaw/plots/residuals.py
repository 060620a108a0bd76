"""Residuals and errors of a law, and its discrepancy."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import NormalDist

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw.array_types import Floats, thinned
from commonlaw.discrepancy.function import Discrepancy
from commonlaw.discrepancy.residual_tests import Residuals
from commonlaw.forecast import Forecast
from commonlaw.law import Law
from commonlaw.law.quantiles import two_sided
from commonlaw.plots.forecast import Curve, curves_of
from commonlaw.plots.style import (
    BAND,
    COLORS,
    GREY,
    add_legend,
    axis_label,
    fitting,
    frozen_layout,
    key,
    plain,
    styled,
)
from commonlaw.runtime.arguments import checks_types


@styled()
@checks_types
def plot_residuals(residuals: Residuals) -> Figure:
    """Plot standardized residuals, one row for each state.

    Panels: residuals against elapsed time, states, rates and inputs, with binned means and their 95 % intervals;
    against residuals of other states; autocorrelation, with the 95 % range of white noise; and a normal quantile plot.
    """
    states = residuals.trials.schema.states
    rows = [_panels(residuals, j) for j in range(len(states))]
    columns = min(len(rows[0]), 4)
    lines = -(-len(rows[0]) // columns)
    figure = Figure(figsize=fitting(1.2 + 2.3 * columns, 0.6 + 2.2 * len(states) * lines), layout="constrained")
    grid = figure.add_gridspec(len(states) * lines, columns)
    for j, row in enumerate(rows):
        for k, (_, draw) in enumerate(row):
            draw(figure.add_subplot(grid[j * lines + k // columns, k % columns]))
        figure.axes[-len(row)].set_ylabel(plain(f"residual of {states[j]} / noise"))
    return frozen_layout(figure)


@dataclass(frozen=True, eq=False)
class ResidualPanels:
    """Panels of `plot_residuals`, each as a small figure.

    Examples
    --------
    >>> import commonlaw as cl
    >>> drops = cl.datasets.linear_drag(noise=0.05, trials=1)
    >>> panels = ResidualPanels(cl.fit("x'' = -g - c v", drops).residuals(drops))
    >>> panels.captions(0)[0]
    'Against t since the start of the trial.'
    """

    residuals: Residuals

    def captions(self, state: int) -> list[str]:
        """Return the captions of the panels of a state, by its index."""
        return [caption for caption, _ in _panels(self.residuals, state)]

    @styled()
    def draw(self, state: int, panel: int) -> Figure:
        """Return the figure of one panel, by the indices of state and panel."""
        figure = Figure(figsize=(3.6, 2.4), layout="constrained")
        axes = figure.add_subplot()
        _panels(self.residuals, state)[panel][1](axes)
        if not axes.get_ylabel():
            axes.set_ylabel("residual / noise")
        return frozen_layout(figure)


def _panels(residuals: Residuals, j: int) -> list[tuple[str, Callable[[Axes], None]]]:
    """Return what the panels of a state show, and what draws them."""
    schema, whole = residuals.trials.schema, np.concatenate(residuals.standardized)
    units = {**residuals.rates, **schema.units}
    result: list[tuple[str, Callable[[Axes], None]]] = []
    for name, values in residuals.columns.items():
        since = " since the start of the trial" if name == schema.time else ""
        label = axis_label(name, units.get(name, ""))
        result.append((f"Against {name}{since}.", partial(_against, values=values, own=whole[:, j], label=label)))
    if len(schema.states) > 1:
        following = (j + 1) % len(schema.states)
        label = plain(f"residual of {schema.states[following]} / noise")
        caption = f"Against the residuals of {schema.states[following]}."
        result.append((caption, partial(_against, values=whole[:, following], own=whole[:, j], label=label)))
    caption = "Autocorrelation by lag in samples; 95 % of white noise lies in the grey range."
    result.append((caption, partial(_memory, residuals=residuals, j=j)))
    caption = "Normal quantile plot; the line is that of normal errors."
    return [*result, (caption, partial(_quantiles, own=whole[:, j]))]


def _against(panel: Axes, values: Floats, own: Floats, label: str) -> None:
    panel.set_xlabel(label)
    panel.locator_params(axis="x", nbins=6)
    seen = np.flatnonzero(np.isfinite(own) & np.isfinite(values))
    some = seen[thinned(len(seen))]
    panel.plot(values[some], own[some], ".", color=GREY, markersize=2)
    panel.axhline(0.0, color="black", linewidth=0.8)
    count = min(10, max(1, len(seen) // 4))
    parts = [part for part in np.array_split(seen[np.argsort(values[seen])], count) if len(part)]
    means = [[values[part].mean(), own[part].mean(), own[part].std() / np.sqrt(len(part))] for part in parts]
    middle, mean, error = np.array(means).reshape(-1, 3).T
    panel.errorbar(middle, mean, 1.96 * error, color=COLORS[1], capsize=2, markersize=3, marker="o")


def _memory(panel: Axes, residuals: Residuals, j: int) -> None:
    # Farther apart there are too few pairs to tell
    lags = min(20, max(1, max(map(len, residuals.trials)) // 2))
    count = np.isfinite(np.concatenate(residuals.standardized)[:, j]).sum()
    panel.bar(np.arange(1, lags + 1), residuals.correlations(j, lags), color=COLORS[0], width=0.6)
    panel.axhspan(-1.96 / np.sqrt(max(count, 1)), 1.96 / np.sqrt(max(count, 1)), color=GREY, alpha=0.25)
    panel.set_xlabel("lag (samples)")
    panel.set_ylabel("correlation")


def _quantiles(panel: Axes, own: Floats) -> None:
    ordered = np.sort(own[np.isfinite(own)])
    normal = [NormalDist().inv_cdf((i + 0.5) / len(ordered)) for i in range(len(ordered))]
    parts = slice(50), thinned(len(ordered)), slice(-50, None)  # All at the ends, and some between
    some = np.unique(np.concatenate([np.arange(len(ordered))[part] for part in parts]))
    panel.plot(np.array(normal)[some], ordered[some], ".", color=COLORS[0], markersize=2)
    panel.axline((0.0, 0.0), slope=1.0, color="black", linewidth=0.8)
    panel.set_xlabel("normal quantile")
    panel.set_ylabel("residual / noise")


@styled()
@checks_types
def plot_errors(forecast: Forecast) -> Figure:
    """Plot forecast errors (forecast minus measured states) of all trials against time, a panel for each state.

    Errors outside the 95 % bands are orange; the axes exclude outliers among the largest 1 %.
    """
    schema = forecast.trials.schema
    states, curves = schema.states, curves_of(forecast, forecast)
    figure = Figure(figsize=(5.2, 0.8 + 2.2 * len(states)), layout="constrained")
    panels = figure.subplots(len(states), 1, sharex=True, squeeze=False)[:, 0]
    some_outside = False
    for j, (panel, state) in enumerate(zip(panels, states, strict=True)):
        drawn = [curve for name in forecast.trials.objects for curve in curves[name, j]]
        times, errors, outside = np.concatenate([_errors(curve) for curve in drawn], axis=1)
        some_outside |= bool(outside.any())
        every = thinned(len(times))
        panel.axhline(0, color=GREY, linewidth=0.8)
        for kind, color in ((outside == 0, COLORS[0]), (outside == 1, COLORS[1])):
            panel.plot(times[kind][every], errors[kind][every], "o", color=color, markersize=3, alpha=0.5, mew=0)
        if len(errors):
            usual, largest = np.quantile(np.abs(errors), [0.99, 1.0])
            bound = 1.1 * min(3 * usual, largest) or 1.0
            panel.set_ylim(-bound, bound)
        panel.set_ylabel(axis_label(f"error of {state}", schema.units.get(state, "")))
    panels[-1].set_xlabel(axis_label(schema.time, schema.units.get(schema.time, "")))
    if forecast.std is not None:
        dot = {"marker": "o", "linestyle": "", "markersize": 4}
        keys = [key("within the 95 % band", color=COLORS[0], **dot), key("outside", color=COLORS[1], **dot)]
        add_legend(figure, keys if some_outside else keys[:1], "above")
    return frozen_layout(figure)


def _errors(curve: Curve) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times, errors and whether the band did not hold them, each of shape (n,)."""
    low, high = (np.interp(curve.compared, curve.at, end - curve.forecast) for end in (curve.low, curve.high))
    known = bool((curve.high > curve.low).any())
    outside = ((-curve.error < low) | (-curve.error > high)) if known else np.zeros(len(curve.error))
    return curve.compared, curve.error, outside.astype(np.float64)


@styled()
@checks_types
def plot_discrepancy(found: Discrepancy[Law]) -> Figure:
    """Plot a discrepancy as a function of its coordinate, with a 95 % band and the density of samples.

    Outside the dotted lines, the range of the data, it is an extrapolation.
    """
    basis, more = found.basis, 0.15 * found.basis.range
    along = np.linspace(basis.low - more, basis.high + more, 200)
    function, half = found(along), two_sided(0.95) * found.std(along)
    figure = Figure(figsize=(5.4, 4.4), layout="constrained")
    grid = figure.add_gridspec(2, 1, height_ratios=(4, 1))
    upper = figure.add_subplot(grid[0])
    lower = figure.add_subplot(grid[1], sharex=upper)
    upper.fill_between(along, function - half, function + half, color=COLORS[0], **BAND)
    upper.plot(along, function, color=COLORS[0])
    upper.axhline(0.0, color=GREY, linewidth=0.8)
    for end in (basis.low, basis.high):
        upper.axvline(end, color=GREY, linestyle=":", linewidth=0.8)
    upper.tick_params(labelbottom=False)
    target = found.equation if basis.times == "1" else f"{found.equation} over {basis.times}"
    upper.set_ylabel(plain(f"discrepancy of {target}", 40))
    upper.set_title(plain(f"2 log B = {found.evidence:.1f} relative to the law alone", 60), loc="left")
    lower.hist(found.visited, bins=40, color=GREY)
    lower.set_ylabel("samples")
    lower.set_xlabel(plain(basis.coordinate, 60))
    keys = [key("function", color=COLORS[0]), key("95 % band", color=COLORS[0], linewidth=6, alpha=0.3)]
    add_legend(figure, keys, "above")
    return frozen_layout(figure)
