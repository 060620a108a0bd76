"""Draws docs/layers.svg: the rooms of the package in the layers of the import contract, by `make layers`."""

import ast
import io
import textwrap
import tomllib
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs" / "layers.svg"

_WIDTH, _HEIGHT, _GAP = 12.0, 0.72, 0.14
"""Of the picture and of a layer, and the space between layers, in inches."""

_LETTERS = 17
"""Letters of the small text in an inch."""

_FILL, _EDGE, _GREY = "#eef3f8", "#4a6fa5", "#555555"


def layers() -> list[list[str]]:
    """Return the rooms of each layer, from the top."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    rows = next(each["layers"] for each in contracts if each["type"] == "layers")
    return [[room.strip() for room in row.split("|")] for row in rows]


def purpose(room: str) -> str:
    """Return what a room says of itself: the first line of its docstring, without its own name."""
    folder = ROOT / "src" / "commonlaw" / room
    file = folder / "__init__.py" if folder.is_dir() else folder.with_suffix(".py")
    line = (ast.get_docstring(ast.parse(file.read_text())) or "").splitlines()[0].rstrip(".")
    name, _, rest = line.partition(": ")
    return rest if name.casefold() == room else line


def picture() -> bytes:
    """Return the picture as SVG; the same contract gives the same bytes."""
    rows = layers()
    height = len(rows) * (_HEIGHT + _GAP) + _GAP
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": "layers", "font.family": "sans-serif"}):
        figure = Figure(figsize=(_WIDTH, height))
        axes = figure.add_axes((0, 0, 1, 1), xlim=(0, _WIDTH), ylim=(height, 0))
        axes.axis("off")
        for i, rooms in enumerate(rows):
            top, width = _GAP + i * (_HEIGHT + _GAP), (_WIDTH - _GAP) / len(rooms)
            for j, room in enumerate(rooms):
                left = _GAP + j * width
                box = FancyBboxPatch(
                    (left, top), width - _GAP, _HEIGHT, boxstyle="round,pad=0,rounding_size=0.06", fc=_FILL, ec=_EDGE
                )
                axes.add_patch(box)
                middle = left + (width - _GAP) / 2
                axes.text(middle, top + 0.17, room, ha="center", va="center", fontsize=11, weight="bold")
                text = textwrap.fill(purpose(room), int((width - _GAP) * _LETTERS)).replace("``", "")
                axes.text(middle, top + 0.47, text, ha="center", va="center", fontsize=7, color=_GREY)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return buffer.getvalue()


if __name__ == "__main__":
    PICTURE.write_bytes(picture())
