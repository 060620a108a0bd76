"""How a law was found: the differentiation, the candidates, every choice, and what a user should know of it."""

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from typing import Any

from commonlaw.differentiation import AbstractDifferentiator
from commonlaw.law.domain import Domain
from commonlaw.notebooks import ShownInNotebooks
from commonlaw.outcomes import Outcome

_WIDTH = 60
"""Characters of a line of a reason."""


@dataclass(frozen=True)
class Alternative:
    """One of the candidates that an equation was chosen from.

    Parameters
    ----------
    equation
        The left-hand side.
    terms
        The terms that some object has.
    measures
        What speaks for it by name (criteria, held-out error and its standard error, stability); None where a measure
        is not to be had.
    proven
        Whether no other support of its size fits better.
    chosen
        Whether it is the law.
    hyperparameters
        The values of the solver's hyperparameter (threshold, penalty, number of terms) at which its segments of the
        path begin; none if candidates of several solvers were compared.
    """

    equation: str
    terms: tuple[str, ...]
    measures: Mapping[str, float | None]
    proven: bool
    chosen: bool
    hyperparameters: tuple[float, ...] = ()


@dataclass(frozen=True)
class Step:
    """One choice on the way to a law.

    Parameters
    ----------
    stage
        What was to be chosen: ``"noise"``, ``"support"``.
    choice
        What was chosen: ``"x: 0.05 m"``.
    reason
        Why, with the numbers that decided.
    """

    stage: str
    choice: str
    reason: str


class History(ShownInNotebooks, tuple[Step, ...]):
    """Every choice on the way to a law, in order; it prints as a table.

    >>> print(History([Step("noise", "x: 0.05", "from differences of order 4")]))
    stage  choice   reason
    noise  x: 0.05  from differences of order 4
    """

    def __str__(self) -> str:
        if not self:
            return "no choices are on record"
        rows = [("stage", "choice", "reason"), *((each.stage, each.choice, each.reason) for each in self)]
        cells = [[textwrap.wrap(text, _WIDTH) or [""] for text in row] for row in rows]
        lines = [line for row in cells for line in zip_longest(*row, fillvalue="")]
        stages, choices, _ = (max(map(len, column)) for column in zip(*lines, strict=True))
        return "\n".join(f"{one:<{stages}}  {two:<{choices}}  {three}".rstrip() for one, two, three in lines)


@dataclass(frozen=True)
class Provenance:
    """Where a law comes from.

    Parameters
    ----------
    differentiation
        How derivatives were estimated; a forecast from measurements estimates the initial derivatives in the same way.
        None if they were not, or if it is not known.
    outcomes
        What a user should know about how the law was found.
    alternatives
        The candidates that it was chosen from, if it was chosen.
    history
        Every choice on the way to the law, in order.
    equations
        The equations as they were given, if they were; letters in them name the coefficients.
    calls
        The calls that made it of ``trials``, one after the other, as Python: ``cl.discover(trials, order=2)``; none if
        they are not known.
    domain
        What it was learned from, and how far ahead its forecasts are good.
    with_discrepancy
        The same law with a discrepancy as further terms, if `Law.discrepancy` found these coefficients.
    """

    differentiation: AbstractDifferentiator | None = None
    outcomes: tuple[Outcome, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    history: tuple[Step, ...] = ()
    equations: tuple[str, ...] = ()
    calls: tuple[str, ...] = ()
    domain: Domain = field(default_factory=Domain)
    with_discrepancy: Any = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "history", History(self.history))

    @property
    def is_learned(self) -> bool:
        """Whether anything is on record of how the law was learned from trials: it may have been given as it is."""
        return bool(self.history or self.calls or self.alternatives or self.outcomes or self.differentiation)

    def judged(self, horizon: float, longest: float) -> "Provenance":
        """Return the same for a law that was judged: it knows how far ahead its forecasts are good, of the longest."""
        return replace(self, domain=self.domain.with_horizon(horizon, longest))
