"""What a report is made of, sections of text, tables and pictures, and the page that shows it."""

import re
from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from commonlaw.errors import CommonlawError
from commonlaw.law.tables import readable
from commonlaw.plots import Figure, render
from commonlaw.report.markup import inline, markdown
from commonlaw.runtime.packages import optional_import
from commonlaw.text import visible

if TYPE_CHECKING:
    import pandas as pd
    from jinja2 import Environment


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
    raised = f" × 10{str(int(power)).translate(_RAISED)}" if power else ""
    return f"{bound or ''}{'−' if sign else ''}{size}{raised}"


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
        return (self.frame if self.data is None else self.data).to_csv(index=False, lineterminator="\n").encode()


@dataclass(frozen=True, eq=False)
class Picture(_Named):
    """A figure, drawn by `draw` when it is needed.

    The name has lower-case letters, digits and hyphens, or there is a `CommonlawError`; the caption is Markdown.
    """

    caption: str
    draw: Callable[[], Figure]


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


@dataclass(frozen=True, eq=False)
class Section(_Named):
    """One part of a report.

    Parameters
    ----------
    name
        Anchor in the page: lower-case letters, digits and hyphens, or a `CommonlawError`.
    title, blocks
        Heading; text, tables and pictures.
    """

    title: str
    blocks: tuple[Block, ...]


@dataclass(frozen=True, eq=False)
class Report:
    """A title, a summary in Markdown with `blocks` below it, and sections."""

    title: str
    summary: str
    sections: tuple[Section, ...]
    blocks: tuple[Block, ...] = ()

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


def to_page(report: Report, drawn: Callable[[str], None] = lambda _: None) -> bytes:
    """Return a self-contained page: figures with their text as text, and tables as data.

    `drawn` is called with the name of each picture when it is drawn. Raises `CommonlawError` if two parts have the same
    name, or a formula cannot be read.
    """
    drawings = dict[str, bytes]()
    for name, figure in figures(report):
        drawings[name] = render(figure, ".svg", text=True)
        drawn(name)
    tables = {block.name: block for block in report.named_blocks() if isinstance(block, Table)}
    files = {name: {"CSV": f"data:text/csv;base64,{b64encode(table.csv()).decode()}"} for name, table in tables.items()}
    return environment(drawings, files).get_template("report.html").render(report=report).encode()


def figures(report: Report) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of a report, whose parts must have different names."""
    names = [part.name for part in (*report.sections, *report.named_blocks())]
    if repeated := [name for name in names if names.count(name) > 1]:
        raise CommonlawError("report-name-twice", parts="parts", name=repeated[0])
    for block in report.named_blocks():
        if isinstance(block, Picture):
            yield block.name, block.draw()


def environment(drawings: Mapping[str, bytes], files: Mapping[str, Mapping[str, str]]) -> "Environment":
    """Return what renders templates of reports, with the drawings (SVG) and files (address by kind) of their parts."""
    check_packages()
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    result = Environment(
        loader=PackageLoader("commonlaw.report", "templates"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
        finalize=lambda value: visible(value) if type(value) is str else value,  # Escaped after that, but for markup
    )  # fmt: skip
    result.filters["markdown"] = lambda text: Markup(markdown(text))
    result.filters["inline"] = lambda text: Markup(inline(text))
    result.filters["shown"] = lambda block: _shown(block) | {"files": files.get(getattr(block, "name", ""), {})}
    result.filters["drawn"] = lambda name: Markup(within(drawings[name], name))
    return result


def check_packages() -> None:
    """Refuse to make a report, before long work, where a package that it needs is not installed."""
    for package in ("jinja2", "markdown_it", "mdit_py_plugins", "latex2mathml"):
        optional_import(package, "making a report", "report")


def _shown(block: Block) -> dict[str, Any]:
    """Return what the template needs of a block."""
    match block:
        case Gallery(pictures):
            return {"kind": "gallery", "blocks": pictures}
        case Fold(title, blocks):
            return {"kind": "fold", "title": title, "blocks": blocks}
        case Text(text):
            return {"kind": "text", "text": text}
        case Picture(name, caption):
            return {"kind": "picture", "name": name, "caption": caption}
        case Table(name, caption, frame, digits):
            present = readable(frame).astype(object).where(frame.notna(), None)
            rows = [[cell(value, digits) for value in row] for row in present.itertuples(index=False, name=None)]
            rows = [[text.replace(" ", "\u00a0") if "±" in text else text for text in row] for row in rows]
            looks = [_look(column) for column in zip(*rows, strict=True)] or ["word"] * len(frame.columns)
            head = list(zip(map(str, frame.columns), looks, strict=True))
            return {"kind": "table", "name": name, "caption": caption, "head": head, "looks": looks, "rows": rows}


def _look(column: Sequence[str]) -> str:
    """Return how a column is set: its class in the style sheet."""
    if all(_SHOWN.fullmatch(text) or not text for text in column):
        return "number"
    return "prose" if max(len(line) for text in column for line in text.splitlines()) > 28 else "word"


_SVG, _LINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"


def within(svg: bytes, name: str) -> str:
    """Return a drawing as a part of a page: without what only files have, its anchors its own, of few elements."""
    root = ElementTree.fromstring(svg)
    anchors = {key: element for element in root.iter() if (key := element.get("id")) is not None}
    root[:] = [element for child in root for element in _light(child, anchors)]
    for element in root.iter():
        element.tag = element.tag.removeprefix(_SVG)
        element.attrib = {key: _own(key, value, name) for key, value in element.attrib.items() if key != _LINK} | (
            {"href": f"#{name}-{element.attrib[_LINK].removeprefix('#')}"} if _LINK in element.attrib else {}
        )
    width = float(root.attrib["width"].removesuffix("pt"))
    root.attrib = {"style": f"min-width: {0.64 * width:.0f}pt"} | root.attrib  # Narrower, its text cannot be read
    return ElementTree.tostring(root, encoding="unicode")


def _own(attribute: str, value: str, name: str) -> str:
    """Return an attribute of a drawing as it is in a page."""
    if attribute == "id":
        return f"{name}-{value}"
    if attribute in ("d", "x", "y", "points"):  # A hundredth of a point is finer than a pixel
        return re.sub(r"(\.\d\d)\d+", r"\1", value.replace("\n", ""))
    value = re.sub(r" font-family: [^;\"]*sans-serif;?", "", value)  # That of the page
    return value.replace("url(#", f"url(#{name}-")


def _light(element: Element, anchors: dict[str, Element]) -> list[Element]:
    """Return what is drawn of an element, markers of one kind as one line and groups without attributes taken apart."""
    parts = [part for child in element for part in _light(child, anchors)]
    if element.tag in (f"{_SVG}metadata", f"{_SVG}style") or (element.tag == f"{_SVG}defs" and not parts):
        return []
    element.tail = None
    if element.tag == f"{_SVG}g":
        element.text = None
        element.attrib.pop("id", None)
        used = [part for part in parts if part.tag == f"{_SVG}use"]
        if len(used) > 1 and len({(marker.attrib[_LINK], marker.get("style")) for marker in used}) == 1:
            parts = [*(part for part in parts if part not in used), *_markers(used, anchors)]
    element[:] = parts
    return parts if element.tag == f"{_SVG}g" and not element.attrib else [element]


def _markers(used: Sequence[Element], anchors: dict[str, Element]) -> Iterator[Element]:
    """Yield a marker, and a line that has it at all places where it is used."""
    shape, key = anchors[used[0].attrib[_LINK].removeprefix("#")], f"marker-{len(anchors)}"
    looks = {"d": shape.attrib["d"], "style": f"{used[0].get('style', '')}; {shape.get('style', '')}"}
    anchors[key] = Element(f"{_SVG}marker", {"id": key, "overflow": "visible", "markerUnits": "userSpaceOnUse"})
    anchors[key].append(Element(f"{_SVG}path", looks))
    yield anchors[key]
    points = " ".join(f"{marker.attrib['x']},{marker.attrib['y']}" for marker in used)
    yield Element(f"{_SVG}polyline", {"points": points, "style": f"fill: none; marker: url(#{key})"})
