"""Numbers of objects against one of their properties."""

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw.errors import CommonlawError, unknown
from commonlaw.plots.style import add_legend, axis_label, columns_for, frozen_layout, key, looks, plain, styled
from commonlaw.trials import Trials

_LOGARITHMIC = 10.0
"""Ratio of the largest to the smallest value of a property from which on its axis is logarithmic."""

_OPEN: Mapping[str, Any] = {"linestyle": "", "markersize": 8, "markerfacecolor": "none", "markeredgewidth": 2}


@styled()
def plot_property(trials: Trials, name: str, values: Mapping[str, Mapping[str, float]], label: str) -> Figure:
    """Plot a number of each object against a property of the objects, one panel for each trial or other title.

    Markers are open, so that those of objects with the same numbers are seen. Objects without the property are left
    out. The property's axis is logarithmic if it spans a decade and is positive.

    Parameters
    ----------
    trials
        Whose objects have the property.
    name
        The property, a number.
    values
        By title of the panel and object: the number.
    label
        What the numbers are, with their unit, such as ``"landing time (s)"``.

    Raises
    ------
    CommonlawError
        If no object has the property, or it is a text.
    """
    indices = _numbers(trials, name)
    low, high = min(indices.values()), max(indices.values())
    columns = columns_for(len(values), 3)
    lines = -(-len(values) // columns)
    figure = Figure(figsize=(2 + 3.8 * columns, 0.7 + 3.2 * lines), layout="constrained")
    look, first = looks(trials.objects), None
    for i, (title, points) in enumerate(values.items()):
        panel: Axes = figure.add_subplot(lines, columns, i + 1, sharex=first, sharey=first)
        for point in filter(indices.__contains__, points):
            panel.plot(indices[point], points[point], **look[point], **_OPEN)
        panel.set_title(plain(title, 60))
        panel.set_xlabel(axis_label(name, trials.schema.units.get(name, "")))
        if i % columns == 0:
            panel.set_ylabel(label)
        if first is None and 0 < low * _LOGARITHMIC <= high:
            panel.set_xscale("log")
        first = first or panel
    shown = [index for index in indices if any(index in points for points in values.values())]
    add_legend(figure, [key(plain(each), **look[each], **_OPEN) for each in shown])
    return frozen_layout(figure)


def _numbers(trials: Trials, name: str) -> dict[str, float]:
    """Return the property of each object that has it."""
    found = {each: values[name] for each, values in trials.properties.items() if name in values}
    if not found:
        raise unknown(
            "property", name, dict.fromkeys(known for attribute in trials.properties.values() for known in attribute)
        )
    numbers = {each: value for each, value in found.items() if isinstance(value, float)}
    if not numbers:
        raise CommonlawError(
            "other", text=f"property {name!r} is a text and has no place on an axis: choose one that is a number"
        )
    return numbers
