"""A report as one HTML file that needs nothing else."""

from base64 import b64encode
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from commonlaw.extras import optional_import
from commonlaw.names import visible
from commonlaw.report.document import KINDS, Block, Picture, Report, Table, Text
from commonlaw.report.markup import inline, markdown, plain
from commonlaw.report.values import cell, is_number

_LONG = 28
"""Letters from which on a cell may have several lines."""


def to_html(report: Report, drawings: Mapping[str, bytes]) -> bytes:
    """Return the page; `drawings` are the pictures by name as SVG."""
    for package in ("jinja2", "markdown_it", "mdit_py_plugins", "latex2mathml"):
        optional_import(package, "making a report", "report")
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup

    loader = PackageLoader("commonlaw.report", "templates")
    environment = Environment(
        loader=loader, autoescape=True, finalize=_finalized, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["markdown"] = lambda text: Markup(markdown(text))
    environment.filters["inline"] = lambda text: Markup(inline(text))
    environment.filters["plain"] = plain
    environment.filters["shown"] = lambda block: _shown(block, drawings)
    reached = Counter(verdict.kind for section in report.sections for verdict in section.verdicts)
    counts = {kind: reached[kind] for kind in KINDS if reached[kind]}
    page = environment.get_template("report.html").render(report=report, counts=counts)
    return page.encode()


def _finalized(value: object) -> object:
    """Return what a page shows of a value; texts are escaped after that, markup is left as it is."""
    return visible(value) if type(value) is str else value


def _shown(block: Block, drawings: Mapping[str, bytes]) -> dict[str, Any]:
    """Return what the template needs of a block."""
    match block:
        case Text(text):
            return {"kind": "text", "text": text}
        case Picture(name, caption):
            source = f"data:image/svg+xml;base64,{b64encode(drawings[name]).decode()}"
            return {"kind": "picture", "name": name, "caption": caption, "source": source}
        case Table(name, caption, frame, digits):
            present = frame.astype(object).where(frame.notna(), None)
            rows = [[cell(value, digits) for value in row] for row in present.itertuples(index=False, name=None)]
            looks = [_look(column) for column in zip(*rows, strict=True)] or ["word"] * len(frame.columns)
            head = list(zip(map(str, frame.columns), looks, strict=True))
            return {"kind": "table", "name": name, "caption": caption, "head": head, "looks": looks, "rows": rows}


def _look(column: Sequence[str]) -> str:
    """Return how a column is set: its class in the style sheet."""
    if all(is_number(text) or not text for text in column):
        return "number"
    return "prose" if max(map(len, column)) > _LONG else "word"
