"""The supports of all equations together, by their evidence.

The least-squares problems have the terms of one equation after the other as columns.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.formulation import LeastSquaresProblem, least_squares_of_each
from commonlaw.inference.score.evidence import (
    Measured,
    cost_of_coefficients,
    minus_twice_log_evidence,
    noise_variance,
    residual_squares,
    rss_with_each,
)
from commonlaw.inference.score.priors import StructurePrior
from commonlaw.inference.score.score import Part, Score
from commonlaw.inference.settings import MAX_SWEEPS, MAX_TERMS
from commonlaw.solvers import AbstractSolver


@dataclass(frozen=True, eq=False)
class SupportEvidence:
    """The evidence for supports of all equations of all objects, of which none may have more than `most` terms.

    Problems are of unit variance, one for each object: columns are all terms of the first equation, then of the second,
    ... Which terms may enter which equation has shape (equations, terms). The prior of supports is a `StructurePrior`.
    The offsets are parts of the score of all supports, for a comparison with those of other problems. Equations that
    are stated, shape (equations,), keep all terms that may enter. Parameters inside terms, and what such terms are
    multiplied by, scatter over objects in ratios: where the value of one is given, and not zero, shape (objects,
    columns), it is its logarithm that scatters.
    """

    problems: Sequence[LeastSquaresProblem]
    allowed: Bools
    measured: Measured
    prices: StructurePrior
    most: int = MAX_TERMS
    offsets: Mapping[Part, float] = field(default_factory=dict)
    stated: Bools | None = None
    log_parametrized: Floats | None = None

    def choose(self, start: Bools, solver: AbstractSolver) -> Bools:
        """Return the supports with the largest evidence that are found by choosing one equation after the other.

        Each is chosen from the solver's path, beginning with those of `start`, shape (equations, terms), in the others.
        """
        supports, known = start.copy(), dict[int, bytes]()
        for _ in range(MAX_SWEEPS):
            before = supports.copy()
            for j in self._chosen:
                others = np.delete(supports, j, axis=0).tobytes()
                if known.get(j) != others:  # Where nothing else has changed, the same is chosen again
                    known[j], supports[j] = others, self._choose_equation(supports, j, solver)
            if np.array_equal(before, supports):
                break
        return supports

    def value(self, supports: Bools) -> float:
        """Return the total of the `score` of supports of all equations."""
        evidence = minus_twice_log_evidence(self._scattering, np.flatnonzero(supports), self.measured)
        return sum(self.offsets.values()) + evidence + sum(self.prices.of(each) for each in supports)

    def score(self, supports: Bools) -> Score:
        """Return minus twice the log-evidence of supports of all equations, with their prior, part by part."""
        indices, objects = np.flatnonzero(supports), len(self.problems)
        evidence = minus_twice_log_evidence(self._scattering, indices, self.measured)
        squares = residual_squares(self._scattering, indices)
        likelihood = float(self.measured.deviance(squares, len(indices) * objects))
        coefficients = cost_of_coefficients(len(indices), objects, self.measured)
        return Score(
            {
                **self.offsets,
                "likelihood": likelihood,
                "coefficients": coefficients,
                "scatter": evidence - likelihood - coefficients,
                "structure": sum(self.prices.of(each) for each in supports),
            }
        )

    def noise_variance(self, supports: Bools) -> float:
        """Return the variance of the noise that supports of all equations leave, in units of that which there is."""
        return noise_variance(self._factors, np.flatnonzero(supports), self.measured)

    def path(self, supports: Bools, equation: int, solver: AbstractSolver) -> list[Bools]:
        """Return the supports that a solver lists for one equation, each of shape (terms,), the others' being given."""
        listed = _path(self._alone(supports, equation), self.allowed[equation], solver)
        return [each for each in listed if each.sum() <= self.most]

    def neighbours(
        self, supports: Bools, fitted: Sequence[tuple[float, Bools]] = ()
    ) -> list[list[tuple[float, Bools]]]:
        """Return for each equation the chosen support and those that differ by one term or an exchange of two.

        The best first, each with 2 log B of the chosen against it; the other equations keep their supports. What is
        known of those that were fitted is more exact than what is linearised about the chosen.
        """
        found = []
        for j, chosen in enumerate(supports):
            if j not in self._chosen:
                found.append([(0.0, chosen)])
                continue
            equation = self._equation(supports, j, self._alone(supports, j))
            near = equation.neighbours(chosen, self.allowed[j], max(self.most, chosen.sum()))
            several = [chosen, *(each for _, each in near), *(other[j] for _, other in fitted)]
            listed = list({each.tobytes(): each for each in several}.values())
            others = np.delete(supports, j, axis=0)
            exact = {
                each[j].tobytes(): above for above, each in fitted if np.array_equal(np.delete(each, j, axis=0), others)
            }
            here = equation.value(chosen)
            compared = [
                (exact[key] if (key := each.tobytes()) in exact else equation.value(each) - here, each)
                for each in listed
            ]
            found.append(sorted(compared, key=lambda pair: pair[0]))
        return found

    def coefficients(self, supports: Bools, held: Floats | None = None) -> Floats:
        """Return each object's least-squares coefficients, shape (objects, equations, terms).

        Besides those of the supports, some may be held at values, of the same shape, that are not zero.
        """
        fixed = np.zeros((len(self.problems), *supports.shape)) if held is None else held
        pairs = zip(self.problems, fixed, strict=True)
        left = [each.subtract(own.reshape(1, -1)) if own.any() else each for each, own in pairs]
        return least_squares_of_each(left, supports.ravel(), 0).reshape(fixed.shape) + fixed

    def _choose_equation(self, supports: Bools, equation: int, solver: AbstractSolver) -> Bools:
        """Return the support of one equation, the others' being given."""
        allowed, alone = self.allowed[equation], self._alone(supports, equation)
        evidence, listed = self._equation(supports, equation, alone), _path(alone, allowed, solver)
        if not np.array_equal(supports[equation], allowed):
            listed.append(supports[equation])
        none = np.zeros_like(allowed)
        floors = [(evidence.value(each, -np.inf), each) for each in listed if each.sum() <= self.most]
        best, value = evidence.best(floors, none, evidence.value(none))
        while True:
            better, value = evidence.best(evidence.neighbours(best, allowed, self.most), best, value)
            if better is best:
                return best
            best = better

    def _equation(self, supports: Bools, equation: int, alone: Sequence[LeastSquaresProblem]) -> "_EquationEvidence":
        """Return the evidence for one equation, by its problems, the others' terms being given."""
        others = int(np.delete(supports, equation, axis=0).sum())
        measured = self.measured.without(others * len(self.problems))
        return _EquationEvidence(np.array([problem.factor for problem in alone]), measured, self.prices)

    def _alone(self, supports: Bools, equation: int) -> list[LeastSquaresProblem]:
        """Return the problems of one equation, with what the terms of the others explain taken out."""
        terms = supports.shape[1]
        mine = np.arange(equation * terms, (equation + 1) * terms)
        others = np.setdiff1d(np.flatnonzero(supports), mine)
        columns = [*others, *mine, supports.size]
        factors = np.asarray(np.linalg.qr(self._factors[:, :, columns], mode="r"))[:, len(others) :, len(others) :]
        return [
            LeastSquaresProblem(np.asfortranarray(factor), terms, problem.rows)
            for factor, problem in zip(factors, self.problems, strict=True)
        ]

    @property
    def _chosen(self) -> list[int]:
        """The equations whose terms are chosen."""
        return [j for j in range(len(self.allowed)) if self.stated is None or not self.stated[j]]

    @cached_property
    def _factors(self) -> Floats:
        return np.array([problem.factor for problem in self.problems])

    @cached_property
    def _scattering(self) -> Floats:
        return scattering(self._factors, self.log_parametrized)


def scattering(factors: Floats, log_parametrized: Floats | None) -> Floats:
    """Return the factors of what scatters over objects: coefficients, or logarithms of their sizes.

    A law of s/(K + s) that is next to linear tells the ratio of its coefficient to K alone. Such lines all meet at
    zero, where neither would scatter at all; lines of logarithms are parallel. See `SupportEvidence.log_parametrized`.
    """
    if log_parametrized is None:
        return factors
    found, values = factors.copy(), log_parametrized[:, np.newaxis, :]
    logarithms = np.log(np.abs(values), out=np.zeros_like(values), where=values != 0)
    found[:, :, :-1] *= np.where(values != 0, values, 1.0)
    # Counted from one where objects are alike, whatever the units
    found[:, :, -1] += np.sum(found[:, :, :-1] * (logarithms - logarithms.mean(axis=0)), axis=2)
    return found


@dataclass(frozen=True, eq=False)
class _EquationEvidence:
    """The evidence for supports of one equation; `factors` of shape (objects, terms + 1, terms + 1)."""

    factors: Floats
    measured: Measured
    prices: StructurePrior

    def value(self, support: Bools, needed: float = np.inf) -> float:
        """Return minus twice the log-evidence and prior of a support, or a lower bound that is not below `needed`."""
        price, indices = self.prices.of(support), np.flatnonzero(support)
        return price + minus_twice_log_evidence(self.factors, indices, self.measured, needed - price)

    def best(self, listed: Iterable[tuple[float, Bools]], best: Bools, value: float) -> tuple[Bools, float]:
        """Return the best of a support of given value and of others, listed with lower bounds; and its value."""
        for floor, support in sorted(listed, key=lambda pair: pair[0]):
            if floor >= value:
                break
            other = self.value(support, value)
            best, value = (support, other) if other < value else (best, value)
        return best, value

    def neighbours(self, support: Bools, allowed: Bools, most: int) -> Iterator[tuple[float, Bools]]:
        """Yield supports that differ by a term or an exchange of two, of so many terms, with lower bounds of values."""
        objects, outside = len(self.factors), np.flatnonzero(allowed & ~support).tolist()
        for leaving in (-1, *np.flatnonzero(support).tolist()):
            staying = support.copy()
            staying[leaving] &= leaving < 0
            rests = rss_with_each(self.factors, np.flatnonzero(staying))
            for entering in outside if leaving < 0 else (-1, *outside):
                changed = staying.copy()
                changed[entering] |= entering >= 0
                size = int(changed.sum())
                if size <= most:
                    least = float(self.measured.deviance(float(rests[entering]), size * objects))
                    cost = cost_of_coefficients(size, objects, self.measured)
                    yield least + cost + self.prices.of(changed), changed


def _path(problems: Sequence[LeastSquaresProblem], allowed: Bools, solver: AbstractSolver) -> list[Bools]:
    return [np.asarray(each.support.any(axis=0)) for each in solver.path(problems, 0, allowed)]
