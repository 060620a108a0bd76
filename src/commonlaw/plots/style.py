"""The one look of figures, and how they are drawn and written."""

import os
import re
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from math import ceil
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np
from matplotlib import rc_context, style
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.mathtext import MathTextParser

from commonlaw.errors import check_choice
from commonlaw.runtime.arguments import checks_types
from commonlaw.runtime.files import write_whole
from commonlaw.runtime.packages import quiet
from commonlaw.text import in_line

GREY = "#8c8c8c"
ABSENT = "#ececec"

# Okabe and Ito (2008) without its yellow, which fades on white, and three of Tol's muted colours (2021) to make ten
COLORS = (
    "#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#882255", "#999933", "#7f7f7f",
)  # fmt: skip
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "p")
DASHES = ("-", "--", ":", "-.")

BAND: Mapping[str, Any] = {"alpha": 0.18, "linewidth": 0}
"""The look of a band, with the colour of its curve."""

SETTINGS: Mapping[str, Any] = {
    "figure.dpi": 100,
    "savefig.dpi": 150,
    "font.size": 10,
    "axes.titlesize": 10,
    "axes.labelsize": 10,
    "xtick.labelsize": 9,
    "ytick.labelsize": 9,
    "legend.fontsize": 9,
    "legend.frameon": False,
    "figure.titlesize": 13,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#444444",
    "axes.grid": True,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "axes.formatter.limits": (-3, 4),
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.7,
    "lines.linewidth": 1.4,
    "lines.markersize": 5,
    "svg.hashsalt": "commonlaw",
    "pdf.fonttype": 42,
}

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


@contextmanager
def styled() -> Iterator[None]:
    """Use the look of these figures, one thread at a time, and restore the user's settings afterwards."""
    # A character that no font has is drawn as a box; the warning names no remedy
    with quiet(UserWarning, "Glyph .* missing from"), style.context(["default", dict(SETTINGS)]):
        yield


def frozen_layout(figure: Figure) -> Figure:
    """Lay the figure out once: repeated constrained layouts differ, and so would the bytes of a file."""
    if engine := figure.get_layout_engine():
        engine.execute(figure)
    figure.set_layout_engine("none")
    for panel in figure.axes:
        panel.set_position(np.round(panel.get_position().bounds, 5).tolist())
    return figure


def looks(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return colour and marker for each name: ten colours, and with the markers a hundred before one comes twice."""
    return {
        name: {"color": COLORS[i % len(COLORS)], "marker": MARKERS[(i + i // len(COLORS)) % len(MARKERS)]}
        for i, name in enumerate(names)
    }


def plain(text: str, width: int = 28) -> str:
    """Return a name as matplotlib should show it: dollar signs as such, long names on two lines, cut after those.

    >>> plain("US$ ball")
    'US\\\\$ ball'
    """
    text = in_line(text)
    lines = textwrap.wrap(text, width, max_lines=2, placeholder=" …") or [text]
    return "\n".join(lines).replace("$", r"\$")


def math(latex: str, text: str) -> str:
    """Return LaTeX as mathtext, without dots over words, or `text` where mathtext lacks a command in it."""
    if match := re.fullmatch(r"\\(d+)ot\{(\\mathrm.*)\}", latex):
        power = "" if match[1] == "d" else "^2"
        latex = rf"\mathrm{{d}}{power} {match[2]}/\mathrm{{d}}t{power}"
    # Mathtext sets stretched bars small and close, and factors without a space between them
    latex = latex.replace(r"\left|", "|").replace(r"\right|", "|")
    latex = re.sub(r"(?<=[\w})|]) (?=[\\\w(|])", r"\\ " if r"\mathrm" in latex else r"\\,", latex)
    try:
        MathTextParser("path").parse(f"${latex}$")
    except ValueError:
        return plain(text)
    return f"${latex}$"


def unit_text(unit: str) -> str:
    """Return a unit as printed.

    >>> unit_text("m / s ** 2"), unit_text("kg m^2")
    ('m/s²', 'kg m²')
    """
    raised = re.sub(r"\s*(?:\*\*|\^)\s*(-?\d+)\b(?!\.)", lambda match: match[1].translate(_SUPERSCRIPTS), unit)
    return re.sub(r"\s*\*\s*", "·", re.sub(r"\s*/\s*", "/", raised))


def number_text(value: float, digits: int) -> str:
    """Return a number as printed, with a minus sign instead of a hyphen.

    >>> number_text(-0.12345, 3)
    '−0.123'
    """
    return f"{value:.{digits}g}".replace("-", "−")


def powers_of_ten(text: str) -> str:
    """Return numbers as printed, with powers of ten in place of ``e-06``.

    >>> powers_of_ten("(-9.4 ± 1.7)e-06")
    '(−9.4 ± 1.7) × 10⁻⁶'
    """
    raised = re.sub(r"(?<=[\d)])e([-+]\d+)", lambda match: f" × 10{str(int(match[1])).translate(_SUPERSCRIPTS)}", text)
    return raised.replace("-", "−")


def axis_label(name: str, unit: str = "", width: int = 60) -> str:
    """Return a name with its unit, if it has one, in lines of at most so many characters.

    >>> axis_label("x", "m"), axis_label("count")
    ('x (m)', 'count')
    """
    return plain(f"{name} ({unit_text(unit)})" if unit else name, width)


def fitting(width: float, height: float) -> tuple[float, float]:
    """Return the size of a figure, in inches, that is not wider than the cell of a notebook, 9 inches."""
    return min(width, 9.0), height


def columns_for(panels: int, most: int = 4) -> int:
    """Return how many columns a grid of panels has: as few as need no more lines than `most` columns do.

    >>> columns_for(3), columns_for(5), columns_for(12)
    (3, 3, 4)
    """
    return ceil(panels / ceil(panels / most))


def show_lowest_ticks(panels: Sequence[Axes], columns: int, label: str) -> None:
    """Label the x axis of the lowest panel of each column of a grid that is filled row by row."""
    for i, panel in enumerate(panels):
        lowest = i + columns >= len(panels)
        panel.tick_params(labelbottom=lowest)
        if lowest:
            panel.set_xlabel(label)


def key(label: str, **settings: Any) -> Line2D:
    """Return an entry of a legend."""
    # matplotlib leaves out labels that begin with an underscore
    return Line2D([], [], label=f" {label}" if label.startswith("_") else label, **settings)


_OUTSIDE: Mapping[str, Literal["outside upper center", "outside lower center"]] = {
    "above": "outside upper center",
    "below": "outside lower center",
}


def add_legend(
    figure: Figure, keys: Sequence[Line2D], place: Literal["right", "above", "below"] = "right", title: str = ""
) -> None:
    """Put a legend next to, above or below all panels."""
    if not keys:
        return
    if place == "right":
        figure.legend(handles=list(keys), loc="outside right upper", ncols=ceil(len(keys) / 25), title=title or None)
        return
    widths, most = [0.5 + 0.068 * len(str(line.get_label())) for line in keys], min(len(keys), 5)  # Inches, roughly

    def fits(columns: int) -> bool:
        return sum(float(part.max()) for part in np.array_split(widths, columns)) < figure.get_figwidth()

    columns = next((count for count in range(most, 1, -1) if fits(count)), 1)
    figure.legend(handles=list(keys), loc=_OUTSIDE[place], ncols=columns, title=title or None)


# Dates and versions would make two runs differ
_METADATA: Mapping[str, Mapping[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


@checks_types
def figure_format(path: str | os.PathLike[str]) -> str:
    """Return the figure format of a path or suffix: ``"png"``, ``"svg"`` or ``"pdf"``."""
    name = Path(path)
    kind = (name.suffix or name.name).lstrip(".").lower()
    check_choice("format of a figure", kind, _METADATA)
    return kind


@checks_types
def render(figure: Figure, path: str | os.PathLike[str], text: bool = False) -> bytes:
    """Return the content of a figure file in the format of a name or suffix; the same data give the same bytes.

    With `text` the text of an SVG is kept as text, in the fonts of the reader, instead of curves. Raises
    `CommonlawError` if the suffix is not ``.png``, ``.svg`` or ``.pdf``.
    """
    kind = figure_format(path)
    content = BytesIO()
    with styled(), rc_context({"svg.fonttype": "none" if text else "path"}):
        if kind == "svg":
            # `savefig` draws twice, as it draws without output first
            canvas, svg = figure.canvas, cast(Any, FigureCanvasSVG(figure))
            svg.print_svg(content, metadata=dict(_METADATA[kind]))
            figure.set_canvas(canvas)
        else:
            figure.savefig(content, format=kind, metadata=dict(_METADATA[kind]))
    return content.getvalue()


@checks_types
def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Save a figure in the format of the suffix of the path, completely or not at all."""
    write_whole(path, render(figure, path))
