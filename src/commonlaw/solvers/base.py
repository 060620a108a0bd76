"""What every solver is."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

from commonlaw.array_types import Bools, Floats
from commonlaw.formulation import LeastSquaresProblem


@dataclass(frozen=True, eq=False)
class Fit:
    """What a solver returns.

    Parameters
    ----------
    coefficients
        Shape (objects, equations, terms); exactly zero outside the support.
    support
        Which terms are in, shape (objects, equations, terms).
    largest
        The largest value that was compared with the solver's setting in the last step that had a term, for each
        object and equation, shape (objects, equations); a support that is empty had a setting above it.
    converged
        Whether the solver came to its end: a stable support, a minimum, a finished search.
    """

    coefficients: Floats
    support: Bools
    largest: Floats
    converged: bool


@dataclass(frozen=True, eq=False)
class Candidate:
    """One equation that a solver can come to.

    Parameters
    ----------
    support
        Which terms are in, shape (objects, terms).
    coefficients
        Shape (objects, terms); exactly zero outside the support.
    setting
        The solver's setting that gives it: the smallest threshold or penalty, or the number of terms.
    proven
        Whether it is proved, to rounding, that no other support of its size has a smaller sum of squared residuals over
        all objects, each relative to its residual variance with all terms.
    """

    support: Bools
    coefficients: Floats
    setting: float
    proven: bool = False


class AbstractSolver(ABC):
    """From one system per object to sparse coefficients. Solvers see systems only: no times and no names."""

    @property
    @abstractmethod
    def is_set(self) -> bool:
        """Whether the setting (threshold, penalty, number of terms) is given, so that `solve` can be called."""

    @abstractmethod
    def path(self, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools) -> tuple[Candidate, ...]:
        """Return every equation that some setting gives, from the most terms to the fewest.

        Parameters
        ----------
        problems
            One for each object, all of the same library.
        target
            The equation.
        allowed
            Which terms may enter, shape (terms,).
        """

    @abstractmethod
    def solve(self, problems: Sequence[LeastSquaresProblem], candidates: Bools) -> Fit:
        """Return the coefficients of the terms that matter at the solver's own setting.

        Parameters
        ----------
        problems
            One for each object, all of the same library.
        candidates
            Which terms may enter which equation, shape (equations, terms).
        """
