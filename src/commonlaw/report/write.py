"""A report as files."""

import os
from collections.abc import Callable
from pathlib import Path

from commonlaw.errors import CommonlawError
from commonlaw.files import make_folder, write_all
from commonlaw.plots import render
from commonlaw.report.document import Picture, Report
from commonlaw.report.html import to_html
from commonlaw.report.values import to_json


def write_report(
    report: Report, folder: str | os.PathLike[str], drawn: Callable[[str], None] | None = None
) -> tuple[Path, ...]:
    """Write a report into a folder, which is made if it is not there: all files, or none of them.

    Parameters
    ----------
    report
        What to write.
    folder
        Receives ``report.html``, ``results.json``, ``tables/NAME.csv``, and ``figures/NAME.svg`` and ``.png``. Other
        files in it are left alone.
    drawn
        Called with the name of each picture when it is drawn.

    Raises
    ------
    CommonlawError
        If two parts have the same name, a formula cannot be read, or the folder cannot be written to.
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
    _check_names(report)
    drawings: dict[str, bytes] = {}
    files: dict[str, bytes] = {}
    for block in report.named_blocks():
        if isinstance(block, Picture):
            figure = block.draw()
            drawings[block.name] = files[f"figures/{block.name}.svg"] = render(figure, ".svg")
            files[f"figures/{block.name}.png"] = render(figure, ".png")
            if drawn is not None:
                drawn(block.name)
        else:
            files[f"tables/{block.name}.csv"] = block.csv()
    return {"report.html": to_html(report, drawings), "results.json": to_json(report.results), **files}


def to_page(report: Report, drawn: Callable[[str], None] | None = None) -> bytes:
    """Return a page that holds everything by itself: figures with their text as text, and tables to take away.

    Parameters
    ----------
    report
        What to show.
    drawn
        Called with the name of each picture when it is drawn.

    Raises
    ------
    CommonlawError
        If two parts have the same name, or a formula cannot be read.
    """
    _check_names(report)
    drawings: dict[str, bytes] = {}
    for block in report.named_blocks():
        if isinstance(block, Picture):
            drawings[block.name] = render(block.draw(), ".svg", text=True)
            if drawn is not None:
                drawn(block.name)
    return to_html(report, drawings, alone=True)


def _check_names(report: Report) -> None:
    for what, names in (
        ("parts", [part.name for part in (*report.sections, *report.named_blocks())]),
        ("results", [key for section in report.sections for key in section.results]),
    ):
        repeated = [name for name in names if names.count(name) > 1]
        if repeated:
            raise CommonlawError("report-name-twice", parts=what, name=repeated[0])
