"""Reports on laws, of a few objects or of many."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from commonlaw.errors import CommonlawError
from commonlaw.inference import CandidateLaw
from commonlaw.law import Law
from commonlaw.law.script import Source
from commonlaw.law.tables import quantile_frame, spread_tables
from commonlaw.law.text import MANY
from commonlaw.plots import plot_intervals
from commonlaw.report import curves, law_sections
from commonlaw.report.document import Block, Picture, Report, Section, Table, Text
from commonlaw.report.law_sections import LawCase, listed
from commonlaw.report.markup import law_markdown, literal
from commonlaw.report.page import Page
from commonlaw.report.write import check_packages, to_page
from commonlaw.runtime.cluster import on_cluster, refuse_client
from commonlaw.runtime.progress import on_terminal
from commonlaw.stream import ManyFindings, find_by_stream
from commonlaw.text import counted, r_squared
from commonlaw.trials import Trials, TrialStream
from commonlaw.verdict import Findings, find

if TYPE_CHECKING:
    from distributed import Client


def law_page(
    law: Law, trials: Trials | TrialStream, learned: Trials | TrialStream | None = None, client: "Client | None" = None
) -> Page:
    """Return the report of a law as a page, see `Law.report`."""
    check_packages()
    if isinstance(trials, Trials):
        refuse_client(client)
        if isinstance(learned, TrialStream):
            raise CommonlawError("learned-not-in-memory")
        return Page(to_page(law_report(find(law, trials, learned))).decode())
    if isinstance(learned, Trials):
        raise CommonlawError("learned-not-a-stream")
    with on_cluster(client):
        found = find_by_stream(law, trials, on_terminal(), learned)
    made = law_report(found.few, table=Source("runs/*.parquet", stream=True), everything=found)
    return Page(to_page(made).decode())


def law_report(
    findings: Findings,
    command: str = "",
    table: str | Source = "trials.csv",
    words: Callable[[str], str] = str,
    progress: Callable[[str], None] = lambda _: None,
    rivals: Sequence[CandidateLaw] = (),
    everything: ManyFindings | None = None,
    title: str = "",
    about: str = "",
) -> Report:
    """Return the report of a law.

    Parameters
    ----------
    findings
        The law and its assessment.
    command, table
        The command of the report and the file of the trials, as shown; empty if there is none.
    words
        Turns messages of the library into the words of the caller.
    progress
        Takes the text of each step.
    rivals
        Candidates that were fitted before, the law among them; default: fitted for the report.
    everything
        Results of all objects of a stream, if the findings are about a few of them.
    title, about
        The title, "A law of" the states by default; and a line below it, such as file, date and checksum.
    """
    check_packages()
    case, law = LawCase(findings, words, tuple(rivals)), findings.law
    first, *others = map(literal, findings.sentences)
    above = f"{literal(about)}\n\n" if about else ""
    summary = f"{above}**{first}**{law_markdown(law)}{law_sections.in_short(case)}"
    title = title or f"A law of {', '.join(law.schema.states)}"
    parts = (
        curves.fit,
        law_sections.coefficients,
        curves.forecasts,
        law_sections.candidates,
        law_sections.residuals,
        law_sections.ranges,
        law_sections.experiments,
        law_sections.data_checks,
        law_sections.choices,
        law_sections.methods,
    )
    sections = [all_objects(everything)] if everything else []
    for part in parts:
        progress(part.__name__)
        sections.append(part(case))
    below = (*law_sections.values(law), Text(listed(others)))
    return Report(title, summary, (*sections, law_sections.again(case, command, table)), below)


_MAX_LISTED = 10
"""Objects that are named each, those with outlying coefficients and those with the worst forecasts."""


def all_objects(found: ManyFindings) -> Section:
    """Return the part on all objects."""
    law, shown = found.law, counted(len(found.few.trials.objects), "object")
    bands = (
        "" if np.isnan(found.coverage) else f" The 95 % bands hold {100 * found.coverage:.3g} % of the measurements."
    )
    diverged = f" {found.diverged} of the forecasts diverge." if found.diverged else ""
    intro = (
        f"{found.forecast_of} were forecast, each from initial conditions fitted to its first samples: "
        f"${r_squared(found.score)}$.{bands}{diverged} "
        f"The verdict and the other parts of this page are about {shown} that represent all, evenly "
        "spaced by the rank of their forecast error."
    )
    more = _coefficients(law) if len(law.objects) > MANY and law.support.any() else ()
    return Section("all-objects", "All objects", (Text(intro), *_forecasts(found), *more))


def _forecasts(found: ManyFindings) -> Iterator[Block]:
    relative = found.relative.replace(np.inf, np.nan).dropna()
    name = found.errors.columns[0]
    if len(relative) > MANY:
        caption = "Errors of the forecasts of objects, in units of the spread of the states: quantiles."
        yield Table("errors-of-all", caption, quantile_frame({"rms error": relative.to_numpy()}, "object"))
    worst = found.relative.iloc[::-1][:_MAX_LISTED]
    frame = pd.DataFrame({name: worst.index.astype(str), "rms error": worst.to_numpy()})
    caption = f"The {counted(len(worst), 'object')} with the worst forecasts, in the same units."
    yield Table("worst", caption, frame)


def _coefficients(law: Law) -> Iterator[Block]:
    if tables := spread_tables(law, _MAX_LISTED, universal=False):  # What is universal is said above
        spread, farthest = tables
        yield Table("spread", "Coefficients of all objects: quantiles (letter values, Tukey 1977).", spread)
        caption = "The objects farthest from the medians, in standard deviations of a normal spread."
        yield Table("outlying", caption, farthest)
    yield Picture("coefficients-of-all", "Coefficients of all objects in order.", partial(plot_intervals, law))
