"""Small sets of terms, of many, that fit an equation best: ranked by sums of squares of integrals.

All are compared: sums of a few plain terms, with one or two others that have constants inside. As the states along
which terms are integrated are not the true ones, sums of squares rank sets of as many numbers among themselves;
trajectories have to judge the best of each size.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations, groupby

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.inference import settings
from commonlaw.inference.fit.integral_form import Course, Match, gains
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.library import ParametricTerm, Ratio, TiedTerms
from commonlaw.likelihood import Estimate
from commonlaw.parallel import in_parallel
from commonlaw.spacing import evenly_spaced


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

    Terms that share their constants are one of the others.

    Equal sets have equal terms, whatever fits begin with.
    """

    plain: tuple[int, ...]
    others: tuple[ParametricTerm | TiedTerms | Ratio, ...] = ()
    starts: tuple[Start, ...] = field(default=(), compare=False)

    @property
    def numbers(self) -> int:
        """How many numbers each object has in it."""
        return len(self.plain) + sum(each.size + len(each.constants) for each in self.others)

    def places_of(self, k: int) -> range:
        """Return where the coefficients of a term stand, by its place among the plain ones and the others."""
        if k < len(self.plain):
            return range(k, k + 1)
        before, own = self.others[: k - len(self.plain)], self.others[k - len(self.plain)]
        first = len(self.plain) + sum(each.size for each in before)
        return range(first, first + own.size)

    def without(self, k: int) -> "TermSet":
        """Return the set without one of its terms, by its place among the plain ones and the others."""
        places, m = self.places_of(k), k - len(self.plain)
        kept = [i for i in range(len(self.others)) if i != m]
        starts = tuple(
            Start(np.delete(each.coefficients, places, axis=1), tuple(each.constants[i] for i in kept))
            for each in self.starts
        )
        plain = tuple(own for i, own in enumerate(self.plain) if i != k)
        return TermSet(plain, tuple(self.others[i] for i in kept), starts)


def matching_sets(
    problem: SearchProblem,
    estimates: Sequence[Estimate],
    others: Sequence[ParametricTerm | TiedTerms],
    most: Mapping[int, int],
    hopeless: float = settings.MAX_SQUARES_RATIO,
) -> dict[int, list[TermSet]]:
    """Return sets of terms that fit best for how many numbers they have, the most promising first, by equation.

    Parameters
    ----------
    problem
        What was measured, and the plain terms.
    estimates
        States near the true ones, of each object.
    others
        Terms with constants inside, or that are not taken together with many plain ones.
    most
        How many numbers the sets of an equation have at most, by its index.
    hopeless
        Sets that leave so many times the least sum of squares are not kept, but for the best of each size.
    """
    indices = evenly_spaced(len(problem.models), settings.MAX_OBJECTS)
    whole = [each.whole for each in others]
    courses = in_parallel(lambda o: Course.of(problem, o, estimates[o], whole), indices)
    found = {}
    for equation, numbers in most.items():
        matches = [match for each in courses if len((match := each.match(equation)).target)]
        plain = np.flatnonzero(problem.allowed[equation]).tolist()
        found[equation] = _Ranked(matches, plain, others, numbers, hopeless).best(len(problem.models))
    return found


_Key = tuple[tuple[int, ...], tuple[int, ...]]
"""Indices of plain terms, and of others."""


@dataclass(frozen=True, eq=False)
class _Compared:
    """The sums of squares that sets of as many plain terms leave, with others, shape (sets, columns).

    All have those others that are `beside`, and those of a column one more, or none.
    """

    sets: Sequence[tuple[int, ...]]
    beside: tuple[int, ...]
    more: Sequence[tuple[int, ...]]
    squares: Floats

    def key(self, place: int, column: int) -> _Key:
        """Return a set by its place, with the others of a column."""
        return self.sets[place], tuple(sorted((*self.beside, *self.more[column])))

    def best_of(self, column: int) -> tuple[float, _Key]:
        """Return the set that leaves least with the others of a column, and what it leaves."""
        place = int(np.argmin(self.squares[:, column]))
        return float(self.squares[place, column]), self.key(place, column)


@dataclass(frozen=True, eq=False)
class _Ranked:
    """Sets of terms of an equation by what they leave of the measurements of all objects.

    Plain terms are those, by their index, whose coefficients are not known. Sets have so many numbers at most.
    """

    matches: Sequence[Match]
    plain: Sequence[int]
    others: Sequence[ParametricTerm | TiedTerms]
    at_most: int
    hopeless: float
    values: dict[_Key, list[tuple[int, ...]]] = field(default_factory=dict)
    constants: dict[_Key, list[tuple[Floats, ...]]] = field(default_factory=dict)

    def best(self, objects: int) -> list[TermSet]:
        """Return the best sets of each size, as far as more numbers pay for themselves, for so many objects."""
        if not self.matches:
            return []
        compared = self._of_one()
        compared += self._of_two(compared)
        groups: dict[tuple[int, int], list[tuple[_Compared, int]]] = {}
        for each in compared:
            for column in range(len(each.more)):
                key = each.key(0, column)
                groups.setdefault((self._numbers(key), len(key[1])), []).append((each, column))
        coarse = [
            (numbers, min(each.best_of(column)[0] for each, column in listed))
            for (numbers, _), listed in groups.items()
            if 0 < numbers <= self.at_most
        ]
        if not coarse:
            return []
        most, _ = min(coarse, key=lambda pair: self._criterion(*pair))
        ranked = [
            (numbers, many, sorted(self._closely(key) for key in self._nearest(self._different(listed))))
            for (numbers, many), listed in sorted(groups.items(), key=lambda pair: pair[0])
            if 0 < numbers <= min(most + 1, self.at_most)
        ]
        least = {numbers: np.inf for numbers, _, _ in ranked}
        for numbers, _, listed in ranked:
            least[numbers] = min(least[numbers], listed[0][0])
        enough = min(least, key=lambda n: self._criterion(n, least[n]))
        kept = [
            (self._criterion(numbers, squares), key)
            for numbers, many, listed in ranked
            for place, (squares, key) in enumerate(listed[: settings.MAX_KEPT])
            if numbers <= enough + 1 and (not place or squares <= self.hopeless * least[enough])
        ]
        return [self._with_starts(key, objects) for _, key in sorted(kept)]

    def _of_one(self) -> list[_Compared]:
        """Return what plain terms leave, with at most one of the others."""
        columns = [match.plain for match in self.matches]
        repeated = np.all([match.banks.repeated for match in self.matches], axis=0)
        repeated |= np.any([[match.repeats(a) for a in range(len(self.others))] for match in self.matches], axis=0)
        new = np.flatnonzero(~repeated).tolist()
        return self._compared(columns, _subsets(self.plain, settings.MAX_SETS[0]), (), (), [(), *((a,) for a in new)])

    def _of_two(self, compared: Sequence[_Compared]) -> list[_Compared]:
        """Return the same with two of the others, one of them from the best sets with one, each with another one."""
        best: dict[int, tuple[float, _Key]] = {}
        for each in compared:
            for column, own in enumerate(each.more):
                for a in own:
                    squares, key = each.best_of(column)
                    value = self._criterion(self._numbers(key), squares)
                    best[a] = min((value, key), best.get(a, (np.inf, key)))
        found = list[_Compared]()
        for _, key in sorted(best.values())[: settings.MAX_KEPT]:
            (a,), columns = key[1], []
            more = [(b,) for b in best if b != a and self._numbers(((), (a, b))) <= self.at_most]
            if more:
                for match in self.matches:
                    (value,) = self._values(match, [key])[key]
                    columns.append(np.column_stack([match.plain, match.columns_of(a)[:, value]]))
                last = columns[0].shape[1] - 1
                found += self._compared(columns, _subsets(self.plain, settings.MAX_SETS[1]), (last,), (a,), more)
        return found

    def _compared(
        self,
        columns: Sequence[Floats],
        sets: Sequence[tuple[int, ...]],
        last: tuple[int, ...],
        beside: tuple[int, ...],
        more: Sequence[tuple[int, ...]],
    ) -> list[_Compared]:
        """Return what sets of columns leave, by their size: with the last of the columns, for the others beside."""
        found = list[_Compared]()
        for size, group in groupby(sets, len):
            listed = list(group)
            few = [own for own in more if size + self._numbers(((), (*beside, *own))) <= self.at_most]
            if few:
                indices = np.array([(*own, *last) for own in listed], dtype=int)
                chosen = [a for own in few for a in own]
                sums = np.sum(in_parallel(partial(_left_by_one, indices, chosen), self.matches, columns), axis=0)
                found.append(_Compared(listed, beside, few, sums if () in few else sums[:, 1:]))
        return found

    def _numbers(self, key: _Key) -> int:
        return len(key[0]) + sum(self.others[a].size + len(self.others[a].constants) for a in key[1])

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

    def _different(self, listed: Sequence[tuple[_Compared, int]]) -> list[_Key]:
        """Return the sets of some columns that leave least, but for those that leave the same as the one before.

        They say the same. Few have the same terms with constants, or none.
        """
        found, before, alike = dict[_Key, None](), 0.0, Counter[tuple[int, ...]]()
        squares = np.concatenate([each.squares[:, column] for each, column in listed])
        firsts = np.cumsum([0, *(len(each.sets) for each, _ in listed)])
        for k in np.argsort(squares, kind="stable").tolist():
            group = int(np.searchsorted(firsts, k, side="right")) - 1
            each, column = listed[group]
            key = each.key(k - int(firsts[group]), column)
            inside = tuple(a for a in key[1] if self.others[a].constants)
            few = alike[inside] < (settings.MAX_KEPT if inside else settings.MAX_REFINED)
            if few and key not in found and squares[k] > before * (1 + settings.ROUNDING):
                found[key] = None
                alike[inside] += 1
            before = squares[k]
            if len(found) == settings.MAX_LINEARIZED:
                break
        return [*found]

    def _nearest(self, keys: Sequence[_Key]) -> list[_Key]:
        """Return the sets that leave least where constants may be near those of their banks: banks are coarse."""
        best = in_parallel(lambda match: self._values(match, keys), self.matches)
        self.values.update({key: [own[key] for own in best] for key in keys})
        for match, own in zip(self.matches, best, strict=True):
            match.learn_slopes(pair for key in keys for pair in zip(key[1], own[key], strict=True))
        left = [
            sum(match.left_nearby(*key, own) for match, own in zip(self.matches, self.values[key], strict=True))
            for key in keys
        ]
        return [keys[k] for k in np.argsort(left, kind="stable")[: settings.MAX_REFINED]]

    def _closely(self, key: _Key) -> tuple[float, _Key]:
        """Return a set with what it leaves at the best constants."""
        fits = self._fitted(key, self._constants(key))
        return sum(float(left @ left) for _, left in fits), key

    def _fitted(self, key: _Key, constants: Sequence[Sequence[Floats]]) -> list[tuple[Floats, Floats]]:
        """Return the coefficients of a set in each object, with constants of its others there, and what is left."""
        parts = [part for a in key[1] for part in self.others[a].parts]
        shared = [[self._shared(a, own) for a, own in zip(key[1], each, strict=True)] for each in constants]
        inside = [[own for a, own in zip(key[1], each, strict=True) for _ in self.others[a].parts] for each in shared]
        return [match.fitted(key[0], parts, own) for match, own in zip(self.matches, inside, strict=True)]

    def _shared(self, a: int, constants: Floats) -> Floats:
        """Return the constants that a law has of all that one of the others is compared with."""
        other = self.others[a]
        return constants[[other.whole.constants.index(name) for name in other.constants]]

    def _with_starts(self, key: _Key, objects: int) -> TermSet:
        """Return a set with what fits begin with, for so many objects.

        That is what each object has by itself, and with the constants that are typical: those of an object alone may
        be far off.
        """
        alone = self._constants(key)
        typical = tuple(np.median(own, axis=0) for own in zip(*alone, strict=True))
        starts = []
        for constants in (alone, [typical] * len(alone)) if any(map(len, typical)) and len(alone) > 1 else (alone,):
            fits = [coefficients for coefficients, _ in self._fitted(key, constants)]
            of_each = zip(key[1], zip(*constants, strict=True), strict=True)
            several = [np.array(fits), *(np.array([self._shared(a, own) for own in every]) for a, every in of_each)]
            first, *others = (for_all(each, objects) for each in several)
            starts.append(Start(first, tuple(others)))
        return TermSet(key[0], tuple(self.others[a] for a in key[1]), tuple(starts))


def _left_by_one(sets: Indices, chosen: Sequence[int], match: Match, columns: Floats) -> Floats:
    """Return the sums of squares that sets of columns leave, alone and with each of some of the others at its best.

    Shape (sets, 1 + chosen), of sets of one size, shape (sets, size).
    """
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
    for size in range(settings.MAX_PLAIN_TERMS + 1):
        of_size = list(combinations(plain, size))
        if size > 1 and len(found) + len(of_size) > most:
            break
        found += of_size
    return found


def for_all(found: Floats, objects: int) -> Floats:
    """Return values for all objects from those of the objects that were matched: typical ones for the others."""
    where, every = evenly_spaced(objects, settings.MAX_OBJECTS), np.tile(np.median(found, axis=0), (objects, 1))
    if len(found) == len(where):
        every[where] = found
    return every
