"""What a report is made of: sections of text, tables, pictures and numbers."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.errors import CommonlawError, check_choice
from commonlaw.text import json_text

if TYPE_CHECKING:
    import pandas as pd

    from commonlaw.plots import Figure


_NUMBER = re.compile(r"(< )?(-)?([\d.]*\d|∞)(?:e([-+]\d+))?")
_SHOWN = re.compile(r"(< )?−?([\d.]*\d|∞)( × 10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def cell(value: object, digits: int) -> str:
    """Return a table's cell as text, with minus signs; a missing value is None.

    >>> cell(-0.123456, 3), cell(None, 3), cell(12, 3), cell("a-b", 3), cell("-0.50", 3), cell(True, 3)
    ('−0.123', '', '12', 'a-b', '−0.50', 'yes')
    >>> cell(-1.2345e-7, 3), cell("< 1e-9", 3), cell(float("nan"), 3)
    ('−1.23 × 10⁻⁷', '< 1 × 10⁻⁹', '')
    """
    match value:
        case None:
            return ""
        case bool() | np.bool_():
            return "yes" if value else "no"
        case float() | np.floating():
            text = "" if value != value else f"{value:.{digits}g}".replace("inf", "∞")
        case _:
            text = str(value)
    number = _NUMBER.fullmatch(text)
    if not number:
        return text
    bound, sign, size, power = number.groups()
    return (
        (bound or "") + ("−" if sign else "") + size + (f" × 10{str(int(power)).translate(_RAISED)}" if power else "")
    )


def is_number(text: str) -> bool:
    """Return whether a cell is set to the right.

    >>> is_number("−1.23 × 10⁻⁷"), is_number("0.5 v")
    (True, False)
    """
    return _SHOWN.fullmatch(text) is not None


def to_json(document: Mapping[str, Any]) -> bytes:
    """Return nested results as JSON; numbers that are not finite become null."""
    return f"{json_text(document)}\n".encode()


KINDS = ("reproduced", "reproduced with correction", "differs", "beyond the paper", "left out")


@dataclass(frozen=True, eq=False)
class _Named:
    """What has a name that can be both a file's name and an anchor in a page."""

    name: str

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", self.name):
            raise CommonlawError("report-name", name=self.name)


@dataclass(frozen=True)
class Text:
    r"""Paragraphs or lists: Markdown, with LaTeX between one or two dollar signs."""

    text: str


@dataclass(frozen=True, eq=False)
class Table(_Named):
    """A table; every cell's full digits go into a file of comma-separated values.

    Parameters
    ----------
    name
        Name of the file: lower-case letters, digits and hyphens, or a `CommonlawError`.
    caption
        What it shows, in Markdown.
    frame
        Columns of numbers or text, without the index. A missing value is an empty cell.
    digits
        Significant digits of the numbers on the page.
    data
        What the file holds, if the cells of the page are texts.
    """

    caption: str
    frame: "pd.DataFrame"
    digits: int = 4
    data: "pd.DataFrame | None" = None

    def csv(self) -> bytes:
        """Return all cells as comma-separated values."""
        data = self.frame if self.data is None else self.data
        return data.to_csv(index=False, lineterminator="\n").encode()


@dataclass(frozen=True, eq=False)
class Picture(_Named):
    """A figure, drawn by `draw` when it is needed.

    The name of its files has lower-case letters, digits and hyphens, or there is a `CommonlawError`; the caption is
    Markdown.
    """

    caption: str
    draw: "Callable[[], Figure]"


@dataclass(frozen=True, eq=False)
class Gallery:
    """Small pictures side by side, as many in a line as there is room for."""

    pictures: tuple[Picture, ...]


@dataclass(frozen=True, eq=False)
class Fold:
    """Details behind a line that opens, in Markdown."""

    title: str
    blocks: "tuple[Block, ...]"


Block = Text | Table | Picture | Gallery | Fold


@dataclass(frozen=True)
class Verdict:
    """One sentence, in Markdown, on how a result compares with what was published.

    Its kind is ``"reproduced"``; ``"reproduced with correction"``, where the print errs; ``"differs"``; ``"beyond the
    paper"``, where nothing was published; or ``"left out"``, where something is missing; else there is a
    `CommonlawError`.
    """

    kind: str
    text: str

    def __post_init__(self) -> None:
        check_choice("kind of verdict", self.kind, KINDS)


@dataclass(frozen=True, eq=False)
class Section(_Named):
    """One part of a report.

    Parameters
    ----------
    name
        Anchor in the page: lower-case letters, digits and hyphens, or a `CommonlawError`.
    title, blocks
        Heading; text, tables and pictures.
    verdicts
        How the results compare with what was published.
    results
        Numbers by keys, unique in the report, nested, with NumPy arrays and numbers as they are.
    """

    title: str
    blocks: tuple[Block, ...]
    verdicts: tuple[Verdict, ...] = ()
    results: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Report:
    """A title, a summary in Markdown with `blocks` below it, and sections."""

    title: str
    summary: str
    sections: tuple[Section, ...]
    blocks: tuple[Block, ...] = ()

    @property
    def results(self) -> dict[str, Any]:
        """The results of all sections: what ``results.json`` holds."""
        return {key: value for section in self.sections for key, value in section.results.items()}

    def keep(self, *kinds: type[Block]) -> "Report":
        """Return the report with only these kinds of blocks, folds and galleries being kinds of their own."""
        sections = (
            replace(section, blocks=tuple(block for block in section.blocks if isinstance(block, kinds)))
            for section in self.sections
        )
        return replace(
            self, sections=tuple(sections), blocks=tuple(block for block in self.blocks if isinstance(block, kinds))
        )

    def named_blocks(self) -> "Iterator[Picture | Table]":
        """Yield all pictures and tables, those in galleries and folds too, in the order of reading."""
        for blocks in (self.blocks, *(section.blocks for section in self.sections)):
            yield from _named_blocks(blocks)


def _named_blocks(blocks: Iterable[Block]) -> Iterator[Picture | Table]:
    for block in blocks:
        match block:
            case Gallery(pictures):
                yield from pictures
            case Fold(_, inner):
                yield from _named_blocks(inner)
            case Picture() | Table():
                yield block
