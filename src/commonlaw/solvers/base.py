"""What every solver is, the standardized problem that several solve, what they come to, and their paths."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.errors import CommonlawError
from commonlaw.formulation import LeastSquaresProblem, explained, least_squares_of_each
from commonlaw.runtime.forking import cached_property

_RIDGE = 1e-11
"""Parts columns of unit norm that depend on each other, so that five digits of their directions remain."""

_MIN_NORM = 1e-14
"""What is left of a unit vector, of which no digit is right."""


@dataclass(frozen=True, eq=False)
class StandardizedProblem:
    """The least-squares problems of one equation, one for each object, and the terms that may enter.

    Columns have unit norm. Each object's squared residuals are divided by its residual variance with all terms
    (generalized least squares with fixed variances), so that no object dominates because it is large or noisy; with no
    more rows than terms the mean square of its target is taken.

    `columns` are upper triangular factors, shape (objects, p, p), `right` is the target in the same basis, shape
    (objects, p), `rest` the residual of all terms, summed over objects, and `variance` has shape (objects,).
    """

    columns: Floats
    right: Floats
    rest: float
    variance: Floats

    @classmethod
    def of(cls, problems: Sequence[LeastSquaresProblem], target: int, allowed: Bools) -> "StandardizedProblem":
        """Return the problem of all objects from theirs; dependent columns are parted by a small ridge."""
        size = int(allowed.sum())
        factors = np.array([problem.factor for problem in problems])
        norms = np.array([problem.norms[allowed] for problem in problems])
        columns = factors[:, :, : problems[0].terms][:, :, allowed] / np.where(norms > 0, norms, 1.0)[:, np.newaxis]
        right = factors[:, :, problems[0].terms + target, np.newaxis]
        ridge = np.broadcast_to(np.eye(size, size + 1) * _RIDGE, (len(problems), size, size + 1))
        stacked = np.concatenate([np.concatenate([columns, right], axis=2), ridge], axis=1)
        reduced = np.asarray(np.linalg.qr(stacked, mode="r"))
        rest = reduced[:, size, size] ** 2
        rows = np.array([problem.rows for problem in problems])
        mean = np.sum(right[..., 0] ** 2, axis=1) / np.maximum(rows, 1)
        variance = np.where(rows > size, rest / np.maximum(rows - size, 1), mean)
        variance = np.maximum(variance, 1e-20 * mean)  # Smaller ones tell the ridge and rounding, and not the noise
        variance = np.where(variance > 0, variance, 1.0)
        scaled = reduced[:, :size, size] / np.sqrt(variance)[:, np.newaxis]
        return cls(reduced[:, :size, :size], scaled, float(np.sum(rest / variance)), variance)

    @property
    def size(self) -> int:
        """Number of terms that may enter."""
        return int(self.right.shape[1])

    @property
    def rounding(self) -> float:
        """The size of what the ridge and rounding add to a sum of squared residuals."""
        return float(_RIDGE**2 * np.sum(self.right**2))

    @cached_property
    def entering(self) -> "Directions":
        """What each term explains when it enters alone."""
        return Directions.of(self.columns.transpose(0, 2, 1), self.right, np.arange(self.size))

    @cached_property
    def leaving(self) -> "Directions":
        """What each term's leaving of the full equation costs.

        The columns are ``Q R``. Leaving out the terms D adds to the squared residuals the squared projection of ``Q'
        target`` onto the span of those rows of ``R^-1``: terms leave by the same steps by which they enter.
        """
        return Directions.of(np.asarray(np.linalg.inv(self.columns)), self.right, np.arange(self.size))

    def residual(self, indices: Sequence[int] | Indices) -> float:
        """Return the sum over objects of scaled squared residuals of least squares on these of the allowed terms."""
        return self.rest + float(self._explained(indices)[-1])

    def best_entering(self, inside: Sequence[int] | Indices) -> int:
        """Return which of the other terms explains most when it enters in addition to those inside."""
        result = self._explained(inside)[:-1]
        result[np.asarray(inside, dtype=np.intp)] = -np.inf
        return int(np.argmax(result))

    def _explained(self, inside: Sequence[int] | Indices) -> Floats:
        return explained(self._rows, np.asarray(inside, dtype=np.intp), _MIN_NORM**2)

    @cached_property
    def _rows(self) -> Floats:
        return np.concatenate([self.columns, self.right[..., np.newaxis]], axis=2)


@dataclass(frozen=True, eq=False)
class Directions:
    """Unit directions of terms, shape (objects, terms, p), and the vectors projected on them, (objects, p)."""

    units: Floats
    left: Floats
    indices: Indices

    @classmethod
    def of(cls, vectors: Floats, left: Floats, indices: Indices) -> "Directions":
        """Scale vectors to unit norm; what is rounding compared with a unit becomes zero."""
        norms = np.sqrt(np.einsum("otp,otp->ot", vectors, vectors))
        scale = np.divide(1.0, norms, out=np.zeros_like(norms), where=norms > _MIN_NORM)
        return cls(vectors * scale[..., np.newaxis], left, indices)

    @property
    def error_reductions(self) -> Floats:
        """Squared projections onto each term's direction, summed over the objects, shape (terms,)."""
        projections = np.matmul(self.units, self.left[..., np.newaxis])[..., 0]
        return np.asarray(np.einsum("ot,ot->t", projections, projections))

    def take(self, index: int) -> "Directions":
        """Return the others, with this one projected out (a step of modified Gram-Schmidt)."""
        axis = self.units[:, index]
        others = np.delete(self.units, index, axis=1)
        others -= np.matmul(others, axis[..., np.newaxis]) * axis[:, np.newaxis]
        residuals = self.left - np.sum(self.left * axis, axis=1, keepdims=True) * axis
        return Directions.of(others, residuals, np.delete(self.indices, index))

    def drop(self, index: int) -> "Directions":
        """Return the others as they are."""
        return Directions(np.delete(self.units, index, axis=1), self.left, np.delete(self.indices, index))

    def pair_error_reductions(self) -> Floats:
        """Squared projections onto the span of every pair, summed over the objects, shape (terms, terms).

        Sum and difference of two unit vectors are an orthogonal basis of their span.
        """
        cosines = np.matmul(self.units, self.units.transpose(0, 2, 1))
        projections = np.matmul(self.units, self.left[..., np.newaxis])[..., 0]
        rows, columns = projections[:, :, np.newaxis], projections[:, np.newaxis]
        total = np.zeros(cosines.shape[1:])
        for sign in (1.0, -1.0):
            squares = 2 + 2 * sign * cosines
            near = np.nonzero(squares < 1e-6)
            squares[near] = np.sum((self.units[near[0], near[1]] + sign * self.units[near[0], near[2]]) ** 2, axis=-1)
            both = (rows + sign * columns) ** 2
            total += np.divide(both, squares, out=np.zeros_like(both), where=squares > _MIN_NORM**2).sum(axis=0)
        return total


Problems = Sequence[LeastSquaresProblem]
"""The least-squares problem of each object, all of the same library."""

Values = Sequence[float] | None
"""Values of a solver's hyperparameter, each of which gives a candidate; None is the whole path."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """One equation that a solver finds at a value of its hyperparameter: threshold, penalty, or number of terms.

    Support and coefficients have shape (objects, terms); coefficients are exactly zero outside the support. It is
    `proven` that no other support of its size has a smaller sum of squared residuals over all objects, to rounding,
    each relative to its residual variance with all terms. A solver `converged` with a stable support, a minimum, or a
    finished search. `largest` is the largest value compared with the hyperparameter in the last step that had a term,
    and `smallest` the smallest that stayed, infinite if none did.
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
            np.concatenate([candidate.support for candidate in candidates]),
            np.concatenate([candidate.coefficients for candidate in candidates]),
            candidates[0].hyperparameter,
            all(candidate.proven for candidate in candidates),
            all(candidate.converged for candidate in candidates),
            max(candidate.largest for candidate in candidates),
            min(candidate.smallest for candidate in candidates),
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
        return tuple(self.path(problems, target, terms, [value])[0] for target, terms in enumerate(allowed))


def groups(problems: Problems, shared: bool) -> list[Problems]:
    """Return the objects that have one support: all of them, or each by itself."""
    return [problems] if shared else [[problem] for problem in problems]


def threshold_path(candidate_at: Callable[[float], Candidate], values: Values) -> Candidates:
    """Return the candidates of some thresholds, or of growing ones from zero until no term is left.

    The support changes only where the threshold passes the smallest value that stayed, which is the next that is tried.
    """
    if values is not None:
        return tuple(map(candidate_at, values))
    result = [candidate_at(0.0)]
    while result[-1].support.any():
        last = result[-1]
        result.append(candidate_at(float(np.nextafter(max(last.smallest, last.hyperparameter), np.inf))))
    return tuple(result)


def each_support_once(path: Candidates) -> Candidates:
    """Return a path without the candidates that have the support of the one before."""
    changed = [candidate for last, candidate in pairwise(path) if not np.array_equal(last.support, candidate.support)]
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
        coefficients = least_squares(group, target, support)
        return Candidate(support, coefficients, float(size), chosen.proven, chosen.converged, float(most))

    by_group = [candidates(group) for group in groups(problems, shared)]
    return tuple(Candidate.join(of_size) for of_size in zip(*by_group, strict=True))


def check_shared(shared: object) -> None:
    """Refuse what is neither True nor False."""
    if not isinstance(shared, bool):
        raise CommonlawError("shared-not-a-choice", shared=shared)
