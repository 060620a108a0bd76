"""Regression in the integral form: measured states on integrals of terms along estimated trajectories.

A solution of ``x' = sum of theta_k f_k(x)`` has measurements

    y_i = x_0 + sum of theta_k F_k(t_i) + e_i,    F_k(t) = integral of f_k(x(s)) over s from t_0 to t,

with a twofold integral and an initial rate for second order. With estimated states in f_k, theta follows by least
squares without derivatives (Dattner and Klaassen 2015; Schaeffer and McCalla 2017), and nonlinear parameters by a grid
search and Gauss-Newton steps on the variable projection.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from commonlaw.array_types import Floats, Indices, evenly_spaced
from commonlaw.inference import settings
from commonlaw.inference.fit.lack_of_fit import values_along
from commonlaw.inference.fit.parameter_grid import ParameterGrids, along
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.library import ParametricTerm, order_of_each
from commonlaw.likelihood import Estimate, Mesh
from commonlaw.runtime.checkpoint import checkpointed
from commonlaw.runtime.forking import cached_property


@dataclass(frozen=True, eq=False)
class CurveData:
    """Terms along the estimated trajectories of an object, by its index.

    Plain terms have no nonlinear parameters, shape (n, terms); parametric ones are on grids of these.
    """

    problem: SearchProblem
    index: int
    plain: Floats
    grids: ParameterGrids

    @classmethod
    def of(
        cls, problem: SearchProblem, index: int, estimate: Estimate, others: Sequence[ParametricTerm]
    ) -> "CurveData":
        terms, values = problem.models[index].terms, values_between_jumps(problem, index, estimate)
        sampled = np.concatenate([mesh.observed.any(axis=1) for mesh in problem.models[index].meshes])
        sampled = sampled[points_between_jumps(problem, index)]
        grids = ParameterGrids.along(terms.variables, values, others, sampled)
        return cls(problem, index, terms.evaluate(values), grids)

    def regression(self, equation: int) -> "IntegralRegression":
        """Return the regression of the measured state of an equation."""
        known = self.problem.known[self.index, equation]
        integrals, target = Integrals.and_target(self.problem, self.index, equation, self.grids.values)
        plain, norms = normalized(integrals.of(self.plain))
        target = target - plain @ (norms * np.nan_to_num(known))
        return IntegralRegression(
            target, plain, norms, normalized(integrals.of(self.grids.columns))[0], self.grids, integrals
        )


@dataclass(frozen=True, eq=False)
class IntegralRegression:
    """Regression of one object's measurements of a state on integrals of terms.

    The target are standardized measurements, projected orthogonally to free initial conditions, shape (n,). Integrals
    of plain terms, and of `others`, parametric terms at all grid values, are normalized, shape (n, columns). Integrals
    of parametric terms for forward differences about grid values are cached in `changed`.
    """

    target: Floats
    plain: Floats
    norms: Floats
    others: Floats
    grids: ParameterGrids
    integrals: "Integrals"
    changed: dict[tuple[int, int], Floats] = field(default_factory=dict, compare=False)

    @cached_property
    def squares(self) -> Floats:
        """Squared norms of the parametric columns: one, or zero where an integral vanishes."""
        return np.asarray(np.sum(self.others**2, axis=0))

    def columns_of(self, a: int) -> Floats:
        """Return the columns of one of the parametric terms."""
        return self.others[:, self._of(a)]

    def is_collinear(self, a: int) -> bool:
        """Return whether a parametric term is collinear with a plain one along the curves, as abs(x) for positive x."""
        columns = self.columns_of(a)
        return not columns.shape[1] or (
            not self.grids.others[a].parameters
            and bool(np.any(np.abs(self.plain.T @ columns) > 1 - settings.COLLINEAR))
        )

    def columns_at(self, others: Sequence[int], values: Sequence[int]) -> Floats:
        """Return one column of each of some parametric terms, by the indices of grid values, shape (n, others)."""
        return self.others[:, [self.grids.offsets[a] + i for a, i in zip(others, values, strict=True)]]

    def grid_search(self, plain: Sequence[int], others: Sequence[int]) -> tuple[int, ...]:
        """Return the indices of the grid values of least residual squares, by coordinate descent."""
        chosen, fixed = dict[int, int](), self.plain[:, list(plain)]
        for a in [*others] * len(others):
            if len(self.grids.parameters[a]) == 1:
                chosen[a] = 0
                continue
            chosen.pop(a, None)
            basis = np.linalg.qr(np.column_stack([fixed, self.columns_at([*chosen], [*chosen.values()])]))[0]
            columns, residuals = self.columns_of(a), self.target - basis @ (basis.T @ self.target)
            outside = self.squares[self._of(a)] - np.sum((basis.T @ columns) ** 2, axis=0)
            chosen[a] = int(np.argmax(rss_reductions(residuals @ columns, outside)))
        return tuple(chosen[a] for a in others)

    def _of(self, a: int) -> slice:
        return slice(self.grids.offsets[a], self.grids.offsets[a + 1])

    def fitted(
        self, plain: Sequence[int], others: Sequence[ParametricTerm], parameters: Sequence[Floats]
    ) -> tuple[Floats, Floats]:
        """Return least-squares coefficients, plain terms first, and residuals, given nonlinear parameters.

        With a term that is not finite, coefficients are zero.
        """
        columns = self._integrated(others, [parameter[np.newaxis] for parameter in parameters])
        return least_squares(
            np.column_stack([self.plain[:, list(plain)] * self.norms[list(plain)], *columns]), self.target
        )

    def linearized_rss(self, plain: Sequence[int], others: Sequence[int], indices: Sequence[int]) -> float:
        """Return the residual sum of squares after one Gauss-Newton step from grid values."""
        for a, i in zip(others, indices, strict=True):
            if (a, i) not in self.changed:
                (self.changed[a, i],) = self._changed([a], [self.grids.parameters[a][i]])
        columns = [self.changed[pair] for pair in zip(others, indices, strict=True)]
        residuals, slopes = self._projected(plain, columns)
        residuals = residuals - slopes @ np.linalg.lstsq(slopes, residuals, rcond=settings.MIN_SINGULAR_VALUE)[0]
        return float(residuals @ residuals)

    @checkpointed
    def refined(self, plain: Sequence[int], others: Sequence[int], indices: Sequence[int]) -> tuple[Floats, ...]:
        """Return the parameters of least residual squares near grid values, by Gauss-Newton steps."""
        initial = [self.grids.parameters[a][i] for a, i in zip(others, indices, strict=True)]
        if not any(map(len, initial)):
            return tuple(initial)
        cuts = np.cumsum([len(theta) for theta in initial])[:-1]
        optimum = gauss_newton(
            lambda values: self._projected(plain, self._changed(others, np.split(values, cuts))),
            np.concatenate(initial),
        )
        return tuple(np.split(optimum, cuts))

    def _changed(self, others: Sequence[int], parameters: Sequence[Floats]) -> list[Floats]:
        """Return integrals of parametric terms at parameters and at forward differences of each."""
        return self._integrated(
            [self.grids.others[a] for a in others], [forward_difference_points(parameter) for parameter in parameters]
        )

    def _projected(self, plain: Sequence[int], columns: Sequence[Floats]) -> tuple[Floats, Floats]:
        """Return the `variable_projection` of plain terms with the columns of `_changed`."""
        here = np.column_stack([self.plain[:, list(plain)], *(column[:, 0] for column in columns)])
        counts = [column.shape[1] - 1 for column in columns]
        whole, step = np.repeat(here[np.newaxis], 1 + sum(counts), axis=0), 1
        for place, (column, count) in enumerate(zip(columns, counts, strict=True), len(plain)):
            whole[step : step + count, :, place] = column[:, 1:].T
            step += count
        return variable_projection(self.target, whole)

    def _integrated(self, others: Sequence[ParametricTerm], grids: Sequence[Floats]) -> list[Floats]:
        """Return integrals of terms at values of their parameters, each of shape (n, values)."""
        if not others:
            return []
        columns = [along(term, self.grids.values, grid) for term, grid in zip(others, grids, strict=True)]
        whole = self.integrals.of(np.concatenate(columns, axis=1))
        return np.split(whole, np.cumsum([len(bank) for bank in grids])[:-1], axis=1)


@dataclass(frozen=True, eq=False)
class Integrals:
    """Linear operators from rates at points to standardized integrals at measurements, in windows along curves.

    Points are indices of `points_between_jumps`. The operator of each window, shape (measurements, points), has
    integrals of cardinal cubic splines, projected orthogonally to free initial conditions.
    """

    points: Sequence[Indices]
    operators: Sequence[Floats]

    @classmethod
    def and_target(
        cls, problem: SearchProblem, index: int, equation: int, values: Floats
    ) -> "tuple[Integrals, Floats]":
        """Return the operators of an object's equation, and the standardized measurements of its state, shape (n,).

        Measurements are projected orthogonally to free initial conditions, in evenly spaced windows. The variables are
        those of `values_between_jumps`.
        """
        model, windows, before = problem.models[index], list[tuple[Mesh, int, Indices]](), 0
        every = points_between_jumps(problem, index)
        variables, order = model.terms.variables, order_of_each(model.order, model.equations)[equation]
        for mesh in model.meshes:
            for part in np.split(np.arange(len(mesh)), np.flatnonzero(~mesh.contiguous) + 1):
                count = -(-len(part) // settings.MAX_CURVE_POINTS)
                windows += [(mesh, before, points) for points in np.array_split(part, count)]
            before += len(mesh)
        indices, operators, targets = list[Indices](), list[Floats](), list[Floats]()
        for mesh, before, points in (windows[i] for i in evenly_spaced(len(windows), settings.MAX_WINDOWS)):
            measured = points[mesh.observed[points, equation]]
            std = problem.std_of(mesh)[measured, equation]
            first, last = np.searchsorted(every, before + points[0], "right") - 1, before + points[-1]
            window = np.arange(first, np.searchsorted(every, last) + 1)
            times, at = mesh.times[every[window] - before], np.searchsorted(every[window], before + measured)
            rows = integrated(times, np.eye(len(times)), order)[at]  # Cardinal splines
            if variables.states[equation] in variables.logarithmic:
                rows = rows / values[window, equation]
            rows = np.column_stack([rows, mesh.measured[measured, equation]]) / std[:, np.newaxis]
            initial = np.vander((times - times[0])[at], order, increasing=True) / std[:, np.newaxis]
            rows = outside_span(initial, rows)
            indices.append(window)
            operators.append(rows[:, :-1])
            targets.append(rows[:, -1])
        return cls(indices, operators), np.concatenate(targets)

    def of(self, rates: Floats) -> Floats:
        """Return the standardized integrals of rates along the curves, shape (n, k)."""
        pairs = zip(self.points, self.operators, strict=True)
        with np.errstate(all="ignore"):
            return np.concatenate([operator @ rates[points] for points, operator in pairs])


def points_between_jumps(problem: SearchProblem, index: int) -> Indices:
    """Return the points of an object's curves, by their index, those at which a held input jumps twice."""
    jumps = np.concatenate([mesh.jumps for mesh in problem.models[index].meshes])
    return np.repeat(np.arange(len(jumps)), 1 + jumps)


def values_between_jumps(problem: SearchProblem, index: int, estimate: Estimate) -> Floats:
    """Return the variables along estimated states, before and after jumps of inputs, shape (n, variables)."""
    values, points = values_along(problem, index, estimate), points_between_jumps(problem, index)
    model, result = problem.models[index], values[points]
    before, inputs = np.flatnonzero(np.diff(points) == 0), slice(model.width, result.shape[1] - 1)
    result[before, inputs] = values[points[before] - 1, inputs]
    return result


def integrated(times: Floats, rates: Floats, order: int) -> Floats:
    """Return rates at times, shape (n, columns), integrated `order` times from the first time, by cubic splines.

    Where a time is there twice, rates jump.
    """
    from scipy.interpolate import CubicSpline

    below = np.zeros((order, rates.shape[1]))  # Of the integral and its derivatives where a part begins
    result = np.empty_like(rates)
    for part in np.split(np.arange(len(times)), np.flatnonzero(np.diff(times) == 0) + 1):
        elapsed = times[part] - times[part[0]]
        powers = np.vander(elapsed, order, increasing=True) / np.cumprod([1, *range(1, order)])
        integrals = [np.zeros_like(rates[part])] * (order + 1)
        if len(part) > 1:
            spline = CubicSpline(times[part], rates[part])
            integrals = [spline.antiderivative(times_integrated)(times[part]) for times_integrated in range(order + 1)]
        result[part] = integrals[order] + powers @ below
        ends = [integrals[order - m][-1] + powers[-1, : order - m] @ below[m:] for m in range(order)]
        below = np.array(ends)
    return result


def outside_span(columns: Floats, values: Floats) -> Floats:
    """Return values, shape (n, k), projected orthogonally to columns."""
    basis = np.linalg.qr(columns)[0]
    return np.asarray(values - basis @ (basis.T @ values))


def forward_difference_points(values: Floats) -> Floats:
    """Return values, and for each of them all with a relative increment of this one, shape (1 + values, values)."""
    return np.vstack([values, values + np.diag(settings.ROUNDING * _sizes(values))])


def gauss_newton(linearized: Callable[[Floats], tuple[Floats, Floats]], initial: Floats) -> Floats:
    """Return the values of least sum of squares, by damped Gauss-Newton steps.

    Residuals and their derivatives by relative changes of the values are those of `variable_projection`.
    """
    theta, (here, slopes) = initial, linearized(initial)
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


def variable_projection(target: Floats, columns: Floats) -> tuple[Floats, Floats]:
    """Return least-squares residuals, and their derivatives by relative changes of nonlinear parameters.

    With columns Phi(p), P = Phi Phi^+ and coefficients theta = Phi^+ y, residuals are ``(1 - P) y`` and derivatives
    ``-(1 - P) (dPhi/dp) theta`` (variable projection; Kaufman 1975). They are y and zero if a column is not finite.
    Columns are those at the `forward_difference_points`, shape (1 + values, n, columns).
    """
    if not np.isfinite(columns).all():
        return target, np.zeros((len(target), len(columns) - 1))
    whole, norms = normalized(columns[0])
    basis, sizes, turned = np.linalg.svd(whole, full_matrices=False)
    kept = sizes > settings.MIN_SINGULAR_VALUE * sizes[:1].sum()
    basis = basis[:, kept]
    inner = basis.T @ target
    coefficients = np.divide(turned[kept].T @ (inner / sizes[kept]), norms, out=np.zeros(len(norms)), where=norms > 0)
    slopes = (columns[0] - columns[1:]) @ coefficients / settings.ROUNDING
    return target - basis @ inner, slopes.T - basis @ (basis.T @ slopes.T)


def _sizes(values: Floats) -> Floats:
    return np.where(values != 0, values, 1.0)


def least_squares(columns: Floats, target: Floats) -> tuple[Floats, Floats]:
    """Return least-squares coefficients and residuals; zero and the target if a column is not finite."""
    whole, norms = normalized(columns)
    if not np.isfinite(norms).all():
        return np.zeros(len(norms)), target
    coefficients = np.linalg.lstsq(whole, target, rcond=settings.MIN_SINGULAR_VALUE)[0]
    return coefficients / np.where(norms > 0, norms, 1.0), target - whole @ coefficients


def rss_reductions(inner: Floats, outside: Floats) -> Floats:
    """Return the reductions ``(r' x)^2 / |x_perp|^2`` of the residual sum of squares by additional columns x.

    `inner` are the products r' x, and `outside` the squared norms of x orthogonal to the present columns.
    """
    return np.asarray(np.where(outside > settings.COLLINEAR, inner**2 / np.maximum(outside, settings.COLLINEAR), 0.0))


def normalized(columns: Floats) -> tuple[Floats, Floats]:
    """Return columns, shape (..., n, columns), over their norms, zero where these are not finite, and the norms."""
    with np.errstate(over="ignore"):
        norms = np.linalg.norm(columns, axis=-2)
    usable = np.isfinite(norms) & (norms > 0)
    sizes = np.where(usable, norms, 1.0)[..., np.newaxis, :]
    return np.divide(columns, sizes, out=np.zeros_like(columns), where=usable[..., np.newaxis, :]), norms
