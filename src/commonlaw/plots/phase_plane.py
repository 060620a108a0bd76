"""Phase planes with nullclines and fixed points."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.forecast import Forecast, fitted
from commonlaw.law import Law
from commonlaw.law.equilibria import depends_on, fixed_points, has_phase_plane, kind
from commonlaw.law.parameters import followed_coefficients, rate_names, units_with_rates
from commonlaw.library.notation import latex_name
from commonlaw.plots.forecast import of_objects, representative
from commonlaw.plots.style import (
    COLORS,
    add_legend,
    columns_for,
    frozen_layout,
    key,
    math,
    plain,
    show_lowest_ticks,
    styled,
    unit_text,
)
from commonlaw.runtime.arguments import checks_types
from commonlaw.trials import Trials

_MARKS: Mapping[str, Mapping[str, object]] = {
    "stable": {"markerfacecolor": "black"},
    "unstable": {"markerfacecolor": "white"},
    "saddle": {"marker": "X", "markerfacecolor": "white"},
    "centre": {"marker": "D", "markerfacecolor": "white"},
}


@styled()
@checks_types
def plot_phase_plane(
    law: Law, trials: Trials | Forecast, name: str | None = None, inputs: Mapping[str, float] | None = None
) -> Figure:
    """Plot the phase plane: flow, nullclines, fixed points with their stability, and fitted trajectories.

    For laws of two states of first order, or of one of second order (state and rate). With observation equations it is
    the plane of the states. If both states were measured, points are measurements.

    Raises `CommonlawError` if the law has other states, or time in its terms.

    Parameters
    ----------
    law, trials
        A law, and trials to fit, or a forecast whose trajectories are drawn.
    name
        An object. By default each has a panel, of many those evenly spaced by the rank of their RMS error, all on the
        same axes; or there is one for all, if they have the same coefficients.
    inputs
        Values of the inputs, by default zero.
    """
    states = len(law.schema.states)
    if not has_phase_plane(law):
        is_of_time = depends_on(law, law.terms.variables.time)
        raise CommonlawError("phase-plane-time" if is_of_time else "phase-plane-states", states=law.schema.states)
    held = {signal: (inputs or {}).get(signal, 0.0) for signal in law.schema.inputs}
    if isinstance(trials, Trials):
        trials = fitted(law, trials if name is None else trials.select(object=name))
    forecast = of_objects(trials, representative(trials) if name is None else [name])
    smooth, objects = forecast.smooth(), forecast.trials.objects
    coefficients = [followed_coefficients(law, owner) for owner in objects]
    shared = len(objects) > 1 and np.allclose(coefficients, coefficients[:1], rtol=1e-9, atol=0.0)
    observed = law.observation.equations
    columns = [j for j, state in enumerate(forecast.trials.schema.states) if state not in observed]
    curves = [
        (trial.object, path[:, :2], trial.states[:, columns] if len(columns) == 2 else np.empty((0, 2)))
        for trial, path in zip(forecast.trials, smooth.solutions, strict=True)
    ]
    drawn = np.concatenate([points for _, *both in curves for points in both])
    drawn = drawn[np.isfinite(drawn).all(axis=1)]
    low, high = drawn.min(axis=0), drawn.max(axis=0)
    margin = 0.15 * np.where(high > low, high - low, np.maximum(np.abs(high), 1.0))
    # States that are nowhere negative have a boundary at zero, where fixed points often are
    low = np.where((low >= 0) & (low < high), np.minimum(low - margin, -0.25 * margin), low - margin)
    high = high + margin
    names = law.schema.states if states == 2 else (law.schema.states[0], rate_names(law)[0])
    labels = [math(latex_name(name), name) for name in names]
    titles = {objects[0]: "all objects"} if shared else {owner: plain(owner, 60) for owner in objects}

    across = columns_for(len(titles), 3)
    lines, size = -(-len(titles) // across), (6.4, 5.0) if len(titles) == 1 else (3.0, 2.6)
    figure = Figure(figsize=(size[0] * across, size[1] * lines + 0.6), layout="constrained")
    panels = list[Axes]()
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 240 + 1).T), axis=-1)
    keys = dict[str, Line2D]()
    for i, (owner, title) in enumerate(titles.items()):
        panel = figure.add_subplot(lines, across, i + 1)
        panels.append(panel)
        rates = _rates(law, owner, [*held.values()], grid.reshape(-1, 2)).reshape(grid.shape)
        across_rate, up_rate = np.moveaxis(rates, -1, 0)
        density = 1.1 if len(titles) == 1 else 0.6
        panel.streamplot(
            grid[0, :, 0], grid[:, 0, 1], across_rate, up_rate,
            color="#c9c9c9", density=density, linewidth=0.7, arrowsize=0.8,
        )  # fmt: skip
        for j, (label, color) in enumerate(zip(labels, (COLORS[1], COLORS[2]), strict=True)):
            if np.nanmin(rates[..., j]) < 0 < np.nanmax(rates[..., j]):
                panel.contour(grid[..., 0], grid[..., 1], rates[..., j], [0.0], colors=[color], linewidths=1.8)
                keys[f"{label} constant"] = key(f"{label} constant", color=color, linewidth=1.8)
        for _, path, points in (curve for curve in curves if shared or curve[0] == owner):
            panel.plot(*points.T, ".", color=COLORS[0], alpha=0.35, markersize=4, markeredgewidth=0)
            panel.plot(*path.T, color=COLORS[0])
            panel.plot(*path[0], ">", color=COLORS[0], markersize=5)
        keys[smooth.title] = key(f"{smooth.title}, from its initial state", color=COLORS[0], marker=">", markevery=[0])
        for point, values in fixed_points(law, followed_coefficients(law, owner), low[:states], high[:states], held):
            look: dict[str, Any] = {"marker": "o", "color": "black", **_MARKS.get(kind(values).split()[0], {})}
            panel.plot(*np.append(point, 0.0)[:2], **look, markersize=8, zorder=5)
            keys[kind(values)] = key(kind(values), linestyle="", **look)
        panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        panel.set_title(", ".join([title, *(f"{plain(signal)} = {value:g}" for signal, value in held.items())]))
    units = (unit_text(units_with_rates(law).get(name, "")) for name in names)
    across_label, up_label = (f"{label} ({unit})" if unit else label for label, unit in zip(labels, units, strict=True))
    show_lowest_ticks(panels, across, across_label)
    for panel in panels[::across]:
        panel.set_ylabel(up_label)
    add_legend(figure, [*keys.values()], "below")
    return frozen_layout(figure)


def _rates(law: Law, owner: str, inputs: Sequence[float], points: Floats) -> Floats:
    """Return the right-hand side at points of the plane, both of shape (n, 2)."""
    values = np.column_stack([points, np.tile([*inputs, 0.0], (len(points), 1))])
    with np.errstate(all="ignore"):
        rates = law.rhs(owner, values)
    return rates if rates.shape[1] == 2 else np.column_stack([points[:, 1], rates[:, 0]])
