"""Which variables are confounded, before any law: whether laws in some of them fit as well as laws in others.

A trajectory is its start plus the integral of its law: ``x(t) = x(0) + sum of c_k times the integral of term k``, twice
over for laws of second order. With terms taken along smooth curves through the samples, what a law leaves of the
measurements is linear in its coefficients, no rate of the highest order is needed, and noise stays what it was (the
integral form of sparse regression; Schaeffer and McCalla 2017). Errors may be correlated in time.

Some variables suffice for an equation if no others have very strong evidence against them: the Bayesian information
criterion of the terms over them alone, with coefficients of each object's own, is within 10 of the best (Kass and
Raftery 1995). Where trials visit a single curve, variables are functions of each other on it, and there are several
smallest sets that suffice, none part of another: laws in the one and in the other fit equally well, and differ away
from the curve. As objects share their terms, one object that visits more separates them for all. Where trials of an
object differ by more than their noise, a variable may stand in for what makes them differ: the note is given where
evidence prefers laws whose coefficients differ from trial to trial."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain, combinations, product

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import SmoothingSpline
from commonlaw.errors import CommonlawError
from commonlaw.formulation import column_scales, law_variables
from commonlaw.inference import settings
from commonlaw.library import AbstractLibrary, Order, PolynomialLibrary, Terms, order_of_each, parse_library, with_rates
from commonlaw.trials import Trials
from commonlaw.trials.transformations import natural

Columns = tuple[int, ...]
"""Variables, by their columns."""


@dataclass(frozen=True)
class ConfoundedVariables:
    """Variables of which trials cannot tell which ones an equation is about.

    Parameters
    ----------
    state
        The state of the equation.
    sets
        The smallest sets of variables that suffice, each by itself.
    left
        What the terms over each set leave of the state, root mean square.
    left_by_all
        What all terms leave, with the same coefficients in all trials of an object.
    by_trial
        Whether that takes coefficients that differ from trial to trial.
    starts
        The least and the largest value that trials start from, of each variable in a set.
    visited
        The least and the largest value that they visit.
    """

    state: str
    sets: tuple[tuple[str, ...], ...]
    left: tuple[float, ...]
    left_by_all: float
    by_trial: bool
    starts: dict[str, tuple[float, float]]
    visited: dict[str, tuple[float, float]]


def confounded_sets(
    trials: Trials, order: Order, library: AbstractLibrary | str | None = None
) -> tuple[ConfoundedVariables, ...]:
    """Return the equations whose variables trials cannot tell apart.

    Parameters
    ----------
    trials
        What was measured.
    order
        Of the laws that are looked for, 1 or 2, or that of each equation.
    library
        Their candidate terms. Default: polynomials of degree 3, or of a lower one where trials have few samples.

    Raises `CommonlawError` if the library does not fit the variables.
    """
    with np.errstate(all="ignore"):
        return _confounded_sets(trials, order, parse_library(library) if isinstance(library, str) else library)


def _confounded_sets(trials: Trials, order: Order, given: AbstractLibrary | None) -> tuple[ConfoundedVariables, ...]:
    curves = _curves(trials, order)
    variables, states = law_variables(trials.schema, order), trials.schema.states
    orders = order_of_each(order, len(states))
    choices = [given] if given else [PolynomialLibrary(degree) for degree in (3, 2, 1)]
    for terms in (choice.bind(variables) for choice in choices):
        used = sorted(set().union(*(term.columns() for term in terms.terms)))
        if not 1 < len(used) <= settings.MAX_VARIABLES:
            continue
        forms = {n: _IntegralForm.of(curves, terms, n) for n in {*orders}}
        if all(form.objects for form in forms.values()):
            confounded = (_one_equation(forms[n], j, used, curves) for j, n in enumerate(orders))
            return tuple(variables_ for variables_ in confounded if variables_ is not None)
    return ()


@dataclass(frozen=True, eq=False)
class _Curve:
    """Variables along a smooth curve through a trial, shape (n, variables), and its measured states, (n, states)."""

    object: str
    times: Floats
    values: Floats
    states: Floats


def _curves(trials: Trials, order: Order) -> list[_Curve]:
    """Return smooth curves through the first samples, with all states, of trials of objects with many trials first."""
    curves, groups = list[_Curve](), sorted(map(trials.of_object, trials.objects), key=len, reverse=True)
    for trial in chain.from_iterable(groups):
        complete = np.asarray(np.isfinite(trial.states).all(axis=1))
        if not complete.any() or len(curves) == settings.MAX_OBJECTS:
            continue
        measured = trial if complete.all() else trial.rows(complete)
        if len(measured) > settings.MAX_CURVE_POINTS:
            measured = measured.cut(settings.MAX_CURVE_POINTS)
        states = natural(measured.states, trials.schema)
        try:
            rates = SmoothingSpline().differentiate(measured.times, states, 1)
        except CommonlawError:  # Too short
            continue
        of_rates = rates.derivatives[0][:, with_rates(order, states.shape[1])]
        values = np.column_stack([rates.states, of_rates, measured.inputs, measured.times])
        curves.append(_Curve(trial.object, measured.times - measured.times[0], values, states))
    return curves


@dataclass(frozen=True, eq=False)
class _Rows:
    """A trial's integrals of terms and its states, shape (n, terms + states), and what a start explains, (n, order)."""

    times: Floats
    values: Floats
    start: Floats

    @classmethod
    def of(cls, curve: _Curve, terms: Terms, order: int) -> "_Rows":
        """Return the integrals of the terms along a curve, and its states."""
        from scipy.interpolate import CubicSpline

        values = terms.evaluate(curve.values)
        if np.isfinite(values).all():
            values = CubicSpline(curve.times, values).antiderivative(order)(curve.times)
        start = np.vander(curve.times / curve.times[-1], order)
        return cls(curve.times, np.column_stack([values, curve.states]), start)

    @cached_property
    def without_start(self) -> Floats:
        """The values without what the start explains."""
        basis, _ = np.linalg.qr(self.start)
        return np.asarray(self.values - basis @ (basis.T @ self.values))

    def whitened(self, share: float, memory: float) -> "_Rows":
        """Return rows whose errors are independent."""
        from scipy.linalg import solve_triangular

        factor = correlation_factor(self.times.tobytes(), share, memory)
        values, start = (solve_triangular(factor, block, lower=True) for block in (self.values, self.start))
        return _Rows(self.times, values, start)


Left = Sequence[tuple[float, int]]
"""What some terms leave of each object, a sum of squares, and how many coefficients they have."""


@dataclass(frozen=True, eq=False)
class _IntegralForm:
    """Rows of each object's trials."""

    terms: Terms
    objects: tuple[tuple[_Rows, ...], ...]

    @classmethod
    def of(cls, curves: Sequence[_Curve], terms: Terms, order: int) -> "_IntegralForm":
        """Return the form of the objects that have samples for all terms."""
        objects = []
        for name in dict.fromkeys(curve.object for curve in curves):
            of_object = [curve for curve in curves if curve.object == name]
            if sum(len(curve.times) - order for curve in of_object) >= 2 * len(terms):
                rows = tuple(_Rows.of(curve, terms, order) for curve in of_object)
                if all(np.isfinite(row.values).all() for row in rows):
                    objects.append(rows)
        return cls(terms, tuple(objects))

    @cached_property
    def factors(self) -> list[list[Floats]]:
        """What a factorisation of each object's rows leaves, without their starts."""
        return [[np.asarray(np.linalg.qr(row.without_start, mode="r")) for row in rows] for rows in self.objects]

    @cached_property
    def free(self) -> Floats:
        """The number of samples that starts leave of each object."""
        return np.array([sum(len(row.times) - row.start.shape[1] for row in rows) for rows in self.objects], float)

    def over(self, variables: Sequence[int]) -> list[int]:
        """Return the terms over some variables alone."""
        return [k for k, term in enumerate(self.terms.terms) if set(term.columns()) <= set(variables)]

    def left(self, equation: int, over: Sequence[int], by_trial: bool = False) -> Left:
        """Return what some terms leave of each object."""
        column, found = len(self.terms) + equation, []
        for factors in self.factors:
            parts = factors if by_trial else [np.concatenate(factors)]
            fits = _fits([part[:, over] for part in parts], [part[:, column] for part in parts])
            found.append((sum(squares for squares, _ in fits), sum(size for _, size in fits)))
        return found

    def rms(self, residuals: Left) -> float:
        """Return the root mean square of what is left."""
        return float(np.sqrt(sum(squares for squares, _ in residuals) / self.free.sum()))

    def criterion(self, equation: int) -> Callable[[Left], float]:
        """Return what gives the Bayesian information criterion of what is left, comparable for one equation."""
        column = len(self.terms) + equation
        totals = [sum(float(r[:, column] @ r[:, column]) for r in factors) for factors in self.factors]
        floors = np.maximum(settings.ROUNDING**2 * np.array(totals), np.finfo(float).tiny)
        sizes = [size for _, size in self.left(equation, range(len(self.terms)))]
        freedom = np.maximum(self.free - sizes, np.e)

        def value(residuals: Left) -> float:
            squares, counts = np.array(residuals).T
            return float(np.sum(freedom * np.log(squares + floors) + counts * np.log(freedom)))

        return value

    def whitened(self, equation: int) -> "_IntegralForm":
        """Return the form in which errors of a state are independent, by the most probable memory of theirs.

        Errors are white noise and a part that is correlated in time, of the same share and memory in all trials; these
        are chosen by the restricted likelihood, which knows what all terms and the starts have taken.
        """
        errors = min(self._deviances, key=lambda rows: rows[1][equation])[0]
        if errors not in self._white:
            rows = tuple(tuple(row.whitened(*errors) for row in rows) for rows in self.objects)
            self._white[errors] = _IntegralForm(self.terms, rows) if errors[0] else self
        return self._white[errors]

    @cached_property
    def _white(self) -> "dict[tuple[float, float], _IntegralForm]":
        """Forms that were made already, by shares and memories of errors, as equations often have the same."""
        return {}

    @cached_property
    def _deviances(self) -> list[tuple[tuple[float, float], Floats]]:
        """Return minus twice the restricted log-likelihood of each equation by shares and memories of errors."""
        step = float(np.median(np.concatenate([np.diff(row.times) for rows in self.objects for row in rows])))
        memories = [step * steps for steps in settings.CORRELATION_TIMES]
        few = [rows[: settings.MAX_WINDOWS] for rows in self.objects[: settings.MAX_WINDOWS]]
        mixed = [(rows, self._mixture(rows)) for rows in few]
        return [
            (errors, np.sum([self._restricted_deviances(*pair, *errors) for pair in mixed], axis=0))
            for errors in [(0.0, step), *product(settings.CORRELATED_SHARES, memories)]
        ]

    def _mixture(self, rows: Sequence[_Rows]) -> Floats:
        """Return the mixture of terms that is orthonormal over an object's trials."""
        columns = np.concatenate([row.without_start[:, : len(self.terms)] for row in rows])
        scale = column_scales(columns)
        _, values, right = np.linalg.svd(columns / scale, full_matrices=False)
        kept = values > settings.MIN_SINGULAR_VALUE
        return np.asarray(right[kept].T / values[kept] / scale[:, np.newaxis])

    def _restricted_deviances(self, rows: Sequence[_Rows], mixture: Floats, share: float, memory: float) -> Floats:
        """Return minus twice the restricted log-likelihoods of an object's trials, given share and memory of errors."""
        white, count = [row.whitened(share, memory) for row in rows], len(self.terms)
        values = np.concatenate([row.without_start for row in white])
        basis, triangle = np.linalg.qr(values[:, :count] @ mixture)
        residuals = values[:, count:] - basis @ (basis.T @ values[:, count:])
        starts = [np.asarray(np.linalg.qr(row.start, mode="r")) for row in white]
        freedom = max(len(values) - sum(map(len, starts)) - len(triangle), 1)
        factors = [correlation_factor(row.times.tobytes(), share, memory) for row in rows]
        determinant = 2 * sum(float(np.sum(np.log(np.abs(np.diag(r))))) for r in (*starts, triangle, *factors))
        squares = np.maximum(np.sum(residuals**2, axis=0), np.finfo(float).tiny)
        return np.asarray(determinant + freedom * np.log(squares))


def _one_equation(
    form: _IntegralForm, equation: int, used: Sequence[int], curves: Sequence[_Curve]
) -> ConfoundedVariables | None:
    """Return the smallest sets of variables that suffice for an equation; None if there is one such set."""
    white = form.whitened(equation)
    criterion = white.criterion(equation)
    subsets = [subset for size in range(len(used) + 1) for subset in combinations(used, size)]

    def values(by_trial: bool) -> dict[Columns, float]:
        return {subset: criterion(white.left(equation, white.over(subset), by_trial)) for subset in subsets}

    together = values(by_trial=False)
    sets, by_trial = _smallest(together), False
    if len(sets) < 2 and any(len(rows) > 1 for rows in form.objects):
        apart = values(by_trial=True)
        by_trial = min(apart.values()) < min(together.values())
        sets = _smallest(apart) if by_trial else sets
    if len(sets) < 2:
        return None
    names, concerned = form.terms.variables.names, sorted(set().union(*sets))
    starts, visited = (
        {names[i]: (float(visited_values[:, i].min()), float(visited_values[:, i].max())) for i in concerned}
        for visited_values in (
            np.array([curve.values[0] for curve in curves]),
            np.concatenate([curve.values for curve in curves]),
        )
    )
    return ConfoundedVariables(
        form.terms.variables.states[equation],
        tuple(tuple(names[i] for i in subset) for subset in sets),
        tuple(form.rms(form.left(equation, form.over(subset), by_trial)) for subset in sets),
        form.rms(form.left(equation, form.over(used))),
        by_trial,
        starts,
        visited,
    )


def _smallest(values: Mapping[Columns, float]) -> list[Columns]:
    """Return the sets that suffice and hold no smaller one that does, given criteria of sets from small to large."""
    smallest: list[Columns] = []
    least = min(values.values())
    for subset, value in values.items():
        if value < least + settings.VERY_STRONG and not any(set(smaller) <= set(subset) for smaller in smallest):
            smallest.append(subset)
    return smallest


def _fits(columns: Sequence[Floats], targets: Sequence[Floats]) -> list[tuple[float, int]]:
    """Return the sum of squares that columns leave of a target, and their rank, of each trial."""
    if len({column.shape for column in columns}) > 1:
        return [fit for pair in zip(columns, targets, strict=True) for fit in _fits([pair[0]], [pair[1]])]
    scaled, aims = np.array([column / column_scales(column) for column in columns]), np.array(targets)
    bases, values, _ = np.linalg.svd(scaled, full_matrices=False)
    kept = values > settings.MIN_SINGULAR_VALUE
    bases = bases * kept[:, np.newaxis]
    residuals = aims - np.einsum("tnk,tk->tn", bases, np.einsum("tnk,tn->tk", bases, aims))
    squares = np.einsum("tn,tn->t", residuals, residuals)
    return list(zip(squares.tolist(), kept.sum(axis=1).tolist(), strict=True))


@lru_cache(maxsize=8)
def correlation_factor(times: bytes, share: float, memory: float) -> Floats:
    """Return the lower triangular factor of the errors' correlation at some times, shape (n, n)."""
    samples = np.frombuffer(times)
    correlated = np.exp(-np.abs(samples[:, np.newaxis] - samples) / memory)
    return np.asarray(np.linalg.cholesky((1 - share) * np.eye(len(correlated)) + share * correlated))
