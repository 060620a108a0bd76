"""The report of a law: what it says, what it is good for, how it was found, on one page."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from commonlaw.cluster import on_cluster, refuse_client
from commonlaw.errors import CommonlawError
from commonlaw.inference import CandidateLaw
from commonlaw.law import Law
from commonlaw.law.page import Page
from commonlaw.law.script import Source
from commonlaw.progress import on_terminal
from commonlaw.report import curves, law_sections, leftovers, making
from commonlaw.report.all_objects import all_objects
from commonlaw.report.document import Report, Text
from commonlaw.report.formulas import law_markdown
from commonlaw.report.html import check_packages
from commonlaw.report.law_case import LawCase, listed
from commonlaw.report.markup import literal
from commonlaw.report.write import to_page
from commonlaw.trials import Trials, TrialStream
from commonlaw.verdict import Findings, ManyFindings, find, find_by_stream

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
) -> Report:
    """Return the report of a law.

    Parameters
    ----------
    findings
        The law, with what it is good for.
    command, table
        The command that asked for the report, and the file of the trials, as the report shows them; empty if there is
        none.
    words
        Turns messages of the library into the words of whoever asked.
    progress
        Takes what is being done.
    rivals
        Candidates that were fitted before, the law among them; fitted for the report if there are none.
    everything
        What all objects of a stream show, if the findings are about few that stand for them.
    """
    check_packages()
    case, law = LawCase(findings, words, tuple(rivals)), findings.law
    first, *others = map(literal, findings.sentences)
    summary = f"**{first}**{law_markdown(law)}"
    title = f"A law of {', '.join(law.states)}"
    parts = (
        curves.fit,
        law_sections.coefficients,
        curves.forecasts,
        law_sections.candidates,
        leftovers.residuals,
        law_sections.ranges,
        law_sections.experiments,
        making.data_checks,
        making.choices,
    )
    sections = [all_objects(everything)] if everything else []
    for part in parts:
        progress(part.__name__)
        sections.append(part(case))
    below = (*law_sections.values(law), Text(listed(others)))
    return Report(title, summary, (*sections, making.again(case, command, table)), below)
