"""Sequentially thresholded least squares, for each object or for all, and the importance of a term over objects."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from numbers import Real

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.runtime.arguments import check_number, check_types, check_whole_number
from commonlaw.solvers.base import (
    AbstractSolver,
    Candidate,
    Candidates,
    Problems,
    Values,
    check_shared,
    groups,
    threshold_path,
)


class AbstractImportance(ABC):
    """From the magnitudes of a term's coefficients to one number."""

    @abstractmethod
    def measure(self, magnitudes: Floats) -> Floats:
        """Reduce magnitudes, shape (objects, ...), over the objects."""


@dataclass(frozen=True)
class L1(AbstractImportance):
    """The sum of the magnitudes: the founding paper's choice."""

    def measure(self, magnitudes: Floats) -> Floats:
        return np.asarray(magnitudes.sum(axis=0))


@dataclass(frozen=True)
class L2(AbstractImportance):
    """The root of the sum of squares."""

    def measure(self, magnitudes: Floats) -> Floats:
        return np.asarray(np.linalg.norm(magnitudes, axis=0))


@dataclass(frozen=True)
class Mean(AbstractImportance):
    """The mean of the magnitudes; does not grow with the number of objects."""

    def measure(self, magnitudes: Floats) -> Floats:
        return np.asarray(magnitudes.mean(axis=0))


@dataclass(frozen=True)
class Median(AbstractImportance):
    """The median of the magnitudes: one object that goes astray does not matter."""

    def measure(self, magnitudes: Floats) -> Floats:
        return np.asarray(np.median(magnitudes, axis=0))


@dataclass(frozen=True)
class Quantile(AbstractImportance):
    """A quantile of the magnitudes, from 0 to 1; a low one keeps only terms that nearly all objects need."""

    level: float = 0.25

    def __post_init__(self) -> None:
        if not isinstance(self.level, Real) or not 0 <= self.level <= 1:
            raise CommonlawError("quantile-level", level=self.level)

    def measure(self, magnitudes: Floats) -> Floats:
        return np.asarray(np.quantile(magnitudes, self.level, axis=0))


@dataclass(frozen=True)
class Count(AbstractImportance):
    """The number of objects whose coefficient has at least a given magnitude, above zero: a vote."""

    magnitude: float = 0.1

    def __post_init__(self) -> None:
        if not isinstance(self.magnitude, Real) or not self.magnitude > 0:
            raise CommonlawError("vote-magnitude", magnitude=self.magnitude)

    def measure(self, magnitudes: Floats) -> Floats:
        return np.asarray(np.sum(magnitudes >= self.magnitude, axis=0), dtype=np.float64)


@dataclass(frozen=True)
class STLSQ(AbstractSolver):
    """Sequentially thresholded least squares, with one support for all objects or each object's own.

    Least squares and dropping of terms whose importance is below the threshold alternate until no term is dropped. The
    importance is taken over the coefficients of all objects (group STLSQ: de Silva, Higdon, Brunton, Kutz 2020, section
    2.3.2, algorithm 1), or with own supports it is the magnitude of the coefficient (Brunton, Proctor, Kutz 2016). The
    path has every breakpoint of the threshold, exactly.

    Raises `CommonlawError` if a value does not fit, or there is an importance without a shared support.

    Parameters
    ----------
    threshold
        Smallest importance of a term that stays, in the coefficients' own units, so that it depends on units and
        origins of the variables; None to have it chosen.
    shared
        Whether all objects have the same terms, or each object its own.
    importance
        The measure R for a shared support: of `commonlaw.solvers`, `L1` (the paper's), `L2`, `Mean`, `Median`,
        `Quantile` or `Count`.
    ridge
        Weight of the squared norm of the coefficients, in their own units, in each least-squares problem.
    max_iterations
        At most so many sweeps; without convergence the fit has an outcome.
    normalize
        Threshold the coefficients of columns of unit norm, so that nothing depends on units.
    """

    threshold: float | None = None
    shared: bool = True
    importance: AbstractImportance = L1()
    ridge: float = 0.0
    max_iterations: int = 10
    normalize: bool = False

    hyperparameter_name = "threshold"

    def __post_init__(self) -> None:
        check_number("threshold", self.threshold, 0, optional=True)
        check_number("ridge", self.ridge, 0)
        check_whole_number("max_iterations", self.max_iterations, 1)
        check_shared(self.shared)
        check_types(STLSQ, vars(self))
        if not self.shared and self.importance != L1():
            raise CommonlawError("importance-own-terms", importance=self.importance)

    def path(self, problems: Problems, target: int, allowed: Bools, values: Values = None) -> Candidates:
        parts = [self._thresholded(group, target, allowed) for group in groups(problems, self.shared)]
        return threshold_path(lambda threshold: Candidate.join([part(threshold) for part in parts]), values)

    def _thresholded(self, problems: Problems, target: int, allowed: Bools) -> Callable[[float], Candidate]:
        """Return the candidate of objects that share a support, by its threshold."""
        norms = np.array([problem.norms for problem in problems])

        @cache  # Thresholds have most of their supports in common
        def fitted(mask: bytes) -> Floats:
            terms = np.frombuffer(mask, dtype=np.bool_)
            return np.array([problem.least_squares(terms, target, self.ridge) for problem in problems])

        def candidate_at(threshold: float) -> Candidate:
            support, largest, smallest, converged = allowed, 0.0, np.inf, False
            for _ in range(self.max_iterations):
                magnitudes = np.abs(fitted(support.tobytes()))
                values = self.importance.measure(magnitudes * norms if self.normalize else magnitudes)
                largest = values[support].max(initial=0.0) if support.any() else largest
                kept = support & (values >= threshold)
                smallest = min(smallest, values[kept].min(initial=np.inf))
                converged = bool(np.array_equal(kept, support))
                if converged:
                    break
                support = kept
            supports, coefficients = np.repeat(support[np.newaxis], len(problems), axis=0), fitted(support.tobytes())
            return Candidate(supports, coefficients, threshold, False, converged, float(largest), float(smallest))

        return candidate_at
