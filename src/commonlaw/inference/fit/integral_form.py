"""Measurements of a state against integrals of terms along curves that are near the true ones.

If ``x' = f(x)``, measurements of x are a start, plus the integral of f along the true curve, plus noise. With states
near the true ones in f, coefficients are found by least squares on integrals, without a derivative (Dattner and
Klaassen 2015), and parameters inside terms from a bank of values.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from commonlaw.array_types import Floats, Indices, evenly_spaced
from commonlaw.inference import settings
from commonlaw.inference.fit.lack_of_fit import values_along
from commonlaw.inference.fit.parameter_grid import ParameterGrids, along
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.library import ParametricTerm, order_of_each
from commonlaw.likelihood import Estimate, Mesh


@dataclass(frozen=True, eq=False)
class CurveData:
    """An object's curves, and terms along them.

    Parameters
    ----------
    problem, index
        What was measured, and which object it is.
    plain
        Plain terms, shape (n, terms).
    banks
        Terms with parameters inside.
    """

    problem: SearchProblem
    index: int
    plain: Floats
    banks: ParameterGrids

    @classmethod
    def of(
        cls, problem: SearchProblem, index: int, estimate: Estimate, others: Sequence[ParametricTerm]
    ) -> "CurveData":
        """Return the curves of an object along its estimated states."""
        terms, values = problem.models[index].terms, values_along(problem, index, estimate)
        sampled = np.concatenate([mesh.observed.any(axis=1) for mesh in problem.models[index].meshes])
        banks = ParameterGrids.along(terms.variables, values, others, sampled)
        return cls(problem, index, terms.evaluate(values), banks)

    def match(self, equation: int) -> "IntegralRegression":
        """Return the measurements of the state of an equation against integrals along these curves."""
        known = self.problem.known[self.index, equation]
        integrals, target = Integrals.and_target(self.problem, self.index, equation, self.banks.values)
        plain, norms = unit(integrals.of(self.plain))
        target = target - plain @ (norms * np.nan_to_num(known))
        return IntegralRegression(
            target, plain, norms, unit(integrals.of(self.banks.columns))[0], self.banks, integrals
        )


@dataclass(frozen=True, eq=False)
class IntegralRegression:
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
    changed
        Integrals of the others at values in banks and a little changed ones, as far as they were asked for.
    """

    target: Floats
    plain: Floats
    norms: Floats
    others: Floats
    banks: ParameterGrids
    integrals: "Integrals"
    changed: dict[tuple[int, int], Floats] = field(default_factory=dict)

    @cached_property
    def squares(self) -> Floats:
        """The squares of the norms of the others: one, or zero where an integral vanishes."""
        return np.asarray(np.sum(self.others**2, axis=0))

    def columns_of(self, a: int) -> Floats:
        """Return the columns of one of the others, by its index."""
        return self.others[:, self._of(a)]

    def places_of(self, others: Sequence[int]) -> tuple[Indices, Indices]:
        """Return the columns of some of the others, by their indices, and how many each of them has."""
        places = [
            np.empty(0, dtype=np.intp),
            *(np.arange(columns.start, columns.stop) for columns in map(self._of, others)),
        ]
        return np.concatenate(places), np.array([*map(len, places[1:])], dtype=np.intp)

    def repeats(self, a: int) -> bool:
        """Return whether one of the others is along the curves what a plain term is, as abs(x) where x is positive."""
        columns = self.columns_of(a)
        return not columns.shape[1] or (
            not self.banks.others[a].parameters
            and bool(np.any(np.abs(self.plain.T @ columns) > 1 - settings.COLLINEAR))
        )

    def columns_at(self, others: Sequence[int], values: Sequence[int]) -> Floats:
        """Return the columns of some of the others, each at a value by its index in its bank, shape (n, others)."""
        return self.others[:, [self.banks.firsts[a] + i for a, i in zip(others, values, strict=True)]]

    def best_values(self, plain: Sequence[int], others: Sequence[int]) -> tuple[int, ...]:
        """Return the values of the others that leave least, by their indices in banks, found in turn."""
        chosen, fixed = dict[int, int](), self.plain[:, list(plain)]
        for a in [*others] * len(others):
            if len(self.banks.parameters[a]) == 1:
                chosen[a] = 0
                continue
            chosen.pop(a, None)
            basis = np.linalg.qr(np.column_stack([fixed, self.columns_at([*chosen], [*chosen.values()])]))[0]
            columns, residuals = self.columns_of(a), self.target - basis @ (basis.T @ self.target)
            outside = self.squares[self._of(a)] - np.sum((basis.T @ columns) ** 2, axis=0)
            chosen[a] = int(np.argmax(gains(residuals @ columns, outside)))
        return tuple(chosen[a] for a in others)

    def _of(self, a: int) -> slice:
        return slice(self.banks.firsts[a], self.banks.firsts[a + 1])

    def fitted(
        self, plain: Sequence[int], others: Sequence[ParametricTerm], parameters: Sequence[Floats]
    ) -> tuple[Floats, Floats]:
        """Return coefficients by least squares, plain terms first, and what is left of the target.

        The others are any terms with these parameters. All is left where a term is not finite.
        """
        columns = self._integrated(others, [parameter[np.newaxis] for parameter in parameters])
        return solved(np.column_stack([self.plain[:, list(plain)] * self.norms[list(plain)], *columns]), self.target)

    def linearized_rss(self, plain: Sequence[int], others: Sequence[int], indices: Sequence[int]) -> float:
        """Return the least sum of squares to first order about values of the parameters in banks."""
        for a, i in zip(others, indices, strict=True):
            if (a, i) not in self.changed:
                (self.changed[a, i],) = self._changed([a], [self.banks.parameters[a][i]])
        columns = [self.changed[pair] for pair in zip(others, indices, strict=True)]
        residuals, slopes = self._projected(plain, columns)
        residuals = residuals - slopes @ np.linalg.lstsq(slopes, residuals, rcond=settings.MIN_SINGULAR_VALUE)[0]
        return float(residuals @ residuals)

    def closest(self, plain: Sequence[int], others: Sequence[int], indices: Sequence[int]) -> tuple[Floats, ...]:
        """Return the parameters of terms that leave least, near those in banks."""
        begin = [self.banks.parameters[a][i] for a, i in zip(others, indices, strict=True)]
        if not any(map(len, begin)):
            return tuple(begin)
        cuts = np.cumsum([len(theta) for theta in begin])[:-1]
        optimum = closest(
            lambda values: self._projected(plain, self._changed(others, np.split(values, cuts))), np.concatenate(begin)
        )
        return tuple(np.split(optimum, cuts))

    def _changed(self, others: Sequence[int], parameters: Sequence[Floats]) -> list[Floats]:
        """Return integrals of the others at parameters, and with one after the other of these a little changed."""
        return self._integrated(
            [self.banks.others[a] for a in others], [with_steps(parameter) for parameter in parameters]
        )

    def _projected(self, plain: Sequence[int], columns: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Return what plain terms and the first of each of some columns leave, and its derivatives by the others."""
        here = np.column_stack([self.plain[:, list(plain)], *(column[:, 0] for column in columns)])
        counts = [column.shape[1] - 1 for column in columns]
        whole, step = np.repeat(here[np.newaxis], 1 + sum(counts), axis=0), 1
        for place, (column, count) in enumerate(zip(columns, counts, strict=True), len(plain)):
            whole[step : step + count, :, place] = column[:, 1:].T
            step += count
        return projected(self.target, whole)

    def _integrated(self, others: Sequence[ParametricTerm], banks: Sequence[Floats]) -> list[Floats]:
        """Return integrals of some terms at some values of their parameters, shape (n, values) each."""
        if not others:
            return []
        columns = [along(each, self.banks.values, bank) for each, bank in zip(others, banks, strict=True)]
        whole = self.integrals.of(np.concatenate(columns, axis=1))
        return np.split(whole, np.cumsum([len(bank) for bank in banks])[:-1], axis=1)


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

        Relative to its noise, without what free starts (and rates there) explain, in windows that are evenly spread.
        Values of all variables along the curves have the shape (points, variables).
        """
        from scipy.interpolate import CubicSpline

        model, windows, before = problem.models[index], list[tuple[Mesh, int, Indices]](), 0
        variables, order = model.terms.variables, order_of_each(model.order, model.equations)[equation]
        for mesh in model.meshes:
            for part in np.split(np.arange(len(mesh)), np.flatnonzero(~mesh.contiguous) + 1):
                count = -(-len(part) // settings.MAX_CURVE_POINTS)
                windows += [(mesh, before, points) for points in np.array_split(part, count)]
            before += len(mesh)
        places, operators, targets = list[Indices](), list[Floats](), list[Floats]()
        for mesh, before, points in (windows[i] for i in evenly_spaced(len(windows), settings.MAX_WINDOWS)):
            observed, times = mesh.observed[points, equation], mesh.times[points]
            std = problem.std_of(mesh)[points[observed], equation]
            # Integrals, twice for a second order, of splines that are one at a point
            rows = CubicSpline(times, np.eye(len(times))).antiderivative(order)(times[observed])
            if variables.states[equation] in variables.logarithmic:
                rows = rows / values[before + points, equation]
            rows = np.column_stack([rows, mesh.measured[points[observed], equation]]) / std[:, np.newaxis]
            elapsed = (times - times[0])[observed]
            basis = np.linalg.qr(np.column_stack([elapsed**k / std for k in range(order)]))[0]
            rows = rows - basis @ (basis.T @ rows)
            places.append(before + points)
            operators.append(rows[:, :-1])
            targets.append(rows[:, -1])
        return cls(places, operators), np.concatenate(targets)

    def of(self, rates: Floats) -> Floats:
        """Return integrals of rates along the curves, shape (n, k), as they show in the measurements."""
        pairs = zip(self.points, self.operators, strict=True)
        with np.errstate(all="ignore"):
            return np.concatenate([operator @ rates[points] for points, operator in pairs])


def with_steps(values: Floats) -> Floats:
    """Return values, and these with one after the other a little changed, shape (1 + values, values)."""
    return np.vstack([values, values + np.diag(settings.ROUNDING * _sizes(values))])


def closest(linearized: Callable[[Floats], tuple[Floats, Floats]], begin: Floats) -> Floats:
    """Return values near some that leave the least sum of squares, by Gauss-Newton steps.

    What is left and its derivatives by relative changes of the values are those that `projected` returns.
    """
    theta, (here, slopes) = begin, linearized(begin)
    for _ in range(settings.MAX_SWEEPS):
        step = np.linalg.lstsq(slopes, -here, rcond=settings.MIN_SINGULAR_VALUE)[0] * _sizes(theta)
        there = linearized(theta + step)
        if not there[0] @ there[0] < here @ here:
            step = step / 4
            there = linearized(theta + step)
        if not there[0] @ there[0] < here @ here:
            break
        theta, (here, slopes) = theta + step, there
    return theta


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
    coefficients = np.divide(turned[kept].T @ (inner / sizes[kept]), norms, out=np.zeros(len(norms)), where=norms > 0)
    slopes = (columns[0] - columns[1:]) @ coefficients / settings.ROUNDING
    return target - basis @ inner, slopes.T - basis @ (basis.T @ slopes.T)


def _sizes(values: Floats) -> Floats:
    return np.where(values != 0, values, 1.0)


def solved(columns: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Return coefficients of columns by least squares, and what is left: all where a column is not finite."""
    whole, norms = unit(columns)
    if not np.isfinite(norms).all():
        return np.zeros(len(norms)), target
    coefficients = np.linalg.lstsq(whole, target, rcond=settings.MIN_SINGULAR_VALUE)[0]
    return coefficients / np.where(norms > 0, norms, 1.0), target - whole @ coefficients


def gains(inner: Floats, outside: Floats) -> Floats:
    """Return by how much columns lower the squares that others leave.

    From their inner products with what is left, and their squares outside of the others.
    """
    return np.asarray(np.where(outside > settings.COLLINEAR, inner**2 / np.maximum(outside, settings.COLLINEAR), 0.0))


def unit(columns: Floats) -> tuple[Floats, Floats]:
    """Return columns of unit norm, shape (..., n, columns), zero where they are not finite, and the norms they had."""
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(columns, axis=-2)
    usable = np.isfinite(norms) & (norms > 0)
    sizes = np.where(usable, norms, 1.0)[..., np.newaxis, :]
    return np.divide(columns, sizes, out=np.zeros_like(columns), where=usable[..., np.newaxis, :]), norms
