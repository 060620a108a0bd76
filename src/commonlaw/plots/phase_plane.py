"""Phase planes with nullclines and fixed points."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import root

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.forecast import Forecast, fitted
from commonlaw.law import Law
from commonlaw.law.law import only_object
from commonlaw.law.parameters import rate_names
from commonlaw.library.notation import latex_name
from commonlaw.plots.style import COLORS, GREY, add_legend, frozen_layout, key, math, plain, styled, unit_text
from commonlaw.trials import Trials

_CELLS, _FINE, _ARROWS = 60, 240, 1.1
"""Cells along an axis in which fixed points are looked for and nullclines drawn, and density of the flow."""
_MARGIN = 0.15
_MARKS: Mapping[str, Mapping[str, object]] = {
    "stable": {"markerfacecolor": "black"},
    "unstable": {"markerfacecolor": "white"},
    "saddle": {"marker": "X", "markerfacecolor": "white"},
    "center": {"marker": "D", "markerfacecolor": "white"},
}

Field = Callable[[Floats], Floats]
"""From states of shape (n, 2) to their derivatives of shape (n, 2)."""


@dataclass(frozen=True)
class FixedPoint:
    """Where both derivatives are zero, and the eigenvalues of the Jacobian there."""

    state: tuple[float, float]
    eigenvalues: tuple[complex, complex]

    @property
    def kind(self) -> str:
        """``stable node``, ``stable focus``, ``unstable node``, ``unstable focus``, ``saddle`` or ``center``."""
        real, imaginary = np.real(self.eigenvalues), np.imag(self.eigenvalues)
        size = np.max(np.abs(self.eigenvalues)) or 1.0
        if imaginary.any() and np.max(np.abs(real)) < 1e-6 * size:
            return "center"
        if not imaginary.any() and np.prod(np.sign(real)) < 0:
            return "saddle"
        return f"{'stable' if np.max(real) < 0 else 'unstable'} {'focus' if imaginary.any() else 'node'}"


def fixed_points(
    law: Law,
    window: tuple[float, float, float, float],
    name: str | None = None,
    inputs: Mapping[str, float] | None = None,
) -> tuple[FixedPoint, ...]:
    """Return the fixed points of one object with two states, or one of second order, in a window.

    ``f(x*) = 0``; the eigenvalues are those of ``df/dx`` there.

    Raises `CommonlawError` if the law has other states, or time in its terms.

    Parameters
    ----------
    window
        Least and largest first state, least and largest second one.
    name, inputs
        The object; and values of inputs, zero by default.
    """
    return _fixed_points(_field(law, name, inputs or {}), window)


@styled()
def plot_phase_plane(
    law: Law, trials: Trials | Forecast, name: str | None = None, inputs: Mapping[str, float] | None = None
) -> Figure:
    """Plot the phase plane of one object: flow, nullclines, fixed points with their stability, and fitted trajectories.

    For laws of two first-order states, or of one state of second order, whose plane is that of the state and its rate.
    Where two states were measured, points are measurements.

    Raises `CommonlawError` if the law has other states, or time in its terms.

    Parameters
    ----------
    law, trials
        A law, and trials to fit; or a forecast, whose trajectories are then drawn.
    name
        The object; not needed if there is one.
    inputs
        Values of inputs, zero by default.
    """
    owner = only_object(law, name)
    field = _field(law, owner, inputs or {})
    forecast = trials if isinstance(trials, Forecast) else fitted(law, trials.select(object=owner))
    smooth = forecast.smooth()
    chosen = [i for i, each in enumerate(smooth.trials) if each.object == owner]
    paths = [smooth.trajectories[i].states[:, :2] for i in chosen]
    measured = [forecast.trials[i].states for i in chosen if forecast.trials[i].states.shape[1] == 2]
    window = _window(np.concatenate([*paths, *measured]))
    schema, second = law.schema, len(law.schema.states) == 1
    names = (schema.states[0], rate_names(law)[0]) if second else schema.states
    units = [schema.units.get(each, "") for each in names]
    labels = [math(latex_name(each), each) for each in names]

    figure = Figure(figsize=(6.4, 5.6), layout="constrained")
    panel = figure.add_subplot()
    across, up = (np.linspace(*ends, _FINE + 1) for ends in (window[:2], window[2:]))
    grid = np.stack(np.meshgrid(across, up), axis=-1)
    rates = field(grid.reshape(-1, 2)).reshape(grid.shape)
    panel.streamplot(
        across, up, rates[..., 0], rates[..., 1], color="#c9c9c9", density=_ARROWS, linewidth=0.7, arrowsize=0.8
    )
    keys = []
    for j, (label, color) in enumerate(zip(labels, (COLORS[1], COLORS[2]), strict=True)):
        if np.nanmin(rates[..., j]) < 0 < np.nanmax(rates[..., j]):
            panel.contour(across, up, rates[..., j], [0.0], colors=[color], linewidths=1.8)
            keys.append(key(f"{label} constant", color=color, linewidth=1.8))
    for states in measured:
        panel.plot(states[:, 0], states[:, 1], ".", color=COLORS[0], alpha=0.35, markersize=4, markeredgewidth=0)
    for path in paths:
        panel.plot(path[:, 0], path[:, 1], color=COLORS[0])
        panel.plot(path[0, 0], path[0, 1], ">", color=COLORS[0], markersize=5)
    keys.append(key(smooth.title, color=COLORS[0]))
    points = _fixed_points(field, window)
    for point in points:
        look = _MARKS.get(point.kind, _MARKS[point.kind.split()[0]])
        panel.plot(*point.state, **{"marker": "o", "color": "black", "markersize": 8, "zorder": 5, **look})  # type: ignore[arg-type]
    for kind in dict.fromkeys(each.kind for each in points):
        look = {"marker": "o", **_MARKS.get(kind, _MARKS[kind.split()[0]])}
        keys.append(key(kind, color="black", linestyle="", **look))
    panel.set(xlim=window[:2], ylim=window[2:])
    for axis, label, unit in zip((panel.xaxis, panel.yaxis), labels, units, strict=True):
        axis.set_label_text(f"{label} ({unit_text(unit)})" if unit else label)
    panel.set_title(plain(owner, 60))
    add_legend(figure, keys or [key("flow", color=GREY)], "below")
    return frozen_layout(figure)


def _field(law: Law, name: str | None, inputs: Mapping[str, float]) -> Field:
    """Return the right-hand side over the plane."""
    owner, states = only_object(law, name), len(law.schema.states)
    if (law.order, states) not in ((1, 2), (2, 1)):
        raise CommonlawError("phase-plane-states", states=law.schema.states)
    variables = law.terms.variables
    time = variables.index(variables.time)
    if any(time in law.terms.terms[k].columns() for k in np.flatnonzero(law.support.any(axis=0))):
        raise CommonlawError("phase-plane-time")
    others = [float(inputs.get(each, 0.0)) for each in law.schema.inputs]

    def field(points: Floats) -> Floats:
        values = np.column_stack([points, np.tile([*others, 0.0], (len(points), 1))])
        with np.errstate(all="ignore"):
            rates = law.rhs(owner, values)
        return rates if states == 2 else np.column_stack([points[:, 1], rates[:, 0]])

    return field


def _window(points: Floats) -> tuple[float, float, float, float]:
    seen = points[np.isfinite(points).all(axis=1)]
    low, high = seen.min(axis=0), seen.max(axis=0)
    margin = _MARGIN * np.where(high > low, high - low, np.maximum(np.abs(high), 1.0))
    # States that are nowhere negative have a boundary at zero, where fixed points often are
    low = np.where((low >= 0) & (low < high), np.minimum(low - margin, -0.25 * margin), low - margin)
    return float(low[0]), float(high[0] + margin[0]), float(low[1]), float(high[1] + margin[1])


def _fixed_points(field: Field, window: tuple[float, float, float, float]) -> tuple[FixedPoint, ...]:
    """Return the roots that searches reach from cells in which both derivatives change their sign."""
    low, high = np.array(window[::2]), np.array(window[1::2])
    span = high - low
    across, up = (np.linspace(a, b, _CELLS + 1) for a, b in zip(low, high, strict=True))
    signs = np.sign(field(np.stack(np.meshgrid(across, up), axis=-1).reshape(-1, 2))).reshape(len(up), len(across), 2)
    corners = np.stack([signs[:-1, :-1], signs[1:, :-1], signs[:-1, 1:], signs[1:, 1:]])
    changes = ((corners.min(axis=0) <= 0) & (corners.max(axis=0) >= 0)).all(axis=-1)
    found = list[FixedPoint]()

    def scaled(point: Floats) -> Floats:
        return np.asarray(field((low + span * point)[np.newaxis])[0])

    for j, i in np.argwhere(changes).tolist():
        start = (np.array([i, j]) + 0.5) / _CELLS
        solution = root(scaled, start, tol=1e-12)
        state = low + span * solution.x
        inside = np.all((solution.x > -1e-9) & (solution.x < 1 + 1e-9))
        if not (solution.success and inside) or any(
            np.allclose(state, p.state, atol=1e-6 * span, rtol=0) for p in found
        ):
            continue
        step = 1e-6 * span
        columns = [field((state + side * step * axis)[np.newaxis])[0] for axis in np.eye(2) for side in (1, -1)]
        jacobian = np.column_stack(
            [(columns[0] - columns[1]) / (2 * step[0]), (columns[2] - columns[3]) / (2 * step[1])]
        )
        if np.isfinite(jacobian).all():
            values = np.linalg.eigvals(jacobian)
            found.append(FixedPoint((float(state[0]), float(state[1])), (complex(values[0]), complex(values[1]))))
    return tuple(sorted(found, key=lambda each: each.state))
