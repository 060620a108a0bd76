"""Small sets of terms, of many, that fit an equation best: ranked by sums of squares of integrals.

All are compared: sums of a few plain terms, with one or two others that have parameters inside. As the states along
which terms are integrated are not the true ones, sums of squares rank sets of as many numbers among themselves;
trajectories have to judge the best of each size.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations, groupby
from typing import TypeVar

import numpy as np

from commonlaw.array_types import Floats, Indices, evenly_spaced
from commonlaw.inference import settings
from commonlaw.inference.fit.integral_form import CurveData, IntegralRegression, gains
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.library import ParametricTerm, Ratio
from commonlaw.likelihood import Estimate
from commonlaw.runtime.parallel import in_parallel

_T = TypeVar("_T")


@dataclass(frozen=True)
class Start:
    """What a fit begins with: coefficients of each object, shape (objects, terms), plain ones first, and parameters.

    The terms of others come after these, in their order. Parameters of each of them have the shape (objects,
    parameters).
    """

    coefficients: Floats
    parameters: tuple[Floats, ...] = ()


@dataclass(frozen=True)
class CandidateSupport:
    """A few terms of one equation: plain ones, by their index, and others, with parameters inside, or a ratio of sums.

    Terms that share their parameters are one of the others.

    Equal sets have equal terms, whatever fits begin with.
    """

    plain: tuple[int, ...]
    others: tuple[ParametricTerm | Ratio, ...] = ()
    starts: tuple[Start, ...] = field(default=(), compare=False)

    @property
    def numbers(self) -> int:
        """How many numbers each object has in it."""
        return len(self.plain) + sum(each.size + len(each.shared_parameters) for each in self.others)

    def places_of(self, k: int) -> range:
        """Return where the coefficients of a term stand, by its place among the plain ones and the others."""
        if k < len(self.plain):
            return range(k, k + 1)
        before, own = self.others[: k - len(self.plain)], self.others[k - len(self.plain)]
        first = len(self.plain) + sum(each.size for each in before)
        return range(first, first + own.size)

    def without(self, k: int) -> "CandidateSupport":
        """Return the set without one of its terms, by its place among the plain ones and the others."""
        places, m = self.places_of(k), k - len(self.plain)
        kept = [i for i in range(len(self.others)) if i != m]
        starts = tuple(
            Start(np.delete(each.coefficients, places, axis=1), tuple(each.parameters[i] for i in kept))
            for each in self.starts
        )
        plain = tuple(own for i, own in enumerate(self.plain) if i != k)
        return CandidateSupport(plain, tuple(self.others[i] for i in kept), starts)


def matching_sets(
    problem: SearchProblem,
    estimates: Sequence[Estimate],
    others: Sequence[ParametricTerm],
    most: Mapping[int, int],
    hopeless: float = settings.MAX_SQUARES_RATIO,
) -> dict[int, list[CandidateSupport]]:
    """Return sets of terms that fit best for how many numbers they have, the most promising first, by equation.

    Estimates are states near the true ones. The others have parameters inside, or are not taken together with many
    plain ones. Sets have at `most` so many numbers, by equation; those that leave so many times the least sum of
    squares are `hopeless` and not kept, but for the best of each size.
    """
    courses, found = courses_of(problem, estimates, others), dict[int, list[CandidateSupport]]()
    for equation, numbers in most.items():
        matches = [match for each in courses if len((match := each.match(equation)).target)]
        plain = np.flatnonzero(problem.allowed[equation]).tolist()
        ranked = _Ranked(matches, plain, others, numbers, hopeless)
        found[equation] = ranked.best(len(problem.models)) if matches else []
    return found


def courses_of(
    problem: SearchProblem, estimates: Sequence[Estimate], others: Sequence[ParametricTerm]
) -> list[CurveData]:
    """Return the curves, along their estimated states, of the objects whose measurements are matched."""
    indices = evenly_spaced(len(problem.models), settings.MAX_OBJECTS)
    return in_parallel(lambda o: CurveData.of(problem, o, estimates[o], others), indices)


def for_all(found: Floats, objects: int) -> Floats:
    """Return values for all objects from those of the objects that were matched: typical ones for the others."""
    where, every = evenly_spaced(objects, settings.MAX_OBJECTS), np.tile(np.median(found, axis=0), (objects, 1))
    if len(found) == len(where):
        every[where] = found
    return every


@dataclass(frozen=True)
class InformationCriterion:
    """The BIC of terms that leave sums of squares of so many measurements on so many objects."""

    measurements: int
    objects: int

    def __call__(self, numbers: int, squares: float) -> float:
        """Return the criterion of terms with so many numbers for each object."""
        deviance = self.measurements * np.log(max(squares, np.finfo(float).tiny))
        return float(deviance + numbers * self.objects * np.log(self.measurements))

    def enough(self, least: Mapping[int, float]) -> int:
        """Return how many numbers have the least criterion, by the least squares for each; zero if there are none."""
        return min(least, key=lambda numbers: self(numbers, least[numbers]), default=0)

    def kept(
        self, ranked: Sequence[tuple[int, Sequence[tuple[float, _T]]]], at_most: int, hopeless: float
    ) -> list[tuple[float, _T]]:
        """Return the best of each list of as many numbers, with their criterion, as far as more numbers pay.

        Lists have sums of squares, the least first. Those that leave so many times the least are hopeless, but for the
        first of each list.
        """
        least: dict[int, float] = {}
        for numbers, listed in ranked:
            least[numbers] = min(listed[0][0], least.get(numbers, np.inf))
        enough = self.enough(least)
        return [
            (self(numbers, squares), each)
            for numbers, listed in ranked
            for place, (squares, each) in enumerate(listed[: settings.MAX_KEPT])
            if numbers <= min(enough + 1, at_most) and (not place or squares <= hopeless * least[enough])
        ]


_Key = tuple[tuple[int, ...], tuple[int, ...]]
"""Indices of plain terms, and of others."""


@dataclass(frozen=True, eq=False)
class _Compared:
    """The sums of squares that sets of as many plain terms leave, shape (sets,), all with the same others."""

    sets: Sequence[tuple[int, ...]]
    others: tuple[int, ...]
    squares: Floats

    @property
    def best(self) -> tuple[float, _Key]:
        """The set that leaves least, and what it leaves."""
        place = int(np.argmin(self.squares))
        return float(self.squares[place]), (self.sets[place], self.others)


@dataclass(frozen=True, eq=False)
class _Ranked:
    """Sets of terms of an equation by what they leave of the measurements of all objects.

    Plain terms are those, by their index, whose coefficients are not known. Sets have so many numbers at most.
    """

    matches: Sequence[IntegralRegression]
    plain: Sequence[int]
    others: Sequence[ParametricTerm]
    at_most: int
    hopeless: float

    def best(self, objects: int) -> list[CandidateSupport]:
        """Return the best sets of each size, as far as more numbers pay for themselves, for so many objects."""
        compared = self._of_one()
        compared += self._of_two(compared)
        groups, least = dict[tuple[int, int], list[_Compared]](), dict[int, float]()
        for each in compared:
            squares, key = each.best
            if numbers := self._numbers(key):
                groups.setdefault((numbers, len(each.others)), []).append(each)
                least[numbers] = min(squares, least.get(numbers, np.inf))
        most, parameters = self._criterion.enough(least), dict[_Key, list[tuple[Floats, ...]]]()
        ranked = list[tuple[int, list[tuple[float, _Key]]]]()
        for (numbers, _), listed in sorted(groups.items(), key=lambda pair: pair[0]):
            if numbers <= most + 1:
                closest = self._closest(self._different(listed))
                fits = {key: self._fitted(key, each) for key, each in closest.items()}
                parameters |= closest
                ranked.append((numbers, sorted((sum(float(r @ r) for _, r in fits[key]), key) for key in fits)))
        kept = sorted(self._criterion.kept(ranked, self.at_most, self.hopeless))
        return [self._with_starts(key, parameters[key], objects) for _, key in kept]

    def _of_one(self) -> list[_Compared]:
        """Return what plain terms leave, with at most one of the others."""
        columns = [match.plain for match in self.matches]
        repeated = np.all([match.banks.repeated for match in self.matches], axis=0)
        repeated |= np.any([[match.repeats(a) for a in range(len(self.others))] for match in self.matches], axis=0)
        new = [(a,) for a in np.flatnonzero(~repeated).tolist()]
        return self._compared(columns, _subsets(self.plain, settings.MAX_SETS[0]), (), [(), *new])

    def _of_two(self, compared: Sequence[_Compared]) -> list[_Compared]:
        """Return the same with two of the others, one of them from the best sets with one, each with another one."""
        best: dict[tuple[int, ...], tuple[float, _Key]] = {}
        for each in compared:
            squares, key = each.best
            value = self._criterion(self._numbers(key), squares), key
            best[each.others] = min(value, best.get(each.others, value))
        best.pop((), None)
        found, sets = list[_Compared](), _subsets(self.plain, settings.MAX_SETS[1])
        for _, (plain, others) in sorted(best.values())[: settings.MAX_KEPT]:
            columns = [
                np.column_stack([match.plain, match.columns_at(others, match.best_values(plain, others))])
                for match in self.matches
            ]
            found += self._compared(columns, sets, others, [each for each in best if each != others])
        return found

    def _compared(
        self,
        columns: Sequence[Floats],
        sets: Sequence[tuple[int, ...]],
        added: tuple[int, ...],
        more: Sequence[tuple[int, ...]],
    ) -> list[_Compared]:
        """Return what sets leave with the others `added`, whose columns are the last ones, and one more or none."""
        found = list[_Compared]()
        last = range(columns[0].shape[1] - len(added), columns[0].shape[1])
        for size, group in groupby(sets, len):
            listed = list(group)
            few = [each for each in more if size + self._numbers(((), (*added, *each))) <= self.at_most]
            if few:
                indices = np.array([(*each, *last) for each in listed], dtype=int)
                sums = partial(_left_by_one, indices, [a for each in few for a in each])
                squares = np.sum(in_parallel(sums, self.matches, columns), axis=0)
                for each, own in zip(few, squares.T if () in few else squares.T[1:], strict=True):
                    found.append(_Compared(listed, tuple(sorted((*added, *each))), own))
        return found

    def _numbers(self, key: _Key) -> int:
        return len(key[0]) + sum(self.others[a].size + len(self.others[a].shared_parameters) for a in key[1])

    @property
    def _criterion(self) -> InformationCriterion:
        return InformationCriterion(sum(len(each.target) for each in self.matches), len(self.matches))

    def _different(self, listed: Sequence[_Compared]) -> list[_Key]:
        """Return the sets that leave least, few with the same parametric terms, and none that leaves the same."""
        found, before, alike = dict[_Key, None](), 0.0, Counter[tuple[int, ...]]()
        squares = np.concatenate([each.squares for each in listed])
        keys = [(each, place) for each in listed for place in range(len(each.sets))]
        for k in np.argsort(squares, kind="stable").tolist():
            each, place = keys[k]
            key = each.sets[place], each.others
            inside = tuple(a for a in each.others if self.others[a].parameters)
            few = alike[inside] < (settings.MAX_KEPT if inside else settings.MAX_REFINED)
            if few and key not in found and squares[k] > before * (1 + settings.COLLINEAR):
                found[key] = None
                alike[inside] += 1
            before = squares[k]
            if len(found) == settings.MAX_LINEARIZED:
                break
        return [*found]

    def _closest(self, keys: Sequence[_Key]) -> dict[_Key, list[tuple[Floats, ...]]]:
        """Return the best parameters of each object, between those of the banks, of the sets best to first order."""

        def nearby(match: IntegralRegression) -> list[tuple[float, tuple[int, ...]]]:
            values = [match.best_values(*key) for key in keys]
            return [(match.left_nearby(*key, each), each) for key, each in zip(keys, values, strict=True)]

        of_keys = list(zip(*in_parallel(nearby, self.matches), strict=True))
        squares = [sum(left for left, _ in each) for each in of_keys]
        found = dict[_Key, list[tuple[Floats, ...]]]()
        for k in np.argsort(squares, kind="stable")[: settings.MAX_REFINED]:
            plain, others = keys[k]
            pairs = zip(self.matches, of_keys[k], strict=True)
            found[keys[k]] = [match.closest(plain, others, indices) for match, (_, indices) in pairs]
        return found

    def _fitted(self, key: _Key, parameters: Sequence[Sequence[Floats]]) -> list[tuple[Floats, Floats]]:
        """Return the coefficients of a set in each object, with parameters of its others there, and what is left."""
        parts = [part for a in key[1] for part in self.others[a].parts]
        shared = [[self._shared(a, own) for a, own in zip(key[1], each, strict=True)] for each in parameters]
        inside = [[own for a, own in zip(key[1], each, strict=True) for _ in self.others[a].parts] for each in shared]
        return [match.fitted(key[0], parts, own) for match, own in zip(self.matches, inside, strict=True)]

    def _shared(self, a: int, parameters: Floats) -> Floats:
        """Return the parameters that a law has of all that one of the others is compared with."""
        other = self.others[a]
        return parameters[[other.parameters.index(name) for name in other.shared_parameters]]

    def _with_starts(self, key: _Key, alone: Sequence[tuple[Floats, ...]], objects: int) -> CandidateSupport:
        """Return a set with what fits begin with: parameters of each object, which may be far off, and typical ones."""
        typical = tuple(np.median(own, axis=0) for own in zip(*alone, strict=True))
        starts = []
        for parameters in (alone, [typical] * len(alone)) if any(map(len, typical)) and len(alone) > 1 else (alone,):
            fits = [coefficients for coefficients, _ in self._fitted(key, parameters)]
            of_each = zip(key[1], zip(*parameters, strict=True), strict=True)
            several = [np.array(fits), *(np.array([self._shared(a, own) for own in every]) for a, every in of_each)]
            first, *others = (for_all(each, objects) for each in several)
            starts.append(Start(first, tuple(others)))
        return CandidateSupport(key[0], tuple(self.others[a] for a in key[1]), tuple(starts))


def _left_by_one(sets: Indices, chosen: Sequence[int], match: IntegralRegression, columns: Floats) -> Floats:
    """Return squares that sets of one size leave, alone and with each chosen other, shape (sets, 1 + chosen)."""
    gram, inner = columns.T @ columns, columns.T @ match.target
    own = gram[sets[:, :, np.newaxis], sets[:, np.newaxis, :]] + settings.COLLINEAR * np.eye(sets.shape[1])
    whiten = np.linalg.inv(np.linalg.cholesky(own))
    known = np.matmul(whiten, inner[sets][..., np.newaxis])
    alone = match.target @ match.target - np.sum(known[..., 0] ** 2, axis=1)
    which, counts = match.places_of(chosen)
    others, squares, filled = match.others[:, which], match.squares[which], np.flatnonzero(counts)
    crossed, every, firsts = columns.T @ others, match.target @ others, np.cumsum([0, *counts[filled]])[:-1]
    gained = np.zeros((len(sets), len(chosen)))
    for part in np.array_split(np.arange(len(sets)), -(-len(sets) // 50)) if filled.size else ():
        inside = np.matmul(whiten[part], crossed[sets[part]])
        left = every - np.sum(known[part] * inside, axis=1)
        each = gains(left, squares - np.sum(inside**2, axis=1))
        gained[np.ix_(part, filled)] = np.maximum.reduceat(each, firsts, axis=1)
    return np.asarray(np.maximum(np.column_stack([alone, alone[:, np.newaxis] - gained]), np.finfo(float).tiny))


def _subsets(plain: Sequence[int], most: int) -> list[tuple[int, ...]]:
    """Return the sets of some terms, smaller ones first, of sizes of which not too many are compared."""
    found: list[tuple[int, ...]] = []
    for size in range(settings.MAX_SUM_TERMS[0] + 1):
        of_size = list(combinations(plain, size))
        if size > 1 and len(found) + len(of_size) > most:
            break
        found += of_size
    return found
