"""From compressed trials to the selection of every equation."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.formulation import (
    AbstractFormulation,
    CompressedTrials,
    StrongForm,
    differentiation_bias,
    effective_share,
)
from commonlaw.library import Terms
from commonlaw.selection.cross_validation import CrossValidationScore
from commonlaw.selection.rules import Selection, choose
from commonlaw.selection.stability import stability
from commonlaw.solvers import AbstractSolver
from commonlaw.trials import Trial

SEGMENTS = 4
"""Segments of time into which a trial is cut, so that single trials can be held out in part and resampled."""


@dataclass(frozen=True, eq=False)
class Accuracy:
    """What the rows of each object are worth, estimated from some of its trials.

    Parameters
    ----------
    form
        How trials became rows.
    terms
        The library.
    samples
        Some trials of each object.
    """

    form: AbstractFormulation
    terms: Terms
    samples: Sequence[Sequence[Trial]]

    def rows(self, counts: Sequence[int]) -> Floats:
        """Return the number of independent rows of each object that has so many rows."""
        if not isinstance(self.form, StrongForm):
            return np.array(counts, dtype=np.float64)
        shares = [np.mean([effective_share(self.form, trial) for trial in trials]) for trials in self.samples]
        return np.array(counts) * np.array(shares)

    def differentiation_bias(self, target: int, coefficients: Floats) -> Floats:
        """Return the mean squared error that the derivatives of an equation have without noise, shape (objects,)."""
        if not isinstance(self.form, StrongForm):
            return np.zeros(len(self.samples))
        pairs = zip(self.samples, coefficients, strict=True)
        return np.array([differentiation_bias(self.form, self.terms, trials, target, own) for trials, own in pairs])


def select(
    data: CompressedTrials,
    known: Floats,
    solvers: Sequence[AbstractSolver],
    accuracy: Accuracy,
    *,
    rule: str = "one-standard-error",
    n_resamples: int = 0,
    seed: int = 0,
    scores: Sequence[Callable[[Bools], CrossValidationScore]] | None = None,
) -> tuple[Selection, ...]:
    """Return the selection of every equation among the candidates on the paths of some solvers.

    Parameters
    ----------
    data
        The problems of each object's trials, in segments.
    known
        Coefficients that are known, NaN where they are to be found, shape (objects, equations, terms). They are moved
        to the left-hand side, and count neither for nor against a candidate.
    solvers
        Whose paths list the candidates; the first is the one that resamples are given to.
    accuracy
        What the rows are worth.
    rule
        See `choose`.
    n_resamples
        How many resamples tell the stability of the candidates; none by default.
    seed
        Of the resamples.
    scores
        For each equation from a support to its errors on held-out data; default: residuals.
    """
    given, free = np.nan_to_num(known), np.isnan(known[0])
    rest = data.subtract(given)
    rows = accuracy.rows([problem.rows for problem in rest.problems])

    def selection(target: int) -> Selection:
        paths = [partial(solver.path, target=target, allowed=free[target]) for solver in solvers]
        listed = [candidate for path in paths for candidate in path(rest.problems)]
        return choose(
            listed if len(solvers) == 1 else [replace(each, hyperparameter=np.nan) for each in listed],
            rest.groups,
            target,
            free[target],
            rule=rule,
            rows=rows,
            differentiation_bias=lambda own: accuracy.differentiation_bias(target, own + given[:, target]),
            score=None if scores is None else scores[target],
            stability=stability(rest.groups, paths[0], n_resamples, seed) if n_resamples else None,
        )

    return tuple(selection(target) for target in range(len(free)))
