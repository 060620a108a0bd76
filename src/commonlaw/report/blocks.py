"""The parts of which a section is made."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from commonlaw.errors import CommonlawError

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.plots import Figure


@dataclass(frozen=True)
class Text:
    r"""Paragraphs or lists: Markdown, with LaTeX mathematics between dollar signs.

    Two dollar signs put a formula on its own line; ``\$`` is a dollar sign.
    """

    text: str


@dataclass(frozen=True, eq=False)
class Table:
    """A table; every cell's full digits go into a file of comma-separated values.

    Parameters
    ----------
    name
        Name of the file: lower-case letters, digits and hyphens.
    caption
        What it shows, so that it can be read without the text; Markdown.
    frame
        Columns of numbers or text; the index is not shown. A missing value is an empty cell.
    digits
        Significant digits of the numbers on the page.

    Raises
    ------
    CommonlawError
        If the name is not of that kind.
    """

    name: str
    caption: str
    frame: "pd.DataFrame"
    digits: int = 4

    def __post_init__(self) -> None:
        check_name(self.name)


@dataclass(frozen=True, eq=False)
class Picture:
    """A figure; it is drawn when it is wanted.

    Parameters
    ----------
    name
        Name of the files: lower-case letters, digits and hyphens.
    caption
        What it shows, so that it can be read without the text; Markdown.
    draw
        Returns the figure.

    Raises
    ------
    CommonlawError
        If the name is not of that kind.
    """

    name: str
    caption: str
    draw: "Callable[[], Figure]"

    def __post_init__(self) -> None:
        check_name(self.name)


Block = Text | Table | Picture


def check_name(name: str) -> None:
    """Refuse what cannot be both a file's name and an anchor in a page."""
    if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", name):
        raise CommonlawError(
            f"{name!r} cannot name a part of a report: use lower-case letters, digits, and hyphens between them"
        )
