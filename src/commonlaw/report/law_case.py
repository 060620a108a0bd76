"""A law and the trials that a report is about, with what the report's parts have in common."""

from collections.abc import Callable
from dataclasses import dataclass

from commonlaw.inference import CandidateLaw
from commonlaw.law import Forecast, Law
from commonlaw.report.document import Block, Fold, Table
from commonlaw.report.markup import literal
from commonlaw.trials import Trials
from commonlaw.verdict import Findings

_LONG = 12
"""Rows from which on a table is folded."""


@dataclass(frozen=True, eq=False)
class LawCase:
    """What a report is made of.

    Parameters
    ----------
    findings
        The law, with what it is good for.
    words
        Turns messages of the library into the words of whoever asked for the report.
    rivals
        Candidates that were fitted before, the law among them.
    """

    findings: Findings
    words: Callable[[str], str]
    rivals: tuple[CandidateLaw, ...] = ()

    @property
    def law(self) -> Law:
        """The law."""
        return self.findings.law

    @property
    def trials(self) -> Trials:
        """All that was measured."""
        return self.findings.trials

    @property
    def forecast(self) -> Forecast | None:
        """Forecasts that check the law; None if there are none."""
        return self.findings.forecast

    @property
    def forecast_of(self) -> str:
        """What the forecasts are of, in words."""
        if not self.law.provenance.is_learned:
            return "that it is compared with"
        if self.findings.is_held_out:
            return "that were held out"
        return f"that it was learned from{', later samples included' if self.findings.has_later_samples else ''}"

    def said(self, text: object) -> str:
        """Return a message as Markdown that shows it as it stands, in the words of whoever asked."""
        return literal(self.words(str(text)))


def folded(table: Table, title: str) -> Block:
    """Return a table, behind a line that opens it if it is long."""
    return table if len(table.frame) <= _LONG else Fold(f"{title} ({len(table.frame)} rows)", (table,))


def listed(lines: "list[str] | tuple[str, ...]") -> str:
    """Return a Markdown list."""
    return "\n\n" + "\n".join(f"- {line}" for line in lines) + "\n\n"
