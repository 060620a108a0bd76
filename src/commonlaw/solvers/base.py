"""What every solver is, what it comes to, and the paths that several have."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.errors import CommonlawError
from commonlaw.formulation import LeastSquaresProblem, least_squares_of_each
from commonlaw.solvers.standardized_problem import StandardizedProblem

Problems = Sequence[LeastSquaresProblem]
"""The least-squares problem of each object, all of the same library."""

Values = Sequence[float] | None
"""Values of a solver's hyperparameter, each of which gives a candidate; None is the whole path."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One equation that a solver finds at a value of its hyperparameter.

    Parameters
    ----------
    support, coefficients
        Shape (objects, terms); coefficients are exactly zero outside the support.
    hyperparameter
        A threshold, a penalty, or the number of terms.
    proven
        Whether no other support of its size has a smaller sum of squared residuals over all objects, to rounding, each
        relative to its residual variance with all terms.
    converged
        Whether the solver ended with a stable support, a minimum, or a finished search.
    largest, smallest
        The largest value compared with the hyperparameter in the last step that had a term, and the smallest that
        stayed, infinite if none did.
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


class AbstractSolver(ABC):
    """From one least-squares problem per object to sparse coefficients; solvers see no times and no names."""

    @property
    @abstractmethod
    def hyperparameter_name(self) -> str:
        """Name of the argument that says how sparse an equation is: threshold, penalty, terms."""

    @property
    def hyperparameter(self) -> float | None:
        """Its value, with which `solve` can be called; None to have it chosen from the path."""
        value: float | None = getattr(self, self.hyperparameter_name)
        return value

    @abstractmethod
    def path(self, problems: Problems, target: int, allowed: Bools, values: Values = None) -> Candidates:
        """Return the candidates of one equation at values of the hyperparameter.

        Parameters
        ----------
        problems
            One for each object, all of the same library.
        target
            The equation.
        allowed
            Which terms may enter, shape (terms,).
        values
            Of the hyperparameter, a candidate each. None is the whole path, from the most terms to the fewest.
        """

    def solve(self, problems: Problems, allowed: Bools) -> Candidates:
        """Return the candidate of each equation at the solver's own hyperparameter.

        Terms that may enter have shape (equations, terms). Raises `CommonlawError` if the hyperparameter has no value.
        """
        value = self.hyperparameter
        if value is None:
            raise CommonlawError("solver-without-value", hyperparameter=self.hyperparameter_name)
        return tuple(self.path(problems, target, own, [value])[0] for target, own in enumerate(allowed))


def groups(problems: Problems, shared: bool) -> list[Problems]:
    """Return the objects that have one support: all of them, or each by itself."""
    return [problems] if shared else [[problem] for problem in problems]


def threshold_path(candidate_at: Callable[[float], Candidate], values: Values) -> Candidates:
    """Return the candidates of some thresholds, or of growing ones from zero until no term is left.

    The support changes only where the threshold passes the smallest value that stayed, which is the next that is tried.
    """
    if values is not None:
        return tuple(map(candidate_at, values))
    found = [candidate_at(0.0)]
    while found[-1].support.any():
        last = found[-1]
        found.append(candidate_at(float(np.nextafter(max(last.smallest, last.hyperparameter), np.inf))))
    return tuple(found)


def each_support_once(path: Candidates) -> Candidates:
    """Return a path without the candidates that have the support of the one before."""
    changed = [each for last, each in pairwise(path) if not np.array_equal(last.support, each.support)]
    return (path[0], *changed)


@dataclass(frozen=True, eq=False)
class Subset:
    """The indices of the terms that were chosen, among those allowed; see `Candidate` for the rest."""

    indices: Indices
    proven: bool = False
    converged: bool = True


def fixed_cardinality(
    choose: Callable[[StandardizedProblem, Sequence[int]], Mapping[int, Subset]],
    shared: bool,
    problems: Problems,
    target: int,
    allowed: Bools,
    values: Values,
) -> Candidates:
    """Return one candidate for each number of terms, or with all allowed terms where these are fewer.

    From the problem of objects that share a support `choose` makes the subset for each number of terms; without values
    all numbers from all to none. Objects with own supports have as many terms each.
    """
    most = int(allowed.sum())
    sizes = range(most, -1, -1) if values is None else [min(int(value), most) for value in values]

    def candidates(group: Problems) -> list[Candidate]:
        chosen = choose(StandardizedProblem.of(group, target, allowed), sizes)
        return [candidate(group, size, chosen[size]) for size in sizes]

    def candidate(group: Problems, size: int, chosen: Subset) -> Candidate:
        support = np.zeros((len(group), len(allowed)), dtype=bool)
        support[:, np.flatnonzero(allowed)[chosen.indices]] = True
        found = least_squares(group, target, support)
        return Candidate(support, found, float(size), chosen.proven, chosen.converged, float(most))

    by_group = [candidates(group) for group in groups(problems, shared)]
    return tuple(Candidate.join(own) for own in zip(*by_group, strict=True))


def check_shared(shared: object) -> None:
    """Refuse what is neither True nor False."""
    if not isinstance(shared, bool):
        raise CommonlawError("shared-not-a-choice", shared=shared)
