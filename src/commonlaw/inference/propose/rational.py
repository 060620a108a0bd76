"""Ranking of ratios of two sums of terms for one equation by residual sums of squares, see `integral_ranking`.

Given the coefficients of the denominator, those of the numerator follow by least squares (variable projection; Golub
and Pereyra 1973). All denominators of two terms are compared on a grid of values with every small numerator; the best
of them get another term, and so on. Measurements are compared with integrals of the ratio along estimated states. The
equation is not multiplied by the denominator, which would put measurement errors into the regressors.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from itertools import chain, combinations
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.inference import settings
from commonlaw.inference.fit.integral_form import (
    CurveData,
    Integrals,
    forward_difference_points,
    gauss_newton,
    least_squares,
    normalized,
    variable_projection,
)
from commonlaw.inference.fit.lack_of_fit import with_chord_points
from commonlaw.inference.fit.parameter_grid import log_grid
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.propose.integral_ranking import (
    CandidateSupport,
    InformationCriterion,
    expand_to_objects,
    object_curves,
)
from commonlaw.library import Ratios, Terms
from commonlaw.likelihood import Estimate
from commonlaw.runtime.checkpoint import at_checkpoint
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.parallel import in_parallel


def rank_ratios(
    problem: SearchProblem,
    estimates: Sequence[Estimate],
    offered: Sequence[Ratios],
    most: Mapping[int, int],
) -> dict[int, list[CandidateSupport]]:
    """Return candidate supports with offered ratios, ranked by BIC, see `rank_supports`."""
    courses = cache(lambda: object_curves(problem, estimates, ()))

    def ranked(equation: int, numbers: int) -> list[CandidateSupport]:
        scored = list[tuple[float, CandidateSupport]]()
        for ratios in offered:
            sides = [_Sides.of(course, equation, ratios) for course in courses()]
            sides = [side for side in sides if len(side.target)]
            scored += _Ranking(problem, equation, ratios, sides, numbers).best() if sides else []
        return [support for _, support in sorted(scored, key=lambda pair: pair[0])]

    key = rank_ratios.__qualname__, problem, estimates, offered
    return {
        equation: at_checkpoint(partial(ranked, equation, numbers), *key, equation, numbers)
        for equation, numbers in most.items()
    }


@dataclass(frozen=True, eq=False)
class _Sides:
    """Terms of the numerator, of the denominator and added ones along states of an object, with its measurements.

    The target and `integrals` are those of an `IntegralRegression`; integrals of added terms have shape (m, terms).
    Values of numerator and denominator terms along the states have shape (n, terms), and those of denominator terms at
    these states and points between them (k, terms).
    """

    target: Floats
    integrals: Integrals
    added: Floats
    above: Floats
    below: Floats
    between: Floats

    @classmethod
    def of(cls, course: CurveData, equation: int, offered: Ratios) -> "_Sides":
        match, values = course.regression(equation), course.grids.values
        variables = course.problem.models[course.index].terms.variables
        added, above, below = (Terms(variables, terms) for terms in (offered.added, offered.above, offered.below))
        return cls(
            match.target,
            match.integrals,
            match.integrals.of(added.evaluate(values)),
            above.evaluate(values),
            below.evaluate(values),
            below.evaluate(with_chord_points(values)),
        )

    def columns(self, below: Sequence[int], coefficients: Floats) -> Floats:
        """Return integrals of all numerator and added terms, shape (values, m, terms).

        Coefficients of the denominator have the shape (values, denominator terms).
        """
        with np.errstate(all="ignore"):
            rates = self.above[:, np.newaxis, :] / (self.below[:, below] @ coefficients.T)[:, :, np.newaxis]
        ratios = self.integrals.of(rates.reshape(len(rates), -1)).reshape(-1, *rates.shape[1:]).transpose(1, 0, 2)
        return np.concatenate([ratios, np.broadcast_to(self.added, (len(ratios), *self.added.shape))], axis=2)

    def has_no_pole(self, below: Sequence[int], coefficients: Floats) -> Bools:
        """Return at which coefficients the denominator has no zero along the states, shape (values,)."""
        signs = np.sign(self.between[:, below] @ coefficients.T)
        return np.asarray(np.ptp(signs, axis=0) == 0)

    def left(self, below: Sequence[int], coefficients: Floats, sets: Sequence[Indices]) -> Floats:
        """Return residual sums of squares, shape (values, sets), see `columns`.

        The sets of each size have the shape (sets, size).
        """
        columns, _ = normalized(self.columns(below, coefficients))
        gram, inner = np.matmul(columns.transpose(0, 2, 1), columns), np.matmul(self.target, columns)
        gained = []
        for subset in sets:
            inside = gram[:, subset[:, :, np.newaxis], subset[:, np.newaxis, :]] + settings.COLLINEAR * np.eye(
                subset.shape[1]
            )
            solutions = np.linalg.solve(inside, inner[:, subset][..., np.newaxis])[..., 0]
            gained.append(np.sum(inner[:, subset] * solutions, axis=2))
        squares = self.target @ self.target - np.concatenate(gained, axis=1)
        squares[~self.has_no_pole(below, coefficients)] = np.inf
        return np.asarray(np.maximum(squares, np.finfo(float).tiny))

    def fitted(self, below: Sequence[int], coefficients: Floats, terms: Sequence[int]) -> tuple[Floats, Floats]:
        """Return coefficients of numerator and added terms, and residuals; the target if the denominator vanishes."""
        if not self.has_no_pole(below, coefficients[np.newaxis]).all():
            return np.zeros(len(terms)), self.target
        return least_squares(self.columns(below, coefficients[np.newaxis])[0][:, terms], self.target)

    def closest(self, below: Sequence[int], begin: Floats, terms: Sequence[int]) -> Floats:
        """Return locally optimal coefficients of the denominator, starting from nonzero ones."""

        def linearized(values: Floats) -> tuple[Floats, Floats]:
            several = np.column_stack([forward_difference_points(values), np.full(len(begin), begin[-1])])
            if not self.has_no_pole(below, several[:1]).all():
                return self.target, np.zeros((len(self.target), len(values)))
            return variable_projection(self.target, self.columns(below, several)[:, :, terms])

        return np.append(gauss_newton(linearized, begin[:-1]), begin[-1])


class _Shape(NamedTuple):
    """Indices of the numerator, denominator and added terms."""

    above: tuple[int, ...]
    below: tuple[int, ...]
    added: tuple[int, ...]

    @property
    def numbers(self) -> int:
        return len(self.above) + len(self.below) - 1 + len(self.added)


class _Score(NamedTuple):
    """Residual sum of squares over all objects at denominator coefficients, shape (objects, denominator terms)."""

    squares: float
    below: Floats


@dataclass(frozen=True, eq=False)
class _Ranking:
    """Ranking of the ratios for an equation by residual sums of squares over all objects.

    Ratios with one parameter more than `at_most` are computed, too, from which a term may be dropped.
    """

    problem: SearchProblem
    equation: int
    offered: Ratios
    sides: Sequence[_Sides]
    at_most: int

    def best(self) -> list[tuple[float, CandidateSupport]]:
        """Return the best shapes of each size with their BIC."""
        scores, optimized = self._all(), set[_Shape]()

        def ranked(numbers: int, shapes: Iterable[_Shape]) -> list[tuple[float, _Shape]]:
            return sorted((scores[shape].squares, shape) for shape in shapes if shape.numbers == numbers)

        sizes = sorted({shape.numbers for shape in scores})
        least = {numbers: ranked(numbers, scores)[0][0] for numbers in sizes}
        most = min(self._criterion.enough(least), self.at_most)
        for numbers in range(most + 2):
            for _, shape in ranked(numbers, scores)[: settings.MAX_REFINED]:
                scores[shape] = self._optimized(shape, scores[shape])
                optimized.add(shape)
        for numbers in range(most + 1, 1, -1):
            for _, shape in ranked(numbers, optimized)[:1]:
                for less, score in self._without_one(shape, scores[shape]):
                    if less not in optimized or score.squares < scores[less].squares:
                        scores[less] = score
                        optimized.add(less)
        listed = [(numbers, ranked(numbers, optimized)) for numbers in sorted({shape.numbers for shape in optimized})]
        kept = self._criterion.kept(listed, self.at_most)
        pairs = ((value, self._with_starts(shape, scores[shape])) for value, shape in kept)
        return [(value, support) for value, support in pairs if support is not None]

    def _all(self) -> dict[_Shape, _Score]:
        result = dict[_Shape, _Score]()
        count = len(self.offered.below)
        listed = [(below, np.ones((len(self.sides), 1))) for below in combinations(range(count), 1)]
        for size in range(2, min(settings.MAX_SUM_TERMS[2], count) + 1):
            wider = dict[_Shape, _Score]()
            for below, coefficients in listed:
                for new in range(count) if size > 2 else range(below[0] + 1, count):
                    if new not in below:
                        self._add(wider, (*below, new), coefficients)
            result |= wider
            best = dict[tuple[int, ...], Floats]()  # Denominators of the best shapes
            for shape in sorted(wider, key=lambda shape: self._criterion(shape.numbers, wider[shape].squares)):
                best.setdefault(shape.below, wider[shape].below)
            listed = [*best.items()][: settings.MAX_KEPT]
        return result

    def _without_one(self, shape: _Shape, score: _Score) -> Iterator[tuple[_Shape, _Score]]:
        """Yield shapes with one term less, at denominator coefficients optimized from those of the larger one."""
        for place, terms in enumerate(shape):
            for k in range(len(terms)):
                parts = [*shape]
                parts[place] = terms[:k] + terms[k + 1 :]
                less, columns = _Shape(*parts), np.delete(np.arange(len(shape.below)), k if place == 1 else [])
                if less.above and len(less.below) > 1 and self.offered.is_reduced(less.above, less.below):
                    yield less, self._optimized(less, _Score(np.inf, score.below[:, columns]))

    def _add(self, found: dict[_Shape, _Score], below: tuple[int, ...], coefficients: Floats) -> None:
        """Add the scores of all shapes with this denominator; coefficients are of all its terms but the last."""
        sets = [subset for subset in self._by_size if subset.shape[1] + len(below) - 1 <= self.at_most + 1]
        if not sets:
            return
        order, ordered = np.argsort(below), tuple(sorted(below))
        ratio = self.offered.ratio((), ordered, self.problem.models[0].terms.variables)
        bank = log_grid(settings.PER_DECADE[1])
        tried = bank if ratio.degree % 2 == 0 else np.concatenate([bank, -bank])
        sizes = [np.sqrt(np.mean(side.below**2, axis=0)) for side in self.sides]
        banks = list[Floats]()
        for side, coefficient, size in zip(self.sides, coefficients, sizes, strict=True):
            here = np.sqrt(np.mean((side.below[:, below[:-1]] @ coefficient) ** 2))
            new = tried * here / (size[below[-1]] or 1.0)  # An input may be zero in all trials of an object
            banks.append(np.column_stack([np.tile(coefficient, (len(new), 1)), new])[:, order])
        squares_by_side = in_parallel(lambda side, bank: side.left(ordered, bank, sets), self.sides, banks)
        places = [np.argmin(of_side, axis=0) for of_side in squares_by_side]
        squares = np.sum([np.min(of_side, axis=0) for of_side in squares_by_side], axis=0)
        count, reduced = len(self.offered.above), self.offered.is_reduced((), ordered)  # So is any ratio then
        for k, terms in enumerate(chain.from_iterable(subset.tolist() for subset in sets)):
            shape = _Shape(tuple(k for k in terms if k < count), ordered, tuple(k - count for k in terms if k >= count))
            better = shape not in found or squares[k] < found[shape].squares
            counts = shape.numbers <= settings.MAX_NUMBERS and np.isfinite(squares[k])
            if better and counts and (reduced or self.offered.is_reduced(shape.above, ordered)):
                best = np.array([bank[place[k]] for bank, place in zip(banks, places, strict=True)])
                found[shape] = _Score(float(squares[k]), best)

    def _terms(self, shape: _Shape) -> list[int]:
        """Return the column indices of the numerator and added terms."""
        return [*shape.above, *(len(self.offered.above) + k for k in shape.added)]

    @cached_property
    def _by_size(self) -> list[Indices]:
        """The sets of numerator and added terms, shape (sets, size) for each size."""
        plain, count = self.problem.models[0].terms.terms, len(self.offered.above)
        free = self.problem.allowed[self.equation]
        added = [count + k for k, term in enumerate(self.offered.added) if term in plain and free[plain.index(term)]]
        result, total = list[Indices](), 0
        for size in range(1, settings.MAX_SUM_TERMS[1] + settings.MAX_SUM_TERMS[3] + 1):
            of_size = [
                (*above, *others)
                for many in range(max(1, size - settings.MAX_SUM_TERMS[3]), min(size, settings.MAX_SUM_TERMS[1]) + 1)
                for above in combinations(range(count), many)
                for others in combinations(added, size - many)
            ]
            total += len(of_size)
            if not of_size or (size > 1 and total > settings.MAX_SETS[2]):
                break
            result.append(np.array(of_size))
        return result

    @property
    def _criterion(self) -> InformationCriterion:
        return InformationCriterion(sum(len(side.target) for side in self.sides), len(self.sides))

    def _optimized(self, shape: _Shape, score: _Score) -> _Score:
        """Return the score at denominator coefficients optimized for each object, starting from given ones."""
        terms = self._terms(shape)
        below = [
            side.closest(shape.below, coefficients, terms)
            for side, coefficients in zip(self.sides, score.below, strict=True)
        ]
        pairs = zip(self.sides, below, strict=True)
        residuals = [side.fitted(shape.below, coefficients, terms)[1] for side, coefficients in pairs]
        return _Score(sum(float(residual @ residual) for residual in residuals), np.array(below))

    def _with_starts(self, shape: _Shape, score: _Score) -> CandidateSupport | None:
        """Return a shape with starting values: those of each object, and with the median denominator."""
        variables, terms = self.problem.models[0].terms.variables, self._terms(shape)
        norms = [np.sqrt(np.mean(side.below[:, shape.below] ** 2, axis=0)) for side in self.sides]
        sizes = np.median(np.abs(score.below) * norms, axis=0)
        ratio = self.offered.ratio(shape.above, shape.below, variables, sizes)
        plain = self.problem.models[0].terms.terms
        scaled = score.below / score.below[:, [ratio.reference]]
        objects, starts = len(self.problem.models), list[Floats]()
        for below in (scaled, np.tile(np.median(scaled, axis=0), (len(scaled), 1)))[: len(scaled)]:
            parameters = [values for row in below if (values := ratio.values_of_parameters(row)) is not None]
            if len(parameters) < len(below):
                continue
            fits = [
                side.fitted(shape.below, coefficients, terms)[0]
                for side, coefficients in zip(self.sides, below, strict=True)
            ]
            ordered = np.roll(np.array(fits), len(shape.added), axis=1)
            starts.append(expand_to_objects(np.column_stack([ordered, parameters]), objects))
        added = tuple(plain.index(self.offered.added[k]) for k in shape.added)
        return CandidateSupport(added, (ratio,), tuple(starts)) if starts else None
