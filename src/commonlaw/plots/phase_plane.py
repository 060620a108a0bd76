"""Phase planes with nullclines and fixed points."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.forecast import Forecast, fitted
from commonlaw.law import Law
from commonlaw.law.equilibria import fixed_points, kind
from commonlaw.law.law import only_object
from commonlaw.law.parameters import followed_coefficients, rate_names
from commonlaw.library.notation import latex_name
from commonlaw.plots.style import COLORS, GREY, add_legend, frozen_layout, key, math, plain, styled, unit_text
from commonlaw.trials import Trials

_MARKS: Mapping[str, Mapping[str, object]] = {
    "stable": {"markerfacecolor": "black"},
    "unstable": {"markerfacecolor": "white"},
    "saddle": {"marker": "X", "markerfacecolor": "white"},
    "centre": {"marker": "D", "markerfacecolor": "white"},
}

Field = Callable[[Floats], Floats]
"""From states of shape (n, 2) to their derivatives of shape (n, 2)."""


@styled()
def plot_phase_plane(
    law: Law, trials: Trials | Forecast, name: str | None = None, inputs: Mapping[str, float] | None = None
) -> Figure:
    """Plot the phase plane of one object: flow, nullclines, fixed points with their stability, and fitted trajectories.

    For laws of two states of first order, or of one of second order (state and rate). With observation equations it is
    the plane of the states. If both states were measured, points are measurements.

    Raises `CommonlawError` if the law has other states, or time in its terms.

    Parameters
    ----------
    law, trials
        A law, and trials to fit, or a forecast whose trajectories are drawn.
    name
        The object; optional if there is only one.
    inputs
        Values of the inputs, by default zero.
    """
    owner, schema = only_object(law, name), law.schema
    held = {signal: (inputs or {}).get(signal, 0.0) for signal in schema.inputs}
    field = _field(law, owner, [*held.values()])
    forecast = trials if isinstance(trials, Forecast) else fitted(law, trials.select(object=owner))
    smooth = forecast.smooth()
    chosen = [i for i, trial in enumerate(smooth.trials) if trial.object == owner]
    states = smooth.latent or [trajectory.states for trajectory in smooth.trajectories]
    paths = [states[i][:, :2] for i in chosen]
    observed = () if law.observation is None else law.observation.equations
    columns = [j for j, state in enumerate(forecast.trials.schema.states) if state not in observed]
    measured = [forecast.trials[i].states[:, columns] for i in chosen if len(columns) == 2]
    low, high = _window(np.concatenate([*paths, *measured]))
    names = (schema.states[0], rate_names(law)[0]) if len(schema.states) == 1 else schema.states
    units = [schema.units.get(each, "") for each in names]
    labels = [math(latex_name(each), each) for each in names]

    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    panel = figure.add_subplot()
    across, up = np.linspace(low, high, 240 + 1).T
    grid = np.stack(np.meshgrid(across, up), axis=-1)
    rates = field(grid.reshape(-1, 2)).reshape(grid.shape)
    panel.streamplot(
        across, up, rates[..., 0], rates[..., 1], color="#c9c9c9", density=1.1, linewidth=0.7, arrowsize=0.8
    )
    keys = []
    for j, (label, color) in enumerate(zip(labels, (COLORS[1], COLORS[2]), strict=True)):
        if np.nanmin(rates[..., j]) < 0 < np.nanmax(rates[..., j]):
            panel.contour(across, up, rates[..., j], [0.0], colors=[color], linewidths=1.8)
            keys.append(key(f"{label} constant", color=color, linewidth=1.8))
    for points in measured:
        panel.plot(points[:, 0], points[:, 1], ".", color=COLORS[0], alpha=0.35, markersize=4, markeredgewidth=0)
    for path in paths:
        panel.plot(path[:, 0], path[:, 1], color=COLORS[0])
        panel.plot(path[0, 0], path[0, 1], ">", color=COLORS[0], markersize=5)
    keys.append(key(smooth.title, color=COLORS[0]))
    box = low[: len(schema.states)], high[: len(schema.states)]
    found = fixed_points(law, followed_coefficients(law, owner), *box, held)
    marked = [(np.append(point, 0.0)[:2], kind(values)) for point, values in found]
    looks: dict[str, dict[str, Any]] = {
        name: {"marker": "o", "color": "black", **_MARKS.get(name.split()[0], {})} for _, name in marked
    }
    for point, name in marked:
        panel.plot(*point, **{"markersize": 8, "zorder": 5, **looks[name]})
    keys += [key(name, linestyle="", **look) for name, look in looks.items()]
    panel.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    for axis, label, unit in zip((panel.xaxis, panel.yaxis), labels, units, strict=True):
        axis.set_label_text(f"{label} ({unit_text(unit)})" if unit else label)
    panel.set_title(plain(owner, 60))
    add_legend(figure, keys or [key("flow", color=GREY)], "below")
    return frozen_layout(figure)


def _field(law: Law, owner: str, inputs: Sequence[float]) -> Field:
    """Return the right-hand side over the plane."""
    states = len(law.schema.states)
    if (law.order, states) not in ((1, 2), (2, 1)):
        raise CommonlawError("phase-plane-states", states=law.schema.states)
    variables = law.terms.variables
    time = variables.index(variables.time)
    if any(time in law.terms.terms[k].columns() for k in np.flatnonzero(law.support.any(axis=0))):
        raise CommonlawError("phase-plane-time")

    def field(points: Floats) -> Floats:
        values = np.column_stack([points, np.tile([*inputs, 0.0], (len(points), 1))])
        with np.errstate(all="ignore"):
            rates = law.rhs(owner, values)
        return rates if states == 2 else np.column_stack([points[:, 1], rates[:, 0]])

    return field


def _window(points: Floats) -> tuple[Floats, Floats]:
    """Return the corners of what is shown, a margin about the points."""
    seen = points[np.isfinite(points).all(axis=1)]
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = 0.15 * np.where(high > low, high - low, np.maximum(np.abs(high), 1.0))
    # States that are nowhere negative have a boundary at zero, where fixed points often are
    low = np.where((low >= 0) & (low < high), np.minimum(low - margin, -0.25 * margin), low - margin)
    return low, high + margin
