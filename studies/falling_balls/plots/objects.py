"""One number for each object: horizontal dots, names at the left."""

from collections.abc import Mapping
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from commonlaw.plots.style import GREY, add_legend, columns_for, frozen_layout, key, looks, plain, styled

_SPAN: Mapping[str, Any] = {"color": GREY, "alpha": 0.25, "linewidth": 0}


@styled()
def plot_by_object(
    panels: Mapping[str, Mapping[str, Mapping[str, float]]],
    x_label: str,
    spans: Mapping[str, tuple[float, float]] | None = None,
) -> Figure:
    """Plot a number of each object as dots in a line of its own, the first object at the top.

    Parameters
    ----------
    panels
        By title of the panel, series and object: a number that is not negative. An object without one has no dot.
    x_label
        Label of the x axes with its unit, such as ``"noise (m)"``.
    spans
        By label: ends of a range that is shaded in every panel.
    """
    names = list(dict.fromkeys(name for series in panels.values() for group in series.values() for name in group))
    look = looks(list(dict.fromkeys(label for series in panels.values() for label in series)))
    indices = {name: i for i, name in enumerate(names)}
    columns = columns_for(len(panels), 3)
    lines = -(-len(panels) // columns)
    figure = Figure(figsize=(3.4 + 3.1 * columns, (1.1 + 0.3 * len(names)) * lines), layout="constrained")
    first: Axes | None = None
    for i, (title, series) in enumerate(panels.items()):
        panel: Axes = figure.add_subplot(lines, columns, i + 1, sharex=first, sharey=first)
        for low, high in (spans or {}).values():
            panel.axvspan(low, high, **_SPAN)
        for label, group in series.items():
            heights = [indices[name] for name in group]
            panel.plot(list(group.values()), heights, **look[label], linestyle="", alpha=0.9, clip_on=False)
        panel.set_title(plain(title, 60))
        panel.set_xlabel(x_label)
        panel.tick_params(axis="y", labelleft=i % columns == 0, length=0)
        first = first or panel
    if first is not None:
        first.set_yticks(range(len(names)), [plain(name) for name in names])
        first.set_ylim(len(names) - 0.5, -0.5)
        first.set_xlim(left=0)
    keys = [key(plain(label), **each, linestyle="") for label, each in look.items()]
    keys += [key(plain(label), **{**_SPAN, "linewidth": 8}) for label in spans or {}]
    add_legend(figure, keys)
    return frozen_layout(figure)
