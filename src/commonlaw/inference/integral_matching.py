"""Which few terms, of many, fit an equation: measurements against integrals of terms along curves that are near.

If ``x' = f(x)``, measurements of x are a start, plus the integral of f along the true curve, plus noise. With states
near the true ones in f, coefficients are found by least squares on integrals, without a derivative (Dattner and
Klaassen 2015), and constants inside of terms from a bank of values. All small sets of terms are compared: sums of a few
plain terms, and one or two with constants inside. As the states in f are not the true ones, sums of squares rank sets
of as many numbers among themselves; trajectories have to judge the best of each size.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, groupby, pairwise
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.inference.constant_values import values_to_try
from commonlaw.inference.search_problem import SearchProblem, spread
from commonlaw.library import Constant, ParametricTerm, Terms
from commonlaw.likelihood import Estimate, Mesh

_OBJECTS = 12
"""Objects whose measurements are matched, evenly spread."""

_WINDOW, _WINDOWS = 200, 4
"""Points of a trial that are integrated together, with a start of their own, and how many such windows of an object are
matched, evenly spread."""

_MOST_PLAIN = 4
"""Plain terms that are taken together at most."""

_MOST_SETS, _MOST_SETS_BESIDE_TWO = 1500, 60
"""Sets of plain terms that are compared at most, smaller ones first, beside one or two others."""

_AT_ONCE = 50
"""Sets that are compared at a time, so that arrays stay small."""

_MOST_NUMBERS = 7
"""Coefficients and constants of an equation at most."""

_KEPT = (2, 3, 2)
"""Sets that are kept of those of as many numbers, by how many terms are not plain."""

_CLOSE = 6
"""Sets, of those, whose constants are found to more digits than a bank has, before they are ranked."""

_WIDENED = 4
"""Sets with one term that is not plain, each with another one, to which a second is added."""


_HOPELESS = 30.0
"""Sets that leave so many times the least sum of squares are not kept."""

_STEPS = 8
"""Of least squares on constants."""

_INSIDE = 1e-10
"""Columns of unit norm whose square is less outside of the span of others explain nothing more."""

_SAME = 1e-9
"""Relative differences of sums of squares that are rounding: such sets say the same."""


class Start(NamedTuple):
    """What a fit begins with: coefficients of each object, shape (objects, terms), plain ones first, and constants.

    Those of each of the other terms have the shape (objects, constants).
    """

    coefficients: Floats
    constants: tuple[Floats, ...] = ()


@dataclass(frozen=True)
class TermSet:
    """A few terms of one equation: plain ones, by their index, and others, with constants inside.

    Equal sets have equal terms, whatever fits begin with.
    """

    plain: tuple[int, ...]
    others: tuple[ParametricTerm, ...] = ()
    starts: tuple[Start, ...] = field(default=(), compare=False)

    @property
    def numbers(self) -> int:
        """How many numbers each object has in it."""
        return len(self.plain) + sum(1 + len(each.constants) for each in self.others)


def matching_sets(
    problem: SearchProblem, estimates: Sequence[Estimate], equation: int, others: Sequence[ParametricTerm]
) -> list[TermSet]:
    """Return sets of terms of an equation that fit best for how many numbers they have, the most promising first.

    Parameters
    ----------
    problem
        What was measured, and the plain terms.
    estimates
        States near the true ones, of each object.
    equation
        Index of the equation.
    others
        Terms with constants inside, or that are not taken together with many plain ones.
    """
    matches = [_Match.about(problem, o, estimates[o], equation, others) for o in spread(len(problem.models), _OBJECTS)]
    matches = [each for each in matches if len(each.target)]
    if not matches:
        return []
    new = [a for a in range(len(others)) if not all(each.repeats(a) for each in matches)]
    ranked = _Ranked([each.with_others(new) for each in matches], [others[a] for a in new])
    return ranked.best(len(problem.models))


@dataclass(frozen=True, eq=False)
class _Match:
    """One object's measurements of a state against integrals of terms.

    Columns have unit norm, those of plain terms before that had these norms; columns that are not finite are zero.
    Each of the others has a column for each of the values of its constants in its bank, shape (values, constants).
    """

    target: Floats
    plain: Floats
    norms: Floats
    others: Floats
    banks: tuple[Floats, ...]
    integrated: "_Integrated"

    @classmethod
    def about(
        cls, problem: SearchProblem, o: int, estimate: Estimate, equation: int, others: Sequence[ParametricTerm]
    ) -> "_Match":
        """Return the match of an object, by its index."""
        model, known = problem.models[o], problem.known[o, equation]
        integrated = _Integrated.of(problem, o, estimate, equation)
        terms, values = model.terms, integrated.values
        banks = tuple(_bank(each, terms, values) for each in others)
        plain, norms = _unit(integrated.of_terms(terms.evaluate(values)))
        along = [_along(each, values, bank) for each, bank in zip(others, banks, strict=True)]
        columns, _ = _unit(integrated.of_terms(np.concatenate([np.empty((len(values), 0)), *along], axis=1)))
        target = integrated.target - plain @ (norms * np.nan_to_num(known))
        return cls(target, plain, norms, columns, banks, integrated)

    @cached_property
    def firsts(self) -> Indices:
        """The first column of each of the others."""
        return np.cumsum([0, *map(len, self.banks)])[:-1]

    def columns_of(self, a: int) -> Floats:
        """Return the columns of one of the others."""
        return self.others[:, self.firsts[a] : self.firsts[a] + len(self.banks[a])]

    def repeats(self, a: int) -> bool:
        """Return whether one of the others is along the curves what a plain term is, as abs(x) where x is positive."""
        columns = self.columns_of(a)
        return columns.shape[1] == 1 and bool(np.any(np.abs(self.plain.T @ columns) > 1 - _INSIDE))

    def with_others(self, indices: Sequence[int]) -> "_Match":
        """Return the match with some of the others."""
        columns = np.concatenate([np.empty((len(self.target), 0)), *map(self.columns_of, indices)], axis=1)
        return replace(self, others=columns, banks=tuple(self.banks[a] for a in indices))

    def integrals_of(self, others: Sequence[ParametricTerm], constants: Sequence[Floats]) -> Floats:
        """Return the columns of terms at values of their constants, not of unit norm, shape (n, terms)."""
        values = self.integrated.values
        pairs = zip(others, constants, strict=True)
        along = [_along(each, values, own[np.newaxis]) for each, own in pairs]
        return self.integrated.of_terms(np.concatenate([np.empty((len(values), 0)), *along], axis=1))

    def fitted(self, found: TermSet, constants: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Return coefficients by least squares, plain terms first, and what is left of the target.

        All is left where a term is not finite.
        """
        others, sizes = _unit(self.integrals_of(found.others, constants))
        columns = np.column_stack([self.plain[:, list(found.plain)], others])
        if not np.isfinite(sizes).all():
            return np.zeros(columns.shape[1]), self.target
        own = np.linalg.lstsq(columns, self.target, rcond=1e-12)[0]
        norms = np.append(self.norms[list(found.plain)], sizes)
        return own / np.where(norms > 0, norms, 1.0), self.target - columns @ own

    def closest(self, found: TermSet, begin: Sequence[Floats]) -> tuple[Floats, ...]:
        """Return the constants of a set that leave least, near some."""
        from scipy.optimize import least_squares

        if not any(len(each) for each in begin):
            return tuple(begin)
        cuts = np.cumsum([len(each) for each in begin])[:-1]
        whole = np.concatenate(begin)
        unit = np.where(whole != 0, whole, 1.0)
        done = least_squares(lambda x: self.fitted(found, np.split(x * unit, cuts))[1], whole / unit, max_nfev=_STEPS)
        return tuple(np.split(done.x * unit, cuts))


@dataclass(frozen=True, eq=False)
class _Integrated:
    """Curves of an object, and what integrals along them are as they show in measurements of a state.

    Parameters
    ----------
    values
        Of the variables without constants, along the curves, shape (n, variables).
    target
        What was measured, relative to its noise, without what free starts explain.
    windows
        Consecutive points, each with the integrals of unit rates at single points as they show in its measurements.
    """

    values: Floats
    target: Floats
    windows: Sequence[Floats]

    @classmethod
    def of(cls, problem: SearchProblem, o: int, estimate: Estimate, equation: int) -> "_Integrated":
        """Return the curves of an object, by its index, along its estimated states."""
        model = problem.models[o]
        variables, order = model.terms.variables, model.order
        states = np.concatenate([each[:, : model.width] for each in estimate.states])
        inputs, times = (np.concatenate([getattr(mesh, name) for mesh in model.meshes]) for name in ("inputs", "times"))
        values = variables.natural(np.column_stack([states, inputs, times]))
        windows = _Window.of(problem, model.meshes, equation)
        rows = np.concatenate([each.points for each in windows])
        target = np.concatenate([each.target(order) for each in windows])
        operators = [each.integrals(order) for each in windows]
        if variables.states[equation] in variables.logarithmic:
            operators = [own / values[each.points, equation] for own, each in zip(operators, windows, strict=True)]
        return cls(_above_zero(values)[rows], target, operators)

    def of_terms(self, rates: Floats) -> Floats:
        """Return integrals of rates along the curves, shape (n, k)."""
        cuts = np.cumsum([each.shape[1] for each in self.windows])[:-1]
        pairs = zip(self.windows, np.split(rates, cuts), strict=True)
        with np.errstate(all="ignore"):
            return np.concatenate([own @ each for own, each in pairs])


@dataclass(frozen=True, eq=False)
class _Window:
    """Consecutive points of a trial, by their index, and the measurements of a state among them.

    `observed` are the indices of these among the points.
    """

    points: Indices
    times: Floats
    observed: Indices
    measured: Floats
    std: Floats

    @classmethod
    def of(cls, problem: SearchProblem, meshes: Sequence[Mesh], equation: int) -> "list[_Window]":
        """Return windows of an object's trials, evenly spread."""
        found, before = [], 0
        for mesh in meshes:
            std = problem.std_of(mesh)[:, equation]
            cuts = [0, *(np.flatnonzero(~mesh.contiguous) + 1).tolist(), len(mesh)]
            for first, last in pairwise(cuts):
                parts = np.array_split(np.arange(first, last), -(-(last - first) // _WINDOW))
                for points in parts:
                    seen = np.flatnonzero(mesh.observed[points, equation])
                    at = points[seen]
                    own = mesh.times[points], seen, mesh.measured[at, equation], std[at]
                    found.append(cls(before + points, *own))
            before += len(mesh)
        return [found[i] for i in spread(len(found), _WINDOWS)]

    def integrals(self, order: int) -> Floats:
        """Return the integrals of splines that are one at a point, shape (measurements, points), see `target`.

        Once, or for a second order twice.
        """
        from scipy.interpolate import CubicSpline

        of_points = CubicSpline(self.times, np.eye(len(self.times))).antiderivative(order)(self.times[self.observed])
        return self._beside_starts(of_points / self.std[:, np.newaxis], order)

    def target(self, order: int) -> Floats:
        """Return what was measured, relative to the noise, without what a free start (and rate there) explains."""
        return self._beside_starts((self.measured / self.std)[:, np.newaxis], order)[:, 0]

    def _beside_starts(self, rows: Floats, order: int) -> Floats:
        times = (self.times - self.times[0])[self.observed]
        basis = np.linalg.qr(np.column_stack([times**k / self.std for k in range(order)]))[0]
        return np.asarray(rows - basis @ (basis.T @ rows))


_Key = tuple[tuple[int, ...], tuple[int, ...]]
"""Indices of plain terms, and of others."""


@dataclass(frozen=True, eq=False)
class _Ranked:
    """Sets of terms by what they leave of the measurements of all objects."""

    matches: Sequence[_Match]
    others: Sequence[ParametricTerm]

    def best(self, objects: int) -> list[TermSet]:
        """Return the best sets of each size, as far as more numbers pay for themselves, for so many objects."""
        sums = self._of_one()
        sums |= self._of_two(sums)
        groups: dict[tuple[int, int], list[tuple[float, _Key]]] = {}
        for key, squares in sums.items():
            groups.setdefault((self._numbers(key), len(key[1])), []).append((squares, key))
        ranked = [
            self._ranked(_different(sorted(listed)))
            for (numbers, _), listed in sorted(groups.items())
            if 0 < numbers <= _MOST_NUMBERS
        ]
        least = dict.fromkeys(range(1, _MOST_NUMBERS + 1), np.inf)
        for squares, each in (own for listed in ranked for own in listed):
            least[each.numbers] = min(least[each.numbers], squares)
        enough = min(least, key=lambda n: self._criterion(n, least[n]))
        kept = [
            (self._criterion(each.numbers, squares), each)
            for listed in ranked
            for squares, each in listed[: _KEPT[len(listed[0][1].others)]]
            if each.numbers <= enough + 1 and squares <= _HOPELESS * least[enough]
        ]
        return [self._for_all(each, objects) for _, each in sorted(kept, key=lambda pair: pair[0])]

    def _ranked(self, keys: Sequence[_Key]) -> list[tuple[float, TermSet]]:
        """Return sets with what they leave, the best first, and with what fits begin with.

        That is what each object has by itself, from the best values of its banks, and what it has with the constants
        that are typical: those of an object alone may be far off.
        """
        found = []
        for plain, others in keys:
            each = TermSet(plain, tuple(self.others[a] for a in others))
            begun = [[match.banks[a][i] for a, i in self._values(match, (plain, others))] for match in self.matches]
            alone = [match.closest(each, own) for match, own in zip(self.matches, begun, strict=True)]
            typical = tuple(np.median(own, axis=0) for own in zip(*alone, strict=True))
            squares, start = self._start(each, alone)
            starts = [start]
            if len(self.matches) > 1 and any(map(len, typical)):
                starts.append(self._start(each, [typical] * len(self.matches))[1])
            found.append((squares, replace(each, starts=tuple(starts))))
        return sorted(found, key=lambda pair: pair[0])

    def _start(self, found: TermSet, constants: Sequence[Sequence[Floats]]) -> tuple[float, Start]:
        """Return what a set leaves with these constants of each object, and what a fit begins with then."""
        fits = [match.fitted(found, own) for match, own in zip(self.matches, constants, strict=True)]
        squares = sum(float(left @ left) for _, left in fits)
        values = tuple(np.array(own) for own in zip(*constants, strict=True))
        return squares, Start(np.array([own for own, _ in fits]), values)

    def _for_all(self, found: TermSet, objects: int) -> TermSet:
        """Return a set with starts of all objects: typical ones of those that were not matched."""
        where, starts = spread(objects, _OBJECTS), []
        for start in found.starts:
            several = [_for_all(each, objects, where) for each in (start.coefficients, *start.constants)]
            starts.append(Start(several[0], tuple(several[1:])))
        return replace(found, starts=tuple(starts))

    def _of_one(self) -> dict[_Key, float]:
        """Return the sums of squares that plain terms leave, with at most one of the others."""
        columns = [match.plain for match in self.matches]
        found: dict[_Key, float] = {}
        for plain, row in self._left(columns, _subsets(columns[0].shape[1], _MOST_SETS)):
            found[plain, ()] = row[0]
            found |= {(plain, (a,)): squares for a, squares in enumerate(row[1:])}
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
            columns = [
                np.column_stack([match.plain, *(match.columns_of(a)[:, i] for a, i in self._values(match, key))])
                for match in self.matches
            ]
            last = columns[0].shape[1] - 1
            for plain, row in self._left(columns, [(*own, last) for own in _subsets(last, _MOST_SETS_BESIDE_TWO)]):
                for a, squares in enumerate(row[1:]):
                    if a not in key[1]:
                        wider = plain[:-1], tuple(sorted((*key[1], a)))
                        found[wider] = min(squares, found.get(wider, np.inf))
        return found

    def _left(
        self, columns: Sequence[Floats], sets: Sequence[tuple[int, ...]]
    ) -> Iterator[tuple[tuple[int, ...], list[float]]]:
        """Yield sets of columns with the sums of squares that they leave, alone and with each of the others."""
        for _, group in groupby(sets, len):
            listed = list(group)
            indices = np.array(listed, dtype=int)
            sums = sum(_left_by_one(match, own, indices) for match, own in zip(self.matches, columns, strict=True))
            yield from zip(listed, np.asarray(sums).tolist(), strict=True)

    def _numbers(self, key: _Key) -> int:
        return len(key[0]) + sum(1 + len(self.others[a].constants) for a in key[1])

    def _criterion(self, numbers: int, squares: float) -> float:
        """Return what ranks sets of different size: the BIC."""
        count = sum(len(each.target) for each in self.matches)
        return count * float(np.log(max(squares, 1e-300))) + numbers * len(self.matches) * float(np.log(count))

    def _values(self, match: _Match, key: _Key) -> list[tuple[int, int]]:
        """Return each of the others of a set, by index, with that of its best values, one after the other."""
        plain, others = key
        chosen: dict[int, int] = {}
        for a in others * (2 if len(others) > 1 else 1):
            beside = [match.plain[:, list(plain)]]
            beside += [match.columns_of(b)[:, [i]] for b, i in chosen.items() if b != a]
            basis = _basis(np.concatenate(beside, axis=1))
            left, columns = match.target - basis @ (basis.T @ match.target), match.columns_of(a)
            inside = np.sum((basis.T @ columns) ** 2, axis=0)
            chosen[a] = int(np.argmax(_gains(left @ columns, np.sum(columns**2, axis=0) - inside)))
        return [(a, chosen[a]) for a in others]


def _gains(inner: Floats, outside: Floats) -> Floats:
    """Return by how much columns lower the squares that others leave.

    From their inner products with what is left, and their squares outside of the others.
    """
    return np.where(outside > _INSIDE, inner**2 / np.maximum(outside, _INSIDE), 0.0)


def _left_by_one(match: _Match, columns: Floats, sets: Indices) -> Floats:
    """Return the sums of squares that sets of columns leave, alone and with each of the others at its best.

    Shape (sets, 1 + others), of sets of one size, shape (sets, size).
    """
    gram, inner = columns.T @ columns, columns.T @ match.target
    own = gram[sets[:, :, np.newaxis], sets[:, np.newaxis, :]] + _INSIDE * np.eye(sets.shape[1])
    whiten = np.linalg.inv(np.linalg.cholesky(own))
    known = np.matmul(whiten, inner[sets][..., np.newaxis])
    alone = match.target @ match.target - np.sum(known[..., 0] ** 2, axis=1)
    if not match.others.shape[1]:
        return np.maximum(alone[:, np.newaxis], np.finfo(float).tiny)
    crossed, every = columns.T @ match.others, match.target @ match.others
    squares = np.sum(match.others**2, axis=0)
    found = np.empty((len(sets), len(match.banks)))
    for part in np.array_split(np.arange(len(sets)), -(-len(sets) // _AT_ONCE)):
        inside = np.matmul(whiten[part], crossed[sets[part]])
        left = every - np.sum(known[part] * inside, axis=1)
        gains = _gains(left, squares - np.sum(inside**2, axis=1))
        found[part] = np.maximum.reduceat(gains, match.firsts, axis=1)
    return np.maximum(np.column_stack([alone, alone[:, np.newaxis] - found]), np.finfo(float).tiny)


def _different(ordered: Sequence[tuple[float, _Key]]) -> list[_Key]:
    """Return the first sets of a list, but for those that leave the same as the one before: they say the same."""
    found, before = [], 0.0
    for squares, key in ordered:
        if squares > before * (1 + _SAME):
            found.append(key)
        before = squares
        if len(found) == _CLOSE:
            break
    return found


def _subsets(count: int, most: int) -> list[tuple[int, ...]]:
    """Return the sets of plain terms, smaller ones first, of sizes of which not too many are compared."""
    found: list[tuple[int, ...]] = []
    for size in range(_MOST_PLAIN + 1):
        of_size = list(combinations(range(count), size))
        if size > 1 and len(found) + len(of_size) > most:
            break
        found += of_size
    return found


def _bank(other: ParametricTerm, terms: Terms, values: Floats) -> Floats:
    """Return values of the constants of a term that are tried, shape (values, constants)."""
    if not other.constants:
        return np.empty((1, 0))
    variables = replace(terms.variables, constants=other.constants)
    first = len(variables.measured)
    columns = range(first, first + len(other.constants))
    return values_to_try(Terms(variables, (other.term, *map(Constant, columns))), values, columns)


def _along(other: ParametricTerm, values: Floats, bank: Floats) -> Floats:
    """Return a term along curves at each of some values of its constants, shape (n, values)."""
    count = len(values)
    repeated = np.column_stack([np.tile(values, (len(bank), 1)), np.repeat(bank, count, axis=0)])
    return other.term.evaluate(repeated).reshape(len(bank), count).T


def _unit(columns: Floats) -> tuple[Floats, Floats]:
    """Return columns of unit norm, zero where they are not finite, and the norms that they had."""
    norms = np.linalg.norm(columns, axis=0)
    usable = np.isfinite(norms) & (norms > 0)
    return np.divide(columns, norms, out=np.zeros_like(columns), where=usable), norms


def _above_zero(values: Floats) -> Floats:
    """Return values of variables, of which those are kept above zero that are hardly below it: noise, most likely.

    So that roots and logarithms exist.
    """
    sizes = np.sqrt(np.mean(values**2, axis=0))
    hardly = values.min(axis=0) > -_HARDLY * sizes
    return np.where(hardly & (values < _LEAST * sizes), _LEAST * sizes, values)


_HARDLY, _LEAST = 0.2, 1e-3
"""Shares of the size of a variable: how far below zero it may be by noise, and what is taken instead."""


def _basis(columns: Floats) -> Floats:
    """Return an orthonormal basis of columns of unit norm."""
    if not columns.shape[1]:
        return columns
    basis, sizes, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(basis[:, sizes > np.sqrt(_INSIDE) * sizes[0]])


def _for_all(found: Floats, objects: int, where: Sequence[int]) -> Floats:
    """Return values of some objects for all: those of the others are typical."""
    every = np.tile(np.median(found, axis=0), (objects, 1))
    if len(found) == len(where):
        every[list(where)] = found
    return every
