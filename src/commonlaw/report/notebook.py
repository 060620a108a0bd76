"""Values as notebooks show them: a line, a formula or table, and a small figure."""

from collections.abc import Callable, Sequence
from hashlib import sha256
from html import escape

import pandas as pd

from commonlaw.discrepancy.function import Discrepancy
from commonlaw.discrepancy.residual_tests import Residuals
from commonlaw.errors import CommonlawError
from commonlaw.experiments.plan import Design
from commonlaw.forecast import Forecast
from commonlaw.inference import Bounds
from commonlaw.law import History, Law, select_objects
from commonlaw.law.tables import readable
from commonlaw.law.verdict import LawVerdict, StateError
from commonlaw.plots import Figure, plot_forecast, plot_intervals, plot_trials, render
from commonlaw.report.document import within
from commonlaw.report.markup import law_markdown, markdown
from commonlaw.text import in_line, visible
from commonlaw.trials import Trials

_STYLE = (
    "<style>.commonlaw-law { max-width: 100%; overflow-x: auto; } "
    ".commonlaw-law math { width: max-content; margin: 0; } .commonlaw-law mtd + mtd { text-align: left; }</style>"
)
"""Equations stand to the left, line below line, and what is wider than the page is scrolled by itself."""


def notebook_html(
    value: Law | Trials | Forecast | History | LawVerdict | Residuals | Discrepancy[Law] | Bounds | Design,
) -> str:
    """Return a value as HTML for a notebook; figures of many objects show the first six."""
    few = slice(6)
    match value:
        case History():
            steps = pd.DataFrame([*value], columns=["stage", "choice", "reason"])
            return visible(str(steps.to_html(index=False, border=0, justify="left")))
        case LawVerdict():
            errors = pd.DataFrame(value.state_errors, columns=StateError._fields)
            errors = errors[["state", "law", "persistence", "unit"]]
            return _page("Verdict", value.sentences, "Root mean square errors of forecasts", errors)
        case Residuals():
            return _page("Residuals", str(value).splitlines(), "Tests", value.tests())
        case Discrepancy():
            return _page("Discrepancy", value.sentences, "Coordinates by evidence", value.coordinates_frame())
        case Bounds():
            return _page("Terms that are not in the law", value.sentences, "Bounds", value.to_frame())
        case Design():
            return _page("Next experiment", value.sentences, "Experiments", value.to_frame())
        case Law():
            try:
                shown = markdown(law_markdown(value))
            except CommonlawError:  # Without the extra that draws formulas
                shown = f"<pre>{escape(str(value))}</pre>"
            notes = "".join(f"<p>Note: {escape(in_line(str(diagnostic)))}</p>" for diagnostic in value.diagnostics)
            table = value.params.dropna(axis=1, how="all")
            first = value.objects[few]
            drawn = _drawn(lambda: plot_intervals(select_objects(value, first))) if value.support.any() else ""
            wide = "".join(f'<div class="commonlaw-law">{part}</div>' for part in (shown, _table(table)))
            return _joined(repr(value), _STYLE + wide + notes, drawn)
        case Trials():
            frame = value.check(order=0).to_frame().iloc[:, :5]
            some = value.select(object=list(value.objects[few]))
            return _joined(repr(value), _table(frame), _drawn(lambda: plot_trials(some)))
        case _:
            objects = list(value.trials.objects[few])
            return _joined(repr(value), _table(value.errors()), _drawn(lambda: plot_forecast(value, objects)))


def _page(title: str, sentences: Sequence[str], of_table: str, table: pd.DataFrame) -> str:
    """Return a heading, the first sentence in bold, the others as a list, and a table under its own heading."""
    first, *others = [escape(in_line(sentence)) for sentence in sentences] or [""]
    listed = "".join(f"<li>{sentence}</li>" for sentence in others)
    below = f"<h5>{of_table}</h5>{_table(table)}" if len(table) else ""
    return visible(f"<div><h4>{title}</h4><p><strong>{first}</strong></p><ul>{listed}</ul>{below}</div>")


def _table(frame: pd.DataFrame, rows: int = 10) -> str:
    more = f"<p>... and {len(frame) - rows} more rows</p>" if len(frame) > rows else ""
    html = readable(frame.head(rows)).to_html(index=False, na_rep="", float_format="{:.4g}".format, border=0)
    return f"{html}{more}"


def _drawn(draw: Callable[[], Figure]) -> str:
    drawing = render(draw(), ".svg", text=True)
    # A notebook is one page: no anchor of a figure may be that of another
    return within(drawing, f"figure-{sha256(drawing).hexdigest()[:8]}")


def _joined(line: str, content: str, drawing: str) -> str:
    sized = drawing.replace("<svg ", '<svg style="max-width: 100%; height: auto" ', 1)
    return visible(f"<div><p>{escape(in_line(line))}</p>{content}{sized}</div>")
