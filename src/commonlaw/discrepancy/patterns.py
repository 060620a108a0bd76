"""What measurements are off the trajectories of a law: what `Law.residuals` gives."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.notebooks import ShownInNotebooks
from commonlaw.trials import Trials

if TYPE_CHECKING:
    import pandas as pd

FALSE_DISCOVERY_RATE = 0.01
"""Share of false alarms among the patterns that count as significant."""


@dataclass(frozen=True)
class Pattern:
    """What a test of residuals looked for in those of a state, and found.

    Parameters
    ----------
    state
        Whose residuals.
    pattern
        What was looked for, in words.
    statistic
        Its size: what it is, the pattern's name says.
    p_value
        How probable as much is where only white noise is left.
    adjusted
        The same with all patterns of the table in mind: the share of false alarms among those as sure as this.
    meaning
        What the pattern usually means; empty where it is not significant.
    """

    state: str
    pattern: str
    statistic: float
    p_value: float
    adjusted: float
    meaning: str

    @property
    def significant(self) -> bool:
        """Whether it is more than chance, by `adjusted`."""
        return self.adjusted < FALSE_DISCOVERY_RATE


class AbstractPatterns(ShownInNotebooks):
    """What tests say of residuals; it prints as sentences."""

    patterns: tuple[Pattern, ...]

    @property
    def significant(self) -> tuple[Pattern, ...]:
        """The patterns that are significant."""
        return tuple(each for each in self.patterns if each.significant)

    def tests(self) -> "pd.DataFrame":
        """Return a table of all patterns that were looked for: statistic, p-values, what the significant ones mean."""
        import pandas as pd

        columns = ["state", "pattern", "statistic", "p-value", "adjusted", "meaning"]
        rows = [(p.state, p.pattern, p.statistic, p.p_value, p.adjusted, p.meaning) for p in self.patterns]
        return pd.DataFrame(rows, columns=columns)

    def __str__(self) -> str:
        if not self.patterns:
            return "There are too few residuals to test."
        if not self.significant:
            return "The residuals look like white noise: no pattern is significant."
        return "\n".join(f"Residuals of {each.state}, {each.pattern}: {each.meaning}." for each in self.significant)


@dataclass(frozen=True, eq=False)
class Residuals(AbstractPatterns):
    """Measured less fitted states of trials, in standard deviations of the noise; it prints as sentences.

    Parameters
    ----------
    trials
        What was measured, on the scale that the law follows states by.
    fitted
        Each trial's states by the law, and the rates of those of second order, shape (n, D).
    standardized
        Measured less fitted states over their noise, shape (n, states); NaN where nothing was measured.
    rates
        Names of the rates.
    patterns
        What tests say of them.
    """

    trials: Trials
    fitted: tuple[Floats, ...]
    standardized: tuple[Floats, ...]
    rates: tuple[str, ...]
    patterns: tuple[Pattern, ...]

    @cached_property
    def columns(self) -> dict[str, Floats]:
        """What residuals are held against, at all samples, shape (n,): time since the start, states, rates, inputs."""
        schema = self.trials.schema
        since = np.concatenate([each.times - each.times[0] for each in self.trials])
        states = np.concatenate(self.fitted).T
        inputs = np.concatenate([each.inputs for each in self.trials]).T
        names = (*schema.states, *self.rates, *schema.inputs)
        return {schema.time: since, **dict(zip(names, (*states, *inputs), strict=True))}

    def to_frame(self) -> "pd.DataFrame":
        """Return a long table: object, trial, time, and of each state the fitted value and the residual over noise."""
        import pandas as pd

        schema, parts = self.trials.schema, []
        for trial, fitted, residuals in zip(self.trials, self.fitted, self.standardized, strict=True):
            part = {schema.object: trial.object, schema.trial: trial.name, schema.time: trial.times}
            for j, name in enumerate(schema.states):
                part[name], part[f"{name} fitted"] = trial.states[:, j], fitted[:, j]
                part[f"{name} residual/noise"] = residuals[:, j]
            parts.append(pd.DataFrame(part))
        return pd.concat(parts, ignore_index=True)

    def __repr__(self) -> str:
        among = f"{len(self.significant)} of {len(self.patterns)} patterns are significant"
        return f"<Residuals of {len(self.trials)} trials: {among}>"

    def correlations(self, state: int, lags: int = 20) -> Floats:
        """Return the correlation of a state's residuals with those so many samples later, shape (lags,), in trials."""
        return correlations([each[:, state] for each in self.standardized], lags)[0]


def correlations(series: Sequence[Floats], lags: int) -> tuple[Floats, Floats]:
    """Return correlations at lags from 1 on, and how many pairs of values each is from, shape (lags,).

    Values that are NaN have no pairs, and no pair is of two series.
    """
    level = np.concatenate(series)
    mean, variance = np.nanmean(level), np.nanvar(level)
    found, counts = np.zeros(lags), np.zeros(lags)
    for k in range(1, lags + 1):
        pairs = [(own[k:] - mean) * (own[:-k] - mean) for own in series if len(own) > k]
        products = np.concatenate([np.empty(0), *pairs])
        products = products[np.isfinite(products)]
        counts[k - 1] = len(products)
        found[k - 1] = products.mean() / variance if len(products) and variance > 0 else 0.0
    return found, counts
