"""The report of the study: sections with verdicts and results, written as a page with its figures and numbers."""

import os
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from commonlaw.errors import CommonlawError, check_choice
from commonlaw.plots import render
from commonlaw.report import document
from commonlaw.report.document import Block, Table
from commonlaw.runtime.files import make_folder, write_all
from commonlaw.text import json_text

KINDS = ("reproduced", "reproduced with correction", "differs", "beyond the paper", "left out")


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
class Section(document.Section):
    """One part of the report.

    Parameters
    ----------
    verdicts
        How the results compare with what was published.
    results
        Numbers by keys, unique in the report, nested, with NumPy arrays and numbers as they are.
    """

    verdicts: tuple[Verdict, ...] = ()
    results: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Report(document.Report):
    """A report of such sections."""

    sections: tuple[Section, ...]

    @property
    def results(self) -> dict[str, Any]:
        """The results of all sections: what ``results.json`` holds."""
        return {key: value for section in self.sections for key, value in section.results.items()}

    @property
    def counts(self) -> dict[str, int]:
        """How many verdicts there are of each kind."""
        reached = Counter(verdict.kind for section in self.sections for verdict in section.verdicts)
        return {kind: reached[kind] for kind in KINDS if reached[kind]}

    def keep(self, *kinds: type[Block]) -> "Report":
        """Return the report with only these kinds of blocks, folds and galleries being kinds of their own."""
        sections = (
            replace(section, blocks=tuple(block for block in section.blocks if isinstance(block, kinds)))
            for section in self.sections
        )
        return replace(self, sections=tuple(sections))


def write_report(
    report: Report, folder: str | os.PathLike[str], drawn: Callable[[str], None] = lambda _: None
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


def contents(report: Report, drawn: Callable[[str], None] = lambda _: None) -> dict[str, bytes]:
    """Return the report's files by their path in its folder, the page first; see `write_report`."""
    from jinja2 import FileSystemLoader

    keys = [key for section in report.sections for key in section.results]
    if repeated := [key for key in keys if keys.count(key) > 1]:
        raise CommonlawError("report-name-twice", parts="results", name=repeated[0])
    drawings, files = dict[str, bytes](), dict[str, bytes]()
    links = dict[str, dict[str, str]]()
    for name, figure in document.figures(report):
        links[name] = {kind.upper(): f"figures/{name}.{kind}" for kind in ("svg", "png")}
        drawings[name] = files[f"figures/{name}.svg"] = render(figure, ".svg")
        files[f"figures/{name}.png"] = render(figure, ".png")
        drawn(name)
    for block in report.named_blocks():
        if isinstance(block, Table):
            links[block.name] = {"CSV": f"tables/{block.name}.csv"}
            files[f"tables/{block.name}.csv"] = block.csv()
    environment = document.environment(drawings, links)
    folders = Path(__file__).parent / "templates", Path(document.__file__).parent / "templates"
    page = environment.overlay(loader=FileSystemLoader(folders)).get_template("study.html")
    html = page.render(report=report).encode()
    return {"report.html": html, "results.json": to_json(report.results), **files}


def to_json(document: Mapping[str, Any]) -> bytes:
    """Return nested results as JSON; numbers that are not finite become null."""
    return f"{json_text(document)}\n".encode()
