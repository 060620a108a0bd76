"""The best law of one order, as far as its search has come."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from commonlaw.discovery.screened import Screened
from commonlaw.inference import Pool, Score, may_be_series, may_be_simpler, score_of_order
from commonlaw.law import Step
from commonlaw.library import Order, order_of_each
from commonlaw.trials import Trials

MAX_TERMS_OF_SIMPLE_LAW = 5
"""Coefficients and parameters of an equation more than which may stand for a latent state, or for richer terms."""

_SERIES_DIVISOR = 3
"""Of terms of higher degree, an equation with more than one in so many may be a truncated series."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """The best law of one order so far.

    Parameters
    ----------
    screened
        The terms that were kept.
    pool
        The law among them, and its rivals.
    steps
        What is to be said of the way there.
    followed
        The trials as the law follows them.
    has_richer
        Whether richer terms were sought, too.
    is_coarse
        Whether a finer mesh may explain what was measured.
    is_of_higher_degree
        Whether plain terms are of higher degree, which the evidence prefers.
    """

    screened: Screened
    pool: Pool
    steps: Sequence[Step]
    followed: Trials
    has_richer: bool
    is_coarse: bool = False
    is_of_higher_degree: bool = False

    def __lt__(self, other: "Candidate") -> bool:
        """Return whether the score is less: the best candidate is the least."""
        return self.score < other.score

    @property
    def order(self) -> Order:
        """Of the law."""
        return self.pool.best.problem.order

    @property
    def total_order(self) -> int:
        """Sum of the orders of all states."""
        return sum(order_of_each(self.order, len(self.pool.best.supports)))

    @property
    def most_terms(self) -> int:
        """Of the longest equation."""
        return int(self.pool.best.supports.sum(axis=1).max())

    @cached_property
    def is_simple(self) -> bool:
        """Whether the law explains what was measured, and no richer terms could say it in fewer numbers."""
        if self.pool.best.lack_of_fit or not self.pool.is_determined:
            return False
        if self.has_richer:
            return True
        most = MAX_TERMS_OF_SIMPLE_LAW
        if self.is_of_higher_degree:  # A few of these stand for no shorter law, as a series has most of them
            most = max(most, len(self.pool.best.problem.terms) // _SERIES_DIVISOR)
        return not (may_be_simpler(self.pool.best, most) or may_be_series(self.pool.best))

    @cached_property
    def score(self) -> Score:
        """By its evidence, comparable between orders."""
        return score_of_order(self.pool.best)
