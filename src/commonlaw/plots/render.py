"""Figures as bytes and files."""

import os
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.figure import Figure

from commonlaw.errors import unknown
from commonlaw.files import write_whole
from commonlaw.plots.style import styled

# Dates and versions would make two runs differ
_METADATA: Mapping[str, Mapping[str, Any]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
}


def figure_format(path: str | os.PathLike[str]) -> str:
    """Return the format that a path, or only its suffix, asks for: ``"png"``, ``"svg"`` or ``"pdf"``.

    Raises
    ------
    CommonlawError
        If it is none of these.
    """
    name = Path(path)
    kind = (name.suffix or name.name).lstrip(".").lower()
    if kind not in _METADATA:
        raise unknown("format of a figure", kind, _METADATA)
    return kind


def render(figure: Figure, path: str | os.PathLike[str], text: bool = False) -> bytes:
    """Return the figure as the content of a file of that name; the same data give the same bytes.

    Parameters
    ----------
    figure
        What to draw.
    path
        A path, or only its suffix: ``.png``, ``.svg`` or ``.pdf``. No file is written.
    text
        Whether an SVG holds its text as text, to be searched and copied, in the fonts of who reads it; else as curves.

    Raises
    ------
    CommonlawError
        If the suffix is not one of these.
    """
    kind = figure_format(path)
    content = BytesIO()
    with styled(), rc_context({"svg.fonttype": "none" if text else "path"}):
        figure.savefig(content, format=kind, metadata=dict(_METADATA[kind]))
    return content.getvalue()


def save_figure(figure: Figure, path: str | os.PathLike[str]) -> None:
    """Write the figure in the format of the path's suffix, whole or not at all.

    Raises
    ------
    CommonlawError
        If the suffix is not ``.png``, ``.svg`` or ``.pdf``, or the file cannot be written.
    """
    write_whole(path, render(figure, path))
