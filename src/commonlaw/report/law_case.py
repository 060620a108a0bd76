"""A law and the trials that a report is about, with what the report's parts have in common."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

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

    @cached_property
    def relative_errors(self) -> pd.Series:
        """Root mean square errors of forecasts of each object, in units of the states' spread, the best first."""
        assert self.forecast is not None
        name = self.trials.schema.object
        errors = self.forecast_errors
        states = np.concatenate([trial.states for trial in self.forecast.trials])
        spread = pd.Series(np.nanstd(states, axis=0), self.law.states).replace(0.0, np.nan)
        squared = (errors["rms error"] / errors["state"].map(spread)) ** 2
        relative: pd.Series = squared.groupby(errors[name], sort=False).mean().pow(0.5)
        return relative.sort_values(kind="stable")

    @cached_property
    def forecast_errors(self) -> pd.DataFrame:
        """Errors of the forecasts of each trial, see `Forecast.errors`."""
        assert self.forecast is not None
        return self.forecast.errors()

    @cached_property
    def _rms(self) -> pd.DataFrame:
        """Root mean square errors of forecasts, a row for each object and a column for each state."""
        errors = self.forecast_errors
        squared = (errors["rms error"] ** 2).groupby([errors[self.trials.schema.object], errors["state"]]).mean()
        return squared.pow(0.5).unstack("state")[list(self.law.states)]

    def error_in_words(self, name: str) -> str:
        """Return the root mean square error of forecasts of an object, in the states' units, in words."""
        units = self.trials.schema.units
        rms = self._rms.loc[name]
        if np.isinf(rms).any():
            return "its forecast runs away"
        said = [
            f"{value:.2g} {units.get(state, '')}".rstrip() + f" ({state})" * (len(rms) > 1)
            for state, value in zip(self.law.states, rms, strict=True)
            if np.isfinite(value)
        ]
        return f"off by {' and '.join(said)}" if said else "not measured"

    def said(self, text: object) -> str:
        """Return a message as Markdown that shows it as it stands, in the words of whoever asked."""
        return literal(self.words(str(text)))


def folded(table: Table, title: str) -> Block:
    """Return a table, behind a line that opens it if it is long."""
    return table if len(table.frame) <= _LONG else Fold(f"{title} ({len(table.frame)} rows)", (table,))


def listed(lines: "list[str] | tuple[str, ...]") -> str:
    """Return a Markdown list."""
    return "\n\n" + "\n".join(f"- {line}" for line in lines) + "\n\n"
