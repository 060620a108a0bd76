"""What solvers come to: one equation for all objects."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.formulation import LeastSquaresProblem, least_squares_of_each

Problems = Sequence[LeastSquaresProblem]
"""The least-squares problem of each object, all of the same library."""

Values = Sequence[float] | None
"""Values of a solver's hyperparameter, each of which gives a candidate; None is the whole path."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One equation that a solver comes to at a value of its hyperparameter.

    Parameters
    ----------
    support
        Which terms are in, shape (objects, terms).
    coefficients
        Shape (objects, terms); exactly zero outside the support.
    hyperparameter
        The solver's hyperparameter that gives it: a threshold, a penalty, or the number of terms.
    proven
        Whether it is proved, to rounding, that no other support of its size has a smaller sum of squared residuals over
        all objects, each relative to its residual variance with all terms.
    converged
        Whether the solver came to its end: a stable support, a minimum, a finished search.
    largest
        The largest value that was compared with the hyperparameter, in the last step that had a term; a support that
        is empty had a hyperparameter above it.
    smallest
        The smallest value that was compared with the hyperparameter and stayed; infinite if none did.
    """

    support: Bools
    coefficients: Floats
    hyperparameter: float
    proven: bool = False
    converged: bool = True
    largest: float = np.inf
    smallest: float = np.inf

    @classmethod
    def join(cls, candidates: Sequence["Candidate"]) -> "Candidate":
        """Return the candidate of all objects from those of some of them, found at one hyperparameter."""
        if len(candidates) == 1:
            return candidates[0]
        return cls(
            np.concatenate([each.support for each in candidates]),
            np.concatenate([each.coefficients for each in candidates]),
            candidates[0].hyperparameter,
            all(each.proven for each in candidates),
            all(each.converged for each in candidates),
            max(each.largest for each in candidates),
            min(each.smallest for each in candidates),
        )


Candidates = tuple[Candidate, ...]
"""Of one equation, from the most terms to the fewest or in the order of given values of the hyperparameter."""


def least_squares(problems: Problems, target: int, support: Bools) -> Floats:
    """Return the least-squares coefficients of one equation on a support; both have shape (objects, terms)."""
    if (support == support[0]).all():
        return least_squares_of_each(problems, support[0], target)
    rows = zip(problems, support, strict=True)
    return np.array([problem.least_squares(terms, target) for problem, terms in rows])
