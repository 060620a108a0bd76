"""Coefficients of many laws: a grid of heat maps."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.plots.equations import term_labels
from commonlaw.plots.law import add_color_bar, heat_map, scale
from commonlaw.plots.style import frozen_layout, plain, styled


@styled()
def plot_heat_maps(laws: Mapping[str, Law], columns: int, *, row_titles: Sequence[str] = ()) -> Figure:
    """Plot the magnitudes of the coefficients of many laws as a grid of heat maps with one scale of colours.

    Each panel has a row for each object and a column for each candidate term; grey cells are terms that are not in an
    object's equation.

    Parameters
    ----------
    laws
        Laws of one equation by the title of their panel, row by row, all of the same objects and terms.
    columns
        Panels side by side.
    row_titles
        What stands at the left of each row of panels; a panel's title that begins with it and a comma is shown
        without that.

    Raises
    ------
    CommonlawError
        If there is no law, a law has several equations or other objects or terms than the first, or the titles are not
        as many as the rows.
    """
    _check(laws)
    lines, (first, *_) = -(-len(laws) // columns), laws.values()
    if row_titles and len(row_titles) != lines:
        raise CommonlawError(
            "other", text=f"{len(row_titles)} titles for {lines} rows of heat maps; give one for each row"
        )
    names, terms = [plain(name, 34) for name in first.objects], term_labels(first.terms)
    cell = float(np.clip(13 / (columns * len(terms)), 0.19, 0.4))
    margin = 0.6 + 0.08 * max(len(line) for name in names for line in name.split("\n"))
    width, height = margin + columns * (0.15 + cell * len(terms)), 1.3 + lines * (0.35 + 0.27 * len(names))
    figure = Figure(figsize=(max(width, 5), height), layout="constrained")
    panels = figure.subplots(lines, columns, squeeze=False)
    for panel in panels.flat[len(laws) :]:
        panel.remove()
    norm = scale(np.concatenate([law.coefficients for law in laws.values()]))
    for i, (title, law) in enumerate(laws.items()):
        panel, (line, column) = panels.flat[i], divmod(i, columns)
        mesh = heat_map(panel, law.coefficients[:, 0], norm)
        panel.set_title(plain(title.removeprefix(f"{row_titles[line]}, ") if row_titles else title, 40))
        lowest = i + columns >= len(laws)
        panel.set_xticks(np.arange(len(terms)) + 0.5, terms if lowest else [], rotation=0 if cell > 0.35 else 90)
        panel.set_yticks(np.arange(len(names)) + 0.5, names if column == 0 else [])
        if row_titles and column == 0:
            panel.set_ylabel(plain(row_titles[line]), fontweight="bold")
    if any(law.support.any() for law in laws.values()):
        add_color_bar(figure, mesh, list(panels.flat[: len(laws)]), width)
    return frozen_layout(figure)


def _check(laws: Mapping[str, Law]) -> None:
    """Check that all laws fit into one grid."""
    if not laws:
        raise CommonlawError("other", text="there is no law to draw; give at least one")
    first, *_ = laws
    for title, law in laws.items():
        if (count := len(law.schema.states)) > 1:
            text = f"{title}: the law has {count} equations, and a grid shows one: use plot_coefficients"
            raise CommonlawError("other", text=text)
        for what, own, wanted in (
            ("objects", law.objects, laws[first].objects),
            ("terms", law.terms.names, laws[first].terms.names),
        ):
            if own != wanted:
                raise CommonlawError(
                    "other",
                    text=f"{title}: the {what} are {', '.join(own)}, those of {first} are {', '.join(wanted)}; "
                    f"draw laws of the same {what} together",
                )
