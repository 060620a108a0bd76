"""Small sets of terms, of many, that fit an equation best: ranked by sums of squares of integrals.

All are compared: sums of a few plain terms, with one or two others that have constants inside. As the states along
which terms are integrated are not the true ones, sums of squares rank sets of as many numbers among themselves;
trajectories have to judge the best of each size.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, groupby

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.inference.integral_matching import INSIDE, Course, Match, gains
from commonlaw.inference.search_problem import SearchProblem
from commonlaw.library import ParametricTerm, Ratio
from commonlaw.likelihood import Estimate
from commonlaw.parallel import in_parallel
from commonlaw.spacing import evenly_spaced

OBJECTS = 12
"""Objects whose measurements are matched, evenly spread."""

_MOST_PLAIN = 4
"""Plain terms that are taken together at most."""

_MOST_SETS, _MOST_SETS_BESIDE_TWO = 1500, 60
"""Sets of plain terms that are compared at most, smaller ones first, beside one or two others."""

_AT_ONCE = 50
"""Sets that are compared at a time, so that arrays stay small."""

MOST_NUMBERS = 7
"""Coefficients and constants of an equation at most."""

_KEPT = (2, 3, 2)
"""Sets that are kept of those of as many numbers, by how many terms are not plain."""

_NEAR, _ALIKE, _CLOSE = 80, 2, 8
"""Sets, of those of as many numbers, that are compared with constants between those of a bank, to first order; those
among them with the same terms that have constants, as a bank may be nearer to the best constants of one than of
another; and sets whose constants are then found to more digits, before they are ranked."""

_WIDENED = 4
"""Sets with one term that is not plain, each with another one, to which a second is added."""

_HOPELESS = 30.0
"""Sets that leave so many times the least sum of squares are not kept, but for the best of each size."""

_SAME = 1e-9
"""Relative differences of sums of squares that are rounding: such sets say the same."""


@dataclass(frozen=True)
class Start:
    """What a fit begins with: coefficients of each object, shape (objects, terms), plain ones first, and constants.

    The terms of others come after these, in their order. Constants of each of them have the shape (objects, constants).
    """

    coefficients: Floats
    constants: tuple[Floats, ...] = ()


@dataclass(frozen=True)
class TermSet:
    """A few terms of one equation: plain ones, by their index, and others, with constants inside, or a ratio of sums.

    Equal sets have equal terms, whatever fits begin with.
    """

    plain: tuple[int, ...]
    others: tuple[ParametricTerm | Ratio, ...] = ()
    starts: tuple[Start, ...] = field(default=(), compare=False)

    @property
    def numbers(self) -> int:
        """How many numbers each object has in it."""
        return len(self.plain) + sum(each.size + len(each.constants) for each in self.others)

    def without(self, k: int) -> "TermSet":
        """Return the set without one of its plain terms, by its place among these."""
        starts = tuple(replace(each, coefficients=np.delete(each.coefficients, k, axis=1)) for each in self.starts)
        return replace(self, plain=(*self.plain[:k], *self.plain[k + 1 :]), starts=starts)


def matching_sets(
    problem: SearchProblem, estimates: Sequence[Estimate], others: Sequence[ParametricTerm], most: Sequence[int]
) -> list[list[TermSet]]:
    """Return for each equation sets of terms that fit best for how many numbers they have, the most promising first.

    Parameters
    ----------
    problem
        What was measured, and the plain terms.
    estimates
        States near the true ones, of each object.
    others
        Terms with constants inside, or that are not taken together with many plain ones.
    most
        How many numbers the sets of each equation have at most.
    """
    indices = evenly_spaced(len(problem.models), OBJECTS)
    courses = in_parallel(lambda o: Course.of(problem, o, estimates[o], others), indices)
    found = []
    for equation in range(len(problem.noise)):
        matches = [match for each in courses if len((match := each.match(equation)).target)]
        plain = np.flatnonzero(problem.allowed[equation]).tolist()
        found.append(_Ranked(matches, plain, others).best(len(problem.models), most[equation]))
    return found


_Key = tuple[tuple[int, ...], tuple[int, ...]]
"""Indices of plain terms, and of others."""


@dataclass(frozen=True, eq=False)
class _Ranked:
    """Sets of terms of an equation by what they leave of the measurements of all objects.

    Plain terms are those, by their index, whose coefficients are not known.
    """

    matches: Sequence[Match]
    plain: Sequence[int]
    others: Sequence[ParametricTerm]
    values: dict[_Key, list[tuple[int, ...]]] = field(default_factory=dict)
    constants: dict[_Key, list[tuple[Floats, ...]]] = field(default_factory=dict)

    def best(self, objects: int, at_most: int) -> list[TermSet]:
        """Return the best sets of each size, as far as more numbers pay for themselves, for so many objects."""
        if not self.matches:
            return []
        sums = self._of_one()
        sums |= self._of_two(sums)
        groups: dict[tuple[int, int], list[tuple[float, _Key]]] = {}
        for key, squares in sums.items():
            groups.setdefault((self._numbers(key), len(key[1])), []).append((squares, key))
        coarse = [(numbers, min(listed)[0]) for (numbers, _), listed in groups.items() if 0 < numbers <= at_most]
        if not coarse:
            return []
        most, _ = min(coarse, key=lambda pair: self._criterion(*pair))
        ranked = [
            (numbers, many, sorted(self._closely(key) for key in self._nearest(self._different(sorted(listed)))))
            for (numbers, many), listed in sorted(groups.items())
            if 0 < numbers <= min(most + 1, at_most)
        ]
        least = {numbers: np.inf for numbers, _, _ in ranked}
        for numbers, _, listed in ranked:
            least[numbers] = min(least[numbers], listed[0][0])
        enough = min(least, key=lambda n: self._criterion(n, least[n]))
        kept = [
            (self._criterion(numbers, squares), key)
            for numbers, many, listed in ranked
            for place, (squares, key) in enumerate(listed[: _KEPT[many]])
            if numbers <= enough + 1 and (not place or squares <= _HOPELESS * least[enough])
        ]
        return [self._with_starts(key, objects) for _, key in sorted(kept)]

    def _of_one(self) -> dict[_Key, float]:
        """Return the sums of squares that plain terms leave, with at most one of the others."""
        columns = [match.plain for match in self.matches]
        new = [a for a in range(len(self.others)) if not any(match.repeats(a) for match in self.matches)]
        found: dict[_Key, float] = {}
        for plain, row in self._left(columns, _subsets(self.plain, _MOST_SETS)):
            found[plain, ()] = row[0]
            found |= {(plain, (a,)): row[1 + a] for a in new}
        return found

    def _of_two(self, sums: Mapping[_Key, float]) -> dict[_Key, float]:
        """Return the same with two of the others, one of them from the best sets with one, each with another one."""
        best: dict[int, tuple[float, _Key]] = {}
        for key, squares in sums.items():
            if key[1]:
                value = self._criterion(self._numbers(key), squares)
                best[key[1][0]] = min((value, key), best.get(key[1][0], (np.inf, key)))
        found: dict[_Key, float] = {}
        for _, key in sorted(best.values())[:_WIDENED]:
            (a,), columns = key[1], []
            for match in self.matches:
                (value,) = self._values(match, [key])[key]
                columns.append(np.column_stack([match.plain, match.columns_of(a)[:, value]]))
            last = columns[0].shape[1] - 1
            for plain, row in self._left(
                columns, [(*own, last) for own in _subsets(self.plain, _MOST_SETS_BESIDE_TWO)]
            ):
                for b in best.keys() - {a}:
                    wider = plain[:-1], (min(a, b), max(a, b))
                    found[wider] = min(row[1 + b], found.get(wider, np.inf))
        return found

    def _left(
        self, columns: Sequence[Floats], sets: Sequence[tuple[int, ...]]
    ) -> Iterator[tuple[tuple[int, ...], list[float]]]:
        """Yield sets of columns with the sums of squares that they leave, alone and with each of the others."""
        for _, group in groupby(sets, len):
            listed = list(group)
            indices = np.array(listed, dtype=int)
            sums = in_parallel(partial(_left_by_one, indices), self.matches, columns)
            yield from zip(listed, np.sum(sums, axis=0).tolist(), strict=True)

    def _numbers(self, key: _Key) -> int:
        return len(key[0]) + sum(1 + len(self.others[a].constants) for a in key[1])

    def _criterion(self, numbers: int, squares: float) -> float:
        """Return what ranks sets of different size: the BIC."""
        count = sum(len(each.target) for each in self.matches)
        return count * float(np.log(max(squares, 1e-300))) + numbers * len(self.matches) * float(np.log(count))

    def _values(self, match: Match, keys: Sequence[_Key]) -> dict[_Key, tuple[int, ...]]:
        """Return the indices, in their banks, of the best values of the others of some sets, found in turn.

        All sets have as many others.
        """
        found = dict[_Key, tuple[int, ...]]()
        for _, group in groupby(sorted(keys, key=lambda key: len(key[0])), lambda key: len(key[0])):
            own = list(group)
            plain, which = (np.array(each, dtype=int) for each in zip(*own, strict=True))
            chosen, beside = np.zeros_like(which), None
            for place in [*range(which.shape[1])] * which.shape[1]:
                chosen[:, place] = match.best_beside(plain, which[:, place], beside)
                beside = match.banks.firsts[which[:, place]] + chosen[:, place]
            found |= dict(zip(own, map(tuple, chosen.tolist()), strict=True))
        return found

    def _constants(self, key: _Key) -> list[tuple[Floats, ...]]:
        """Return for each object the constants of a set that leave least, from the best in the banks."""
        if key not in self.constants:
            begin = [
                [match.banks.constants[a][i] for a, i in zip(key[1], own, strict=True)]
                for match, own in zip(self.matches, self.values[key], strict=True)
            ]
            pairs = zip(self.matches, begin, strict=True)
            self.constants[key] = [match.closest(*key, each) for match, each in pairs]
        return self.constants[key]

    def _different(self, ordered: Sequence[tuple[float, _Key]]) -> list[_Key]:
        """Return the first sets of a list, but for those that leave the same as the one before: they say the same.

        Few have the same terms with constants, or none.
        """
        found, before, alike = list[_Key](), 0.0, Counter[tuple[int, ...]]()
        for squares, key in ordered:
            inside = tuple(a for a in key[1] if self.others[a].constants)
            if squares > before * (1 + _SAME) and alike[inside] < (_ALIKE if inside else _CLOSE):
                found.append(key)
                alike[inside] += 1
            before = squares
            if len(found) == _NEAR:
                break
        return found

    def _nearest(self, keys: Sequence[_Key]) -> list[_Key]:
        """Return the sets that leave least where constants may be near those of their banks: banks are coarse."""
        best = in_parallel(lambda match: self._values(match, keys), self.matches)
        self.values.update({key: [own[key] for own in best] for key in keys})
        left = [
            sum(match.left_nearby(*key, own) for match, own in zip(self.matches, self.values[key], strict=True))
            for key in keys
        ]
        return [keys[k] for k in np.argsort(left, kind="stable")[:_CLOSE]]

    def _closely(self, key: _Key) -> tuple[float, _Key]:
        """Return a set with what it leaves at the best constants."""
        pairs = zip(self.matches, self._constants(key), strict=True)
        fits = [match.fitted(*key, constants) for match, constants in pairs]
        return sum(float(left @ left) for _, left in fits), key

    def _with_starts(self, key: _Key, objects: int) -> TermSet:
        """Return a set with what fits begin with, for so many objects.

        That is what each object has by itself, and with the constants that are typical: those of an object alone may
        be far off.
        """
        alone = self._constants(key)
        typical = tuple(np.median(own, axis=0) for own in zip(*alone, strict=True))
        starts = []
        for constants in (alone, [typical] * len(alone)) if any(map(len, typical)) and len(alone) > 1 else (alone,):
            fits = [match.fitted(*key, own)[0] for match, own in zip(self.matches, constants, strict=True)]
            several = [np.array(fits), *(np.array(own) for own in zip(*constants, strict=True))]
            first, *others = (for_all(each, objects) for each in several)
            starts.append(Start(first, tuple(others)))
        return TermSet(key[0], tuple(self.others[a] for a in key[1]), tuple(starts))


def _left_by_one(sets: Indices, match: Match, columns: Floats) -> Floats:
    """Return the sums of squares that sets of columns leave, alone and with each of the others at its best.

    Shape (sets, 1 + others), of sets of one size, shape (sets, size).
    """
    gram, inner = columns.T @ columns, columns.T @ match.target
    own = gram[sets[:, :, np.newaxis], sets[:, np.newaxis, :]] + INSIDE * np.eye(sets.shape[1])
    whiten = np.linalg.inv(np.linalg.cholesky(own))
    known = np.matmul(whiten, inner[sets][..., np.newaxis])
    alone = match.target @ match.target - np.sum(known[..., 0] ** 2, axis=1)
    crossed, every = columns.T @ match.others, match.target @ match.others
    firsts = match.banks.firsts
    filled = np.flatnonzero(np.diff(firsts))
    gained = np.zeros((len(sets), len(firsts) - 1))
    for part in np.array_split(np.arange(len(sets)), -(-len(sets) // _AT_ONCE)) if filled.size else ():
        inside = np.matmul(whiten[part], crossed[sets[part]])
        left = every - np.sum(known[part] * inside, axis=1)
        each = gains(left, match.squares - np.sum(inside**2, axis=1))
        gained[np.ix_(part, filled)] = np.maximum.reduceat(each, firsts[filled], axis=1)
    return np.asarray(np.maximum(np.column_stack([alone, alone[:, np.newaxis] - gained]), np.finfo(float).tiny))


def _subsets(plain: Sequence[int], most: int) -> list[tuple[int, ...]]:
    """Return the sets of some terms, smaller ones first, of sizes of which not too many are compared."""
    found: list[tuple[int, ...]] = []
    for size in range(_MOST_PLAIN + 1):
        of_size = list(combinations(plain, size))
        if size > 1 and len(found) + len(of_size) > most:
            break
        found += of_size
    return found


def for_all(found: Floats, objects: int) -> Floats:
    """Return values for all objects from those of the objects that were matched: typical ones for the others."""
    where, every = evenly_spaced(objects, OBJECTS), np.tile(np.median(found, axis=0), (objects, 1))
    if len(found) == len(where):
        every[where] = found
    return every
