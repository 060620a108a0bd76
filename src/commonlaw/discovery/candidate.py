"""The terms that a screening has kept of many, and the best law of one order among them so far."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.discovery.model_structure import ModelStructure
from commonlaw.inference import (
    Fit,
    Pool,
    Score,
    may_be_series,
    may_be_simpler,
    missed_terms,
    promising_terms,
    score_of_order,
)
from commonlaw.law import Step
from commonlaw.library import Order, SelectedLibrary, Terms, order_of_each
from commonlaw.text import counted
from commonlaw.trials import Trials


@dataclass(frozen=True, eq=False)
class Screened:
    """What is sought among the terms that a screening has kept of many, shape (terms,); all if they are not many."""

    whole: ModelStructure
    terms: Terms
    kept: Bools

    @classmethod
    def of(cls, trials: Trials, structure: ModelStructure) -> "Screened":
        """Return what is sought in trials, of many terms those that explain most."""
        terms, schema = structure.terms(trials.schema), trials.schema
        known = structure.known_coefficients(schema, trials.objects)
        needed = (structure.universal_coefficients(schema) | ~np.isnan(known).any(axis=0)).any(axis=0)
        return cls(structure, terms, promising_terms(trials, terms, known, np.asarray(needed)))

    @cached_property
    def structure(self) -> ModelStructure:
        """The same question with the plain terms that were kept."""
        if self.kept.all() and not self.whole.library.parametric(self.terms.variables):
            return self.whole
        names = tuple(self.terms.names[i] for i in np.flatnonzero(self.kept))
        return replace(self.whole, library=SelectedLibrary(self.whole.library, names))

    @property
    def steps(self) -> tuple[Step, ...]:
        """What is said of it."""
        if self.kept.all():
            return ()
        why = "terms that explain most of the smoothed rates; none of the others improves the law"
        return (Step("screening", f"{int(self.kept.sum())} of {counted(len(self.terms), 'term')}", why),)

    def among(self, fit: Fit) -> "Screened":
        """Return the same with the terms among which a law was chosen."""
        return replace(self, kept=np.isin(self.terms.names, fit.problem.terms.names))

    def with_missed(self, fit: Fit) -> "Screened | None":
        """Return the same with terms that were left out and improve a law; None if there are none."""
        missed = missed_terms(fit, self.terms)
        return replace(self, kept=self.kept | missed) if missed.any() else None


MAX_TERMS_OF_SIMPLE_LAW = 5
"""Coefficients and parameters of an equation more than which may stand for a latent state, or for richer terms."""


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
        if self.is_of_higher_degree:  # A few of these stand for no shorter law, as a series has a third of them
            most = max(most, len(self.pool.best.problem.terms) // 3)
        return not (may_be_simpler(self.pool.best, most) or may_be_series(self.pool.best))

    @cached_property
    def score(self) -> Score:
        """By its evidence, comparable between orders."""
        return score_of_order(self.pool.best)
