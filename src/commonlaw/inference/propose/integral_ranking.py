"""Ranking of candidate supports of one equation by their residual sums of squares in integral form.

All sums of a few plain terms with up to two parametric terms are compared. Terms are integrated along estimated states,
which have errors, so sums of squares rank only supports with equally many parameters; the best of each size are then
fitted to the trajectories.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from itertools import combinations, groupby
from typing import TypeVar

import numpy as np

from commonlaw.array_types import Floats, Indices, evenly_spaced
from commonlaw.inference import settings
from commonlaw.inference.fit.integral_form import CurveData, IntegralRegression, rss_reductions
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.library import ParametricTerm, Ratio
from commonlaw.likelihood import Estimate
from commonlaw.runtime.checkpoint import at_checkpoint
from commonlaw.runtime.parallel import in_parallel

_T = TypeVar("_T")


@dataclass(frozen=True)
class CandidateSupport:
    """A few terms of one equation: plain ones, by their index, and others: parametric terms, or a ratio of sums.

    Terms that share their parameters count as one of the others. Starting values, which do not enter comparisons, have
    the coefficients of each object, those of plain terms first, and then the parameters of the others, shape (objects,
    numbers).
    """

    plain: tuple[int, ...]
    others: tuple[ParametricTerm | Ratio, ...] = ()
    starts: tuple[Floats, ...] = field(default=(), compare=False)

    @property
    def numbers(self) -> int:
        """The number of coefficients and parameters of each object."""
        return len(self.plain) + sum(term.size + len(term.shared_parameters) for term in self.others)

    def columns_of(self, k: int) -> list[int]:
        """Return the columns of starting values that belong to the k-th term, plain ones first."""
        if k < len(self.plain):
            return [k]
        sizes = [len(self.plain), *(term.size for term in self.others)]
        sizes += [len(term.shared_parameters) for term in self.others]
        ends, m = np.cumsum(sizes).tolist(), k - len(self.plain)
        parameters = m + len(self.others)
        return [*range(ends[m], ends[m + 1]), *range(ends[parameters], ends[parameters + 1])]

    def without(self, k: int) -> "CandidateSupport":
        """Return the support without its k-th term, plain ones first."""
        starts = tuple(np.delete(start, self.columns_of(k), axis=1) for start in self.starts)
        plain = tuple(term for i, term in enumerate(self.plain) if i != k)
        others = tuple(candidate for i, candidate in enumerate(self.others, start=len(self.plain)) if i != k)
        return CandidateSupport(plain, others, starts)


def rank_supports(
    problem: SearchProblem,
    estimates: Sequence[Estimate],
    others: Sequence[ParametricTerm],
    most: Mapping[int, int],
) -> dict[int, list[CandidateSupport]]:
    """Return candidate supports of each equation, ranked by BIC.

    Terms are integrated along estimated states; `others` are parametric, or not combined with many plain ones. `most`
    is the largest number of coefficients and parameters by equation.
    """
    courses = cache(lambda: object_curves(problem, estimates, others))

    def ranked(equation: int, numbers: int) -> list[CandidateSupport]:
        matches = [match for course in courses() if len((match := course.regression(equation)).target)]
        plain = np.flatnonzero(problem.allowed[equation]).tolist()
        return _Ranking(matches, plain, others, numbers).best(len(problem.models)) if matches else []

    key = rank_supports.__qualname__, problem, estimates, others
    return {
        equation: at_checkpoint(partial(ranked, equation, numbers), *key, equation, numbers)
        for equation, numbers in most.items()
    }


def object_curves(
    problem: SearchProblem, estimates: Sequence[Estimate], others: Sequence[ParametricTerm]
) -> list[CurveData]:
    """Return terms along the estimated states of the objects that are compared."""
    indices = evenly_spaced(len(problem.models), settings.MAX_OBJECTS)
    return in_parallel(lambda o: CurveData.of(problem, o, estimates[o], others), indices)


def expand_to_objects(found: Floats, objects: int) -> Floats:
    """Return values for all objects from those of the compared ones; the others have the median."""
    where, every = evenly_spaced(objects, settings.MAX_OBJECTS), np.tile(np.median(found, axis=0), (objects, 1))
    if len(found) == len(where):
        every[where] = found
    return every


@dataclass(frozen=True)
class InformationCriterion:
    """The BIC n log(RSS) + k m log(n) of n measurements of m objects with k parameters each."""

    measurements: int
    objects: int

    def __call__(self, numbers: int, squares: float) -> float:
        """Return the criterion for so many parameters of each object and a residual sum of squares."""
        deviance = self.measurements * np.log(max(squares, np.finfo(float).tiny))
        return float(deviance + numbers * self.objects * np.log(self.measurements))

    def enough(self, least: Mapping[int, float]) -> int:
        """Return the number of parameters of least criterion, from the least sum of squares of each; zero if none."""
        return min(least, key=lambda numbers: self(numbers, least[numbers]), default=0)

    def kept(self, ranked: Sequence[tuple[int, Sequence[tuple[float, _T]]]], at_most: int) -> list[tuple[float, _T]]:
        """Return the best supports of each size with their criterion, up to one parameter more than the optimum.

        Each list has sums of squares and supports of one size, the least first. Those above `MAX_SQUARES_RATIO` times
        the least are dropped, except for the first of each list.
        """
        least: dict[int, float] = {}
        for numbers, listed in ranked:
            least[numbers] = min(listed[0][0], least.get(numbers, np.inf))
        enough = self.enough(least)
        return [
            (self(numbers, squares), support)
            for numbers, listed in ranked
            for place, (squares, support) in enumerate(listed[: settings.MAX_KEPT])
            if numbers <= min(enough + 1, at_most)
            and (not place or squares <= settings.MAX_SQUARES_RATIO * least[enough])
        ]


_Key = tuple[tuple[int, ...], tuple[int, ...]]
"""Indices of plain terms, and of others."""


@dataclass(frozen=True, eq=False)
class _SumsOfSquares:
    """Residual sums of squares, shape (sets,), of sets of equally many plain terms with the same others."""

    sets: Sequence[tuple[int, ...]]
    others: tuple[int, ...]
    squares: Floats

    @property
    def best(self) -> tuple[float, _Key]:
        place = int(np.argmin(self.squares))
        return float(self.squares[place]), (self.sets[place], self.others)


@dataclass(frozen=True, eq=False)
class _Ranking:
    """Ranking of the supports of an equation by their residual sums of squares over all objects.

    Plain terms, by their index, are those whose coefficients are estimated; supports have `at_most` so many parameters.
    """

    matches: Sequence[IntegralRegression]
    plain: Sequence[int]
    others: Sequence[ParametricTerm]
    at_most: int

    def best(self, objects: int) -> list[CandidateSupport]:
        """Return the best supports of each size up to one parameter more than the optimum of the BIC."""
        repeated = np.all([match.grids.redundant for match in self.matches], axis=0)
        repeated |= np.any([[match.is_collinear(a) for a in range(len(self.others))] for match in self.matches], axis=0)
        alone, columns = [(a,) for a in np.flatnonzero(~repeated).tolist()], [match.plain for match in self.matches]
        compared = self._compared(columns, _subsets(self.plain, settings.MAX_SETS[0]), (), [(), *alone])
        compared += self._with_two(compared)
        groups, least = dict[tuple[int, int, int], list[_SumsOfSquares]](), dict[int, float]()
        for sums in compared:
            squares, key = sums.best
            if numbers := self._numbers(key):
                nonlinear = sum(len(self.others[a].shared_parameters) for a in sums.others)
                groups.setdefault((numbers, len(sums.others), nonlinear), []).append(sums)
                least[numbers] = min(squares, least.get(numbers, np.inf))
        most, parameters = self._criterion.enough(least), dict[_Key, list[tuple[Floats, ...]]]()
        ranked = list[tuple[int, list[tuple[float, _Key]]]]()
        for (numbers, *_), listed in sorted(groups.items(), key=lambda pair: pair[0]):
            if numbers <= most + 1:
                closest = self._closest(self._distinct(listed))
                fits = {key: self._fitted(key, optimum) for key, optimum in closest.items()}
                parameters |= closest
                ranked.append((numbers, sorted((sum(float(r @ r) for _, r in fits[key]), key) for key in fits)))
        kept = sorted(self._criterion.kept(ranked, self.at_most))
        return [self._with_starts(key, parameters[key], objects) for _, key in kept]

    def _with_two(self, compared: Sequence[_SumsOfSquares]) -> list[_SumsOfSquares]:
        """Return sums of squares with two of the others: one from the best supports with one, and another one."""
        best: dict[tuple[int, ...], tuple[float, _Key]] = {}
        for sums in compared:
            squares, key = sums.best
            value = self._criterion(self._numbers(key), squares), key
            best[sums.others] = min(value, best.get(sums.others, value))
        best.pop((), None)
        result, sets = list[_SumsOfSquares](), _subsets(self.plain, settings.MAX_SETS[1])
        for _, (plain, others) in sorted(best.values())[: settings.MAX_KEPT]:
            columns = [
                np.column_stack([match.plain, match.columns_at(others, match.grid_search(plain, others))])
                for match in self.matches
            ]
            result += self._compared(columns, sets, others, [chosen for chosen in best if chosen != others])
        return result

    def _compared(
        self,
        columns: Sequence[Floats],
        sets: Sequence[tuple[int, ...]],
        added: tuple[int, ...],
        more: Sequence[tuple[int, ...]],
    ) -> list[_SumsOfSquares]:
        """Return sums of squares of sets with the others `added`, whose columns come last, and one more or none."""
        result = list[_SumsOfSquares]()
        last = range(columns[0].shape[1] - len(added), columns[0].shape[1])
        for size, group in groupby(sets, len):
            listed = list(group)
            few = [extra for extra in more if size + self._numbers(((), (*added, *extra))) <= self.at_most]
            if few:
                indices = np.array([(*plain, *last) for plain in listed], dtype=int)
                sums = partial(_residual_squares, indices, [a for extra in few for a in extra])
                squares = np.sum(in_parallel(sums, self.matches, columns), axis=0)
                for extra, sums_of_squares in zip(few, squares.T if () in few else squares.T[1:], strict=True):
                    result.append(_SumsOfSquares(listed, tuple(sorted((*added, *extra))), sums_of_squares))
        return result

    def _numbers(self, key: _Key) -> int:
        return len(key[0]) + sum(self.others[a].size + len(self.others[a].shared_parameters) for a in key[1])

    @property
    def _criterion(self) -> InformationCriterion:
        return InformationCriterion(sum(len(match.target) for match in self.matches), len(self.matches))

    def _distinct(self, listed: Sequence[_SumsOfSquares]) -> list[_Key]:
        """Return supports of least squares, few with the same parametric terms and none with equal sums of squares."""
        result, before, alike = dict[_Key, None](), 0.0, Counter[tuple[int, ...]]()
        squares = np.concatenate([sums.squares for sums in listed])
        keys = [(sums, place) for sums in listed for place in range(len(sums.sets))]
        for k in np.argsort(squares, kind="stable").tolist():
            sums, place = keys[k]
            key = sums.sets[place], sums.others
            inside = tuple(a for a in sums.others if self.others[a].parameters)
            few = alike[inside] < (settings.MAX_KEPT if inside else settings.MAX_REFINED)
            if few and key not in result and squares[k] > before * (1 + settings.COLLINEAR):
                result[key] = None
                alike[inside] += 1
            before = squares[k]
            if len(result) == settings.MAX_LINEARIZED:
                break
        return [*result]

    def _closest(self, keys: Sequence[_Key]) -> dict[_Key, list[tuple[Floats, ...]]]:
        """Return locally optimal parameters of each object, for the supports that are best to first order."""

        def nearby(match: IntegralRegression) -> list[tuple[float, tuple[int, ...]]]:
            values = [match.grid_search(*key) for key in keys]
            return [(match.linearized_rss(*key, value), value) for key, value in zip(keys, values, strict=True)]

        def done(match: IntegralRegression) -> list[tuple[float, tuple[int, ...]]]:
            return at_checkpoint(lambda: nearby(match), nearby.__qualname__, match, keys)

        of_keys = list(zip(*in_parallel(done, self.matches), strict=True))
        squares = [sum(rss for rss, _ in of_key) for of_key in of_keys]
        result = dict[_Key, list[tuple[Floats, ...]]]()
        for k in np.argsort(squares, kind="stable")[: settings.MAX_REFINED]:
            plain, others = keys[k]
            pairs = zip(self.matches, of_keys[k], strict=True)
            result[keys[k]] = [match.refined(plain, others, indices) for match, (_, indices) in pairs]
        return result

    def _fitted(self, key: _Key, parameters: Sequence[Sequence[Floats]]) -> list[tuple[Floats, Floats]]:
        """Return the coefficients and residuals of a support in each object, at given parameters."""
        parts = [part for a in key[1] for part in self.others[a].parts]
        shared = [
            [self._shared(a, numbers) for a, numbers in zip(key[1], parameter, strict=True)] for parameter in parameters
        ]
        inside = [
            [numbers for a, numbers in zip(key[1], by_term, strict=True) for _ in self.others[a].parts]
            for by_term in shared
        ]
        return [match.fitted(key[0], parts, numbers) for match, numbers in zip(self.matches, inside, strict=True)]

    def _shared(self, a: int, parameters: Floats) -> Floats:
        term = self.others[a]
        return parameters[[term.parameters.index(name) for name in term.shared_parameters]]

    def _with_starts(self, key: _Key, alone: Sequence[tuple[Floats, ...]], objects: int) -> CandidateSupport:
        """Return a support with starting values: the parameters of each object, and their medians."""
        typical = tuple(np.median(numbers, axis=0) for numbers in zip(*alone, strict=True))
        starts = []
        for parameters in (alone, [typical] * len(alone)) if any(map(len, typical)) and len(alone) > 1 else (alone,):
            fits = [coefficients for coefficients, _ in self._fitted(key, parameters)]
            of_each = zip(key[1], zip(*parameters, strict=True), strict=True)
            inside = (np.array([self._shared(a, numbers) for numbers in every]) for a, every in of_each)
            starts.append(expand_to_objects(np.column_stack([fits, *inside]), objects))
        return CandidateSupport(key[0], tuple(self.others[a] for a in key[1]), tuple(starts))


def _residual_squares(sets: Indices, chosen: Sequence[int], match: IntegralRegression, columns: Floats) -> Floats:
    """Return sums of squares of sets of one size, alone and with each chosen other, shape (sets, 1 + chosen)."""
    gram, inner = columns.T @ columns, columns.T @ match.target
    subgrams = gram[sets[:, :, np.newaxis], sets[:, np.newaxis, :]] + settings.COLLINEAR * np.eye(sets.shape[1])
    whiten = np.linalg.inv(np.linalg.cholesky(subgrams))
    known = np.matmul(whiten, inner[sets][..., np.newaxis])
    alone = match.target @ match.target - np.sum(known[..., 0] ** 2, axis=1)
    ranges = [np.arange(*match.grids.offsets[a : a + 2]) for a in chosen]
    which, counts = np.concatenate([np.empty(0, dtype=np.intp), *ranges]), np.array([*map(len, ranges)], dtype=np.intp)
    others, squares, filled = match.others[:, which], match.squares[which], np.flatnonzero(counts)
    crossed, every, firsts = columns.T @ others, match.target @ others, np.cumsum([0, *counts[filled]])[:-1]
    gained = np.zeros((len(sets), len(chosen)))
    for part in np.array_split(np.arange(len(sets)), -(-len(sets) // 50)) if filled.size else ():
        inside = np.matmul(whiten[part], crossed[sets[part]])
        residual_inner = every - np.sum(known[part] * inside, axis=1)
        reductions = rss_reductions(residual_inner, squares - np.sum(inside**2, axis=1))
        gained[np.ix_(part, filled)] = np.maximum.reduceat(reductions, firsts, axis=1)
    return np.asarray(np.maximum(np.column_stack([alone, alone[:, np.newaxis] - gained]), np.finfo(float).tiny))


def _subsets(plain: Sequence[int], most: int) -> list[tuple[int, ...]]:
    """Return all sets of some terms, smaller ones first, up to the size at which there are too many."""
    result: list[tuple[int, ...]] = []
    for size in range(settings.MAX_SUM_TERMS[0] + 1):
        of_size = list(combinations(plain, size))
        if size > 1 and len(result) + len(of_size) > most:
            break
        result += of_size
    return result
