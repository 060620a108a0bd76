"""Measurements of a state against integrals of terms along curves that are near the true ones.

If ``x' = f(x)``, measurements of x are a start, plus the integral of f along the true curve, plus noise. With states
near the true ones in f, coefficients are found by least squares on integrals, without a derivative (Dattner and
Klaassen 2015), and constants inside of terms from a bank of values.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.inference import settings
from commonlaw.inference.fit.parameter_grid import Banks, along
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.validity import values_along
from commonlaw.library import ParametricTerm, order_of_each
from commonlaw.likelihood import Estimate, Mesh
from commonlaw.spacing import evenly_spaced


@dataclass(frozen=True, eq=False)
class Course:
    """An object's curves, and terms along them.

    Parameters
    ----------
    problem, index
        What was measured, and which object it is.
    plain
        Plain terms, shape (n, terms).
    banks
        Terms with constants inside.
    """

    problem: SearchProblem
    index: int
    plain: Floats
    banks: Banks

    @classmethod
    def of(cls, problem: SearchProblem, index: int, estimate: Estimate, others: Sequence[ParametricTerm]) -> "Course":
        """Return the curves of an object along its estimated states."""
        terms, values = problem.models[index].terms, values_along(problem, index, estimate)
        sampled = np.concatenate([mesh.observed.any(axis=1) for mesh in problem.models[index].meshes])
        banks = Banks.along(terms.variables, values, others, sampled)
        return cls(problem, index, terms.evaluate(values), banks)

    def match(self, equation: int) -> "Match":
        """Return the measurements of the state of an equation against integrals along these curves."""
        known = self.problem.known[self.index, equation]
        integrals, target = Integrals.and_target(self.problem, self.index, equation, self.banks.values)
        plain, norms = unit(integrals.of(self.plain))
        target = target - plain @ (norms * np.nan_to_num(known))
        return Match(target, plain, norms, unit(integrals.of(self.banks.columns))[0], self.banks, integrals)


@dataclass(frozen=True, eq=False)
class Match:
    """One object's measurements of a state against integrals of terms.

    Parameters
    ----------
    target
        What was measured, relative to its noise, without what free starts explain, shape (n,).
    plain, norms
        Integrals of plain terms, of unit norm, shape (n, terms), and the norms that they had.
    others, banks
        Integrals of the others at each value in their banks, of unit norm, and the banks.
    integrals
        How they are integrated.
    slopes
        Derivatives by the constants, by index of a term and of a value, as far as they were asked for.
    """

    target: Floats
    plain: Floats
    norms: Floats
    others: Floats
    banks: Banks
    integrals: "Integrals"
    slopes: dict[tuple[int, int], Floats] = field(default_factory=dict)

    @cached_property
    def squares(self) -> Floats:
        """The squares of the norms of the others: one, or zero where an integral vanishes."""
        return np.asarray(np.sum(self.others**2, axis=0))

    def columns_of(self, a: int) -> Floats:
        """Return the columns of one of the others, by its index."""
        return self.others[:, self._of(a)]

    def places_of(self, others: Sequence[int]) -> tuple[Indices, Indices]:
        """Return the columns of some of the others, by their indices, and how many each of them has."""
        places = [np.empty(0, dtype=np.intp), *(np.arange(own.start, own.stop) for own in map(self._of, others))]
        return np.concatenate(places), np.array([*map(len, places[1:])], dtype=np.intp)

    def repeats(self, a: int) -> bool:
        """Return whether one of the others is along the curves what a plain term is, as abs(x) where x is positive."""
        columns = self.columns_of(a)
        return not columns.shape[1] or (
            not self.banks.others[a].constants and bool(np.any(np.abs(self.plain.T @ columns) > 1 - settings.COLLINEAR))
        )

    def columns_at(self, others: Sequence[int], values: Sequence[int]) -> Floats:
        """Return the columns of some of the others, each at a value by its index in its bank, shape (n, others)."""
        return self.others[:, [self.banks.firsts[a] + i for a, i in zip(others, values, strict=True)]]

    def best_values(self, plain: Sequence[int], others: Sequence[int]) -> tuple[int, ...]:
        """Return the values of the others that leave least, by their indices in banks, found in turn."""
        found, fixed = dict[int, int](), self.plain[:, list(plain)]
        for a in [*others] * len(others):
            found.pop(a, None)
            basis = np.linalg.qr(np.column_stack([fixed, self.columns_at([*found], [*found.values()])]))[0]
            columns, residuals = self.columns_of(a), self.target - basis @ (basis.T @ self.target)
            outside = self.squares[self._of(a)] - np.sum((basis.T @ columns) ** 2, axis=0)
            found[a] = int(np.argmax(gains(residuals @ columns, outside)))
        return tuple(found[a] for a in others)

    def _of(self, a: int) -> slice:
        return slice(self.banks.firsts[a], self.banks.firsts[a + 1])

    def learn_slopes(self, pairs: Iterable[tuple[int, int]]) -> None:
        """Compute derivatives by the constants at values in banks, by index of a term and of a value, all at once."""
        own: dict[int, list[int]] = {}
        for a, index in dict.fromkeys(pairs):
            if (a, index) not in self.slopes:
                own.setdefault(a, []).append(index)
        banks = {a: [with_steps(self.banks.constants[a][index]) for index in each] for a, each in own.items()}
        columns = self._integrated(
            [self.banks.others[a] for a in banks], [np.concatenate(each) for each in banks.values()]
        )
        for (a, indices), found in zip(own.items(), columns, strict=True):
            for index, each in zip(indices, np.split(found, len(indices), axis=1), strict=True):
                self.slopes[a, index] = unit(each[:, 1:] - each[:, :1])[0]

    def left_nearby(self, plain: Sequence[int], others: Sequence[int], indices: Sequence[int]) -> float:
        """Return the least sum of squares to first order about values of the constants, whose slopes are known."""
        slopes = [self.slopes[pair] for pair in zip(others, indices, strict=True)]
        whole = np.column_stack([self.plain[:, list(plain)], self.columns_at(others, indices), *slopes])
        residuals = self.target - whole @ np.linalg.lstsq(whole, self.target, rcond=settings.MIN_SINGULAR_VALUE)[0]
        return float(residuals @ residuals)

    def fitted(
        self, plain: Sequence[int], others: Sequence[ParametricTerm], constants: Sequence[Floats]
    ) -> tuple[Floats, Floats]:
        """Return coefficients by least squares, plain terms first, and what is left of the target.

        The others are any terms with these constants. All is left where a term is not finite.
        """
        columns = self._integrated(others, [own[np.newaxis] for own in constants])
        return solved(np.column_stack([self.plain[:, list(plain)] * self.norms[list(plain)], *columns]), self.target)

    def closest(self, plain: Sequence[int], others: Sequence[int], indices: Sequence[int]) -> tuple[Floats, ...]:
        """Return the constants of terms that leave least, near those in banks."""
        begin = [self.banks.constants[a][i] for a, i in zip(others, indices, strict=True)]
        if not any(map(len, begin)):
            return tuple(begin)
        cuts, fixed = np.cumsum([len(each) for each in begin])[:-1], self.plain[:, list(plain)]
        terms = [self.banks.others[a] for a in others]

        def linearized(values: Floats) -> tuple[Floats, Floats]:
            columns = self._integrated(terms, [with_steps(own) for own in np.split(values, cuts)])
            here = np.column_stack([fixed, *(each[:, 0] for each in columns)])
            whole, step = np.repeat(here[np.newaxis], 1 + len(values), axis=0), 1
            for place, each in enumerate(columns, fixed.shape[1]):
                count = each.shape[1] - 1
                whole[step : step + count, :, place] = each[:, 1:].T
                step += count
            return projected(self.target, whole)

        return tuple(np.split(closest(linearized, np.concatenate(begin)), cuts))

    def _integrated(self, others: Sequence[ParametricTerm], banks: Sequence[Floats]) -> list[Floats]:
        """Return integrals of some terms at some values of their constants, shape (n, values) each."""
        if not others:
            return []
        columns = [along(each, self.banks.values, own) for each, own in zip(others, banks, strict=True)]
        whole = self.integrals.of(np.concatenate(columns, axis=1))
        return np.split(whole, np.cumsum([len(own) for own in banks])[:-1], axis=1)


@dataclass(frozen=True, eq=False)
class Integrals:
    """Windows along curves, by the indices of their points, and what integrals are as they show in measurements.

    An operator has the integrals of rates that are one at a single point, shape (measurements, points).
    """

    points: Sequence[Indices]
    operators: Sequence[Floats]

    @classmethod
    def and_target(
        cls, problem: SearchProblem, index: int, equation: int, values: Floats
    ) -> "tuple[Integrals, Floats]":
        """Return how an object's rates of a state are integrated, and what was measured of it, shape (n,).

        Relative to its noise, without what free starts explain. Values of all variables along the curves have the shape
        (points, variables).
        """
        model = problem.models[index]
        variables, order = model.terms.variables, order_of_each(model.order, model.equations)[equation]
        windows = _Window.of(problem, model.meshes, equation)
        operators = [each.integrals(order) for each in windows]
        if variables.states[equation] in variables.logarithmic:
            state = values[:, equation]
            operators = [own / state[each.points] for own, each in zip(operators, windows, strict=True)]
        target = np.concatenate([each.target(order) for each in windows])
        return cls([each.points for each in windows], operators), target

    def of(self, rates: Floats) -> Floats:
        """Return integrals of rates along the curves, shape (n, k), as they show in the measurements."""
        pairs = zip(self.points, self.operators, strict=True)
        with np.errstate(all="ignore"):
            return np.concatenate([own @ rates[points] for points, own in pairs])


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
                for points in np.array_split(np.arange(first, last), -(-(last - first) // settings.MAX_CURVE_POINTS)):
                    seen = np.flatnonzero(mesh.observed[points, equation])
                    at = points[seen]
                    own = mesh.times[points], seen, mesh.measured[at, equation], std[at]
                    found.append(cls(before + points, *own))
            before += len(mesh)
        return [found[i] for i in evenly_spaced(len(found), settings.MAX_WINDOWS)]

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


def with_steps(values: Floats) -> Floats:
    """Return values, and these with one after the other a little changed, shape (1 + values, values)."""
    return np.vstack([values, values + np.diag(settings.ROUNDING * _sizes(values))])


def closest(linearized: Callable[[Floats], tuple[Floats, Floats]], begin: Floats) -> Floats:
    """Return values near some that leave the least sum of squares, by Gauss-Newton steps.

    What is left and its derivatives by relative changes of the values are those that `projected` returns.
    """
    found, (here, slopes) = begin, linearized(begin)
    for _ in range(settings.MAX_SWEEPS):
        step = np.linalg.lstsq(slopes, -here, rcond=settings.MIN_SINGULAR_VALUE)[0] * _sizes(found)
        there = linearized(found + step)
        if not there[0] @ there[0] < here @ here:
            step = step / 4
            there = linearized(found + step)
        if not there[0] @ there[0] < here @ here:
            break
        found, (here, slopes) = found + step, there
    return found


def projected(target: Floats, columns: Floats) -> tuple[Floats, Floats]:
    """Return what columns leave of a target by least squares, and its derivatives by relative changes of values.

    Coefficients follow these (variable projection, as by Kaufman 1975). All is left, whatever the values are, where a
    column is not finite.

    Parameters
    ----------
    target
        Shape (n,).
    columns
        At the values and the others of `with_steps`, shape (1 + values, n, columns).
    """
    if not np.isfinite(columns).all():
        return target, np.zeros((len(target), len(columns) - 1))
    whole, norms = unit(columns[0])
    basis, sizes, turned = np.linalg.svd(whole, full_matrices=False)
    kept = sizes > settings.MIN_SINGULAR_VALUE * sizes[:1].sum()
    basis = basis[:, kept]
    inner = basis.T @ target
    found = np.divide(turned[kept].T @ (inner / sizes[kept]), norms, out=np.zeros(len(norms)), where=norms > 0)
    slopes = (columns[0] - columns[1:]) @ found / settings.ROUNDING
    return target - basis @ inner, slopes.T - basis @ (basis.T @ slopes.T)


def _sizes(values: Floats) -> Floats:
    return np.where(values != 0, values, 1.0)


def solved(columns: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Return coefficients of columns by least squares, and what is left: all where a column is not finite."""
    whole, norms = unit(columns)
    if not np.isfinite(norms).all():
        return np.zeros(len(norms)), target
    found = np.linalg.lstsq(whole, target, rcond=settings.MIN_SINGULAR_VALUE)[0]
    return found / np.where(norms > 0, norms, 1.0), target - whole @ found


def gains(inner: Floats, outside: Floats) -> Floats:
    """Return by how much columns lower the squares that others leave.

    From their inner products with what is left, and their squares outside of the others.
    """
    return np.asarray(np.where(outside > settings.COLLINEAR, inner**2 / np.maximum(outside, settings.COLLINEAR), 0.0))


def unit(columns: Floats) -> tuple[Floats, Floats]:
    """Return columns of unit norm, zero where they are not finite, and the norms that they had."""
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(columns, axis=0)
    usable = np.isfinite(norms) & (norms > 0)
    return np.divide(columns, norms, out=np.zeros_like(columns), where=usable), norms
