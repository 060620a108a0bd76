"""Reports as pages, and their files."""

import os
import re
from base64 import b64encode
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from commonlaw.errors import CommonlawError
from commonlaw.law.tables import readable
from commonlaw.plots import Figure, render
from commonlaw.report.document import (
    KINDS,
    Block,
    Fold,
    Gallery,
    Picture,
    Report,
    Table,
    Text,
    cell,
    is_number,
    to_json,
)
from commonlaw.report.markup import inline, markdown, plain
from commonlaw.runtime.files import make_folder, write_all
from commonlaw.runtime.packages import optional_import
from commonlaw.text import visible


def to_html(report: Report, drawings: Mapping[str, bytes], alone: bool = False) -> bytes:
    """Return the page; one that stands `alone` holds the drawings, SVG by name, and tables as data."""
    check_packages()
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    loader = PackageLoader("commonlaw.report", "templates")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True,
        finalize=lambda value: visible(value) if type(value) is str else value,  # Escaped after that, but for markup
    )  # fmt: skip
    environment.filters["markdown"] = lambda text: Markup(markdown(text))
    environment.filters["inline"] = lambda text: Markup(inline(text))
    environment.filters["drawn"] = Markup
    environment.filters["plain"] = plain
    environment.filters["shown"] = lambda block: _shown(block, drawings, alone)
    reached = Counter(verdict.kind for section in report.sections for verdict in section.verdicts)
    counts = {kind: reached[kind] for kind in KINDS if reached[kind]}
    page = environment.get_template("report.html").render(report=report, counts=counts, alone=alone)
    return page.encode()


def check_packages() -> None:
    """Refuse to make a report, before long work, where a package that it needs is not installed."""
    for package in ("jinja2", "markdown_it", "mdit_py_plugins", "latex2mathml"):
        optional_import(package, "making a report", "report")


def _shown(block: Block, drawings: Mapping[str, bytes], alone: bool) -> dict[str, Any]:
    """Return what the template needs of a block."""
    match block:
        case Gallery(pictures):
            return {"kind": "gallery", "blocks": pictures}
        case Fold(title, blocks):
            return {"kind": "fold", "title": title, "blocks": blocks}
        case Text(text):
            return {"kind": "text", "text": text}
        case Picture(name, caption) if alone:
            return {"kind": "picture", "name": name, "caption": caption, "drawing": within(drawings[name], name)}
        case Picture(name, caption):
            source = _data("image/svg+xml", drawings[name])
            return {"kind": "picture", "name": name, "caption": caption, "source": source}
        case Table(name, caption, frame, digits):
            present = readable(frame).astype(object).where(frame.notna(), None)
            rows = [[cell(value, digits) for value in row] for row in present.itertuples(index=False, name=None)]
            looks = [_look(column) for column in zip(*rows, strict=True)] or ["word"] * len(frame.columns)
            head = list(zip(map(str, frame.columns), looks, strict=True))
            file = _data("text/csv", block.csv()) if alone else f"tables/{name}.csv"
            shown = {"kind": "table", "name": name, "caption": caption, "head": head, "looks": looks, "rows": rows}
            return shown | {"file": file}


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{b64encode(content).decode()}"


_SVG, _LINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"


def within(svg: bytes, name: str) -> str:
    """Return a drawing as a part of a page: without what only files have, its anchors its own, of few elements."""
    root = ElementTree.fromstring(svg)
    anchors = {key: each for each in root.iter() if (key := each.get("id")) is not None}
    root[:] = [each for child in root for each in _light(child, anchors)]
    for each in root.iter():
        each.tag = each.tag.removeprefix(_SVG)
        each.attrib = {key: _own(key, value, name) for key, value in each.attrib.items() if key != _LINK} | (
            {"href": f"#{name}-{each.attrib[_LINK].removeprefix('#')}"} if _LINK in each.attrib else {}
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
    parts = [each for child in element for each in _light(child, anchors)]
    if element.tag in (f"{_SVG}metadata", f"{_SVG}style") or (element.tag == f"{_SVG}defs" and not parts):
        return []
    element.tail = None
    if element.tag == f"{_SVG}g":
        element.text = None
        element.attrib.pop("id", None)
        used = [part for part in parts if part.tag == f"{_SVG}use"]
        if len(used) > 1 and len({(each.attrib[_LINK], each.get("style")) for each in used}) == 1:
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
    points = " ".join(f"{each.attrib['x']},{each.attrib['y']}" for each in used)
    yield Element(f"{_SVG}polyline", {"points": points, "style": f"fill: none; marker: url(#{key})"})


def _look(column: Sequence[str]) -> str:
    """Return how a column is set: its class in the style sheet."""
    if all(is_number(text) or not text for text in column):
        return "number"
    return "prose" if max(len(line) for text in column for line in text.splitlines()) > 28 else "word"


def write_report(
    report: Report, folder: str | os.PathLike[str], drawn: Callable[[str], None] | None = None
) -> tuple[Path, ...]:
    """Write a report into a folder, made if necessary: all files, or none of them.

    These are ``report.html``, ``results.json``, ``tables/NAME.csv``, ``figures/NAME.svg`` and ``.png``; others are left
    alone. `drawn` is called with the name of each picture when it is drawn. Raises `CommonlawError` if two parts have
    the same name, a formula cannot be read, or the folder cannot be written to.
    """
    # Before the pictures are drawn, as that takes long
    make_folder(folder)
    files = {Path(folder) / name: content for name, content in contents(report, drawn).items()}
    for parent in dict.fromkeys(path.parent for path in files):
        make_folder(parent)
    write_all(files)
    return tuple(files)


def contents(report: Report, drawn: Callable[[str], None] | None = None) -> dict[str, bytes]:
    """Return the report's files by their path in its folder, the page first; see `write_report`."""
    drawings, files = dict[str, bytes](), dict[str, bytes]()
    for name, figure in _figures(report, drawn):
        drawings[name] = files[f"figures/{name}.svg"] = render(figure, ".svg")
        files[f"figures/{name}.png"] = render(figure, ".png")
    files |= {f"tables/{block.name}.csv": block.csv() for block in report.named_blocks() if isinstance(block, Table)}
    return {"report.html": to_html(report, drawings), "results.json": to_json(report.results), **files}


def to_page(report: Report, drawn: Callable[[str], None] | None = None) -> bytes:
    """Return a self-contained page: figures with their text as text, and tables as data.

    `drawn` is called with the name of each picture when it is drawn. Raises `CommonlawError` if two parts have the same
    name, or a formula cannot be read.
    """
    drawings = {name: render(figure, ".svg", text=True) for name, figure in _figures(report, drawn)}
    return to_html(report, drawings, alone=True)


def _figures(report: Report, drawn: Callable[[str], None] | None) -> Iterator[tuple[str, Figure]]:
    """Yield the figures of a report, whose parts must have different names; `drawn` is called after each."""
    for what, names in (
        ("parts", [part.name for part in (*report.sections, *report.named_blocks())]),
        ("results", [key for section in report.sections for key in section.results]),
    ):
        repeated = [name for name in names if names.count(name) > 1]
        if repeated:
            raise CommonlawError("report-name-twice", parts=what, name=repeated[0])
    for block in report.named_blocks():
        if isinstance(block, Picture):
            yield block.name, block.draw()
            if drawn is not None:
                drawn(block.name)
