"""A law and the trials that a report is about, with what the report's parts have in common."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pandas as pd

from commonlaw.inference import CandidateLaw
from commonlaw.law import Forecast, Law
from commonlaw.law.verdict import LawVerdict
from commonlaw.report.document import Block, Fold, Table
from commonlaw.report.markup import literal
from commonlaw.trials import Trials
from commonlaw.verdict import checked_forecast, checked_start, is_of_training

_LONG = 12
"""Rows from which on a table is folded."""


@dataclass(frozen=True, eq=False)
class LawCase:
    """What a report is made of.

    Parameters
    ----------
    law
        The law.
    trials
        All that was measured.
    training
        What of it the law was learned from.
    words
        Turns messages of the library into the words of whoever asked for the report.
    rivals
        Candidates that were fitted before, the law among them.
    """

    law: Law
    trials: Trials
    training: Trials
    words: Callable[[str], str]
    rivals: tuple[CandidateLaw, ...] = ()

    @cached_property
    def verdict(self) -> LawVerdict:
        """What the law is good for."""
        return self.law.verdict(self.trials, self.training)

    @property
    def forecast(self) -> Forecast | None:
        """Forecasts of trials held out, or of those that the law was learned from; None if there are none."""
        return self._checked[0]

    @property
    def lacking(self) -> tuple[str, ...]:
        """Why there are none."""
        return self._checked[1]

    @cached_property
    def _checked(self) -> tuple[Forecast | None, tuple[str, ...]]:
        return checked_forecast(self.law, self.trials, self.training, bands=True)

    @property
    def start(self) -> int | None:
        """How many first samples tell where forecasts start, see `checked_start`."""
        return checked_start(self.law, self.trials)

    @property
    def forecast_of(self) -> str:
        """What the forecasts are of, in words."""
        if not self.law.provenance.is_learned:
            return "that it is compared with"
        if self.forecast and is_of_training(self.forecast, self.training):
            later = sum(map(len, self.forecast.trials)) > sum(map(len, self.training))
            return f"that it was learned from{', later samples included' if later else ''}"
        return "that were held out"

    @cached_property
    def misses(self) -> pd.Series:
        """What forecasts of each object are off, root mean square in units of the states' spread, the best first."""
        assert self.forecast is not None
        name = self.trials.schema.object
        errors = self.forecast_errors
        states = np.concatenate([trial.states for trial in self.forecast.trials])
        spread = pd.Series(np.nanstd(states, axis=0), self.law.states).replace(0.0, np.nan)
        squared = (errors["rms error"] / errors["state"].map(spread)) ** 2
        misses: pd.Series = squared.groupby(errors[name], sort=False).mean().pow(0.5)
        return misses.sort_values(kind="stable")

    @cached_property
    def forecast_errors(self) -> pd.DataFrame:
        """What the forecasts of each trial are off, see `Forecast.errors`."""
        assert self.forecast is not None
        return self.forecast.errors()

    @cached_property
    def _rms(self) -> pd.DataFrame:
        """What forecasts are off, root mean square, a row for each object and a column for each state."""
        errors = self.forecast_errors
        squared = (errors["rms error"] ** 2).groupby([errors[self.trials.schema.object], errors["state"]]).mean()
        return squared.pow(0.5).unstack("state")[list(self.law.states)]

    def off(self, name: str) -> str:
        """What forecasts of an object are off, root mean square, in the states' units, in words."""
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
