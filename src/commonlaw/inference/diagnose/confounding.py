"""Confounded variables, before any law: sets of variables over which laws fit equally well.

Terms over subsets of the variables are compared in the integral form (see `integral_form`), without rates of the
highest order. Errors may be autocorrelated: white noise with a share of exponentially correlated errors, selected by
restricted maximum likelihood.

A subset suffices for an equation if the Bayesian information criterion of the terms over it, with object-specific
coefficients, is within 10 of the best (Kass and Raftery 1995). Several minimal sufficient subsets are confounded: where
trials visit a single curve, variables are functions of each other on it, and laws in them differ only off the curve. As
objects share their terms, one object with other trials separates them for all. A variable may also stand for
differences between the trials of an object: if coefficients that differ between trials have the smaller criterion, the
comparison is made with these.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import chain, combinations, product

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.differentiation import SmoothingSpline
from commonlaw.errors import CommonlawError
from commonlaw.formulation import column_scales, law_variables
from commonlaw.inference import settings
from commonlaw.inference.fit.integral_form import integrated, outside_span
from commonlaw.library import Order, PolynomialLibrary, Terms, order_of_each, parse_library, with_rates
from commonlaw.library.libraries import LibraryGiven
from commonlaw.runtime.forking import cached_property
from commonlaw.trials import Trials
from commonlaw.trials.transformations import natural

Columns = tuple[int, ...]
"""Variables, by their columns."""


@dataclass(frozen=True)
class ConfoundedVariables:
    """The confounded variables of the equation of a state: its minimal sufficient sets of variables.

    `rms` are root mean square residuals of the state for the terms over each set, and `rms_of_all` that for all terms,
    with coefficients common to the trials of an object. With `by_trial`, sets suffice only with coefficients that
    differ between trials. Each variable in a set has the range of its initial values, and of all it visited.
    """

    state: str
    sets: tuple[tuple[str, ...], ...]
    rms: tuple[float, ...]
    rms_of_all: float
    by_trial: bool
    starts: dict[str, tuple[float, float]]
    visited: dict[str, tuple[float, float]]


@np.errstate(all="ignore")
def confounded_sets(
    trials: Trials, order: Order, library: LibraryGiven | None = None
) -> tuple[ConfoundedVariables, ...]:
    """Return the confounded variables of each equation that has any, in laws of order 1 or 2.

    Without a library, terms are polynomials of degree 3, or of the highest degree for which trials have enough samples.

    Raises `CommonlawError` if the library does not fit the variables.
    """
    given = None if library is None else parse_library(library)
    variables, states = law_variables(trials.schema, order), trials.schema.states
    orders = order_of_each(order, len(states))
    if given is None and len(variables.states) + len(variables.inputs) > settings.MAX_VARIABLES:
        return ()
    choices = [given] if given else [PolynomialLibrary(degree) for degree in (3, 2, 1)]
    offered = [choice.bind(replace(variables, functions=choice.functions)) for choice in choices]
    columns = [sorted(set().union(*(term.columns() for term in terms.terms))) for terms in offered]
    usable = [pair for pair in zip(offered, columns, strict=True) if 1 < len(pair[1]) <= settings.MAX_VARIABLES]
    curves = _curves(trials, order) if usable else []
    for terms, used in usable:
        forms = {n: _IntegralForm.of(curves, terms, n) for n in {*orders}}
        if all(form.objects for form in forms.values()):
            confounded = (_one_equation(forms[n], j, used, curves) for j, n in enumerate(orders))
            return tuple(row for row in confounded if row is not None)
    return ()


@dataclass(frozen=True, eq=False)
class _Curve:
    """Variables along a smooth curve through a trial, shape (n, variables), and its measured states, (n, states)."""

    object: str
    times: Floats
    values: Floats
    states: Floats


def _curves(trials: Trials, order: Order) -> list[_Curve]:
    """Return smoothed trials, those of objects with many trials first, of their first samples with all states."""
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
    """A trial's integrals of terms and its states, (n, terms + states), and the columns of initial conditions."""

    times: Floats
    values: Floats
    start: Floats

    @classmethod
    def of(cls, curve: _Curve, terms: Terms, order: int) -> "_Rows":
        """Return the integrals of the terms along a curve, and its states."""
        values = terms.evaluate(curve.values)
        if np.isfinite(values).all():
            values = integrated(curve.times, values, order)
        start = np.vander(curve.times / curve.times[-1], order)
        return cls(curve.times, np.column_stack([values, curve.states]), start)

    @cached_property
    def without_start(self) -> Floats:
        """The values, projected orthogonally to the initial conditions."""
        return outside_span(self.start, self.values)

    def whitened(self, share: float, memory: float) -> "_Rows":
        """Return rows with independent errors, ``L^-1`` times these, for the correlation matrix L L' of errors."""
        from scipy.linalg import solve_triangular

        factor = correlation_factor(self.times.tobytes(), share, memory)
        values, start = (solve_triangular(factor, block, lower=True) for block in (self.values, self.start))
        return _Rows(self.times, values, start)


Fits = Sequence[tuple[float, int]]
"""Residual sum of squares and number of coefficients of each object."""


@dataclass(frozen=True, eq=False)
class _IntegralForm:
    """Rows of each object's trials; `white` caches forms by shares and memories of errors, often equal in equations."""

    terms: Terms
    objects: tuple[tuple[_Rows, ...], ...]
    white: "dict[tuple[float, float], _IntegralForm]" = field(default_factory=dict)

    @classmethod
    def of(cls, curves: Sequence[_Curve], terms: Terms, order: int) -> "_IntegralForm":
        """Return the form of the objects with at least two samples for each term."""
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
        """The triangular factors of each object's trials, without initial conditions."""
        return [[np.asarray(np.linalg.qr(row.without_start, mode="r")) for row in rows] for rows in self.objects]

    @cached_property
    def free(self) -> Floats:
        """The number of samples less initial conditions of each object."""
        return np.array([sum(len(row.times) - row.start.shape[1] for row in rows) for rows in self.objects], float)

    def over(self, variables: Sequence[int]) -> list[int]:
        """Return the indices of the terms that depend on these variables only."""
        return [k for k, term in enumerate(self.terms.terms) if set(term.columns()) <= set(variables)]

    def fits(self, equation: int, over: Sequence[int], by_trial: bool = False) -> Fits:
        """Return the fits of some terms to each object, by trial or with coefficients common to its trials."""
        column, listed = len(self.terms) + equation, []
        for factors in self.factors:
            parts = factors if by_trial else [np.concatenate(factors)]
            fits = _fits([part[:, over] for part in parts], [part[:, column] for part in parts])
            listed.append((sum(squares for squares, _ in fits), sum(size for _, size in fits)))
        return listed

    def rms(self, fits: Fits) -> float:
        return float(np.sqrt(sum(squares for squares, _ in fits) / self.free.sum()))

    def criterion(self, equation: int) -> Callable[[Fits], float]:
        """Return the function from fits of an equation to their Bayesian information criterion.

        It is the sum over objects of ``nu log R + k log nu`` with the degrees of freedom nu of the fit of all terms.
        """
        column = len(self.terms) + equation
        totals = [sum(float(r[:, column] @ r[:, column]) for r in factors) for factors in self.factors]
        floors = np.maximum(settings.ROUNDING**2 * np.array(totals), np.finfo(float).tiny)
        sizes = [size for _, size in self.fits(equation, range(len(self.terms)))]
        freedom = np.maximum(self.free - sizes, np.e)

        def value(fits: Fits) -> float:
            squares, counts = np.array(fits).T
            return float(np.sum(freedom * np.log(squares + floors) + counts * np.log(freedom)))

        return value

    def whitened(self, equation: int) -> "_IntegralForm":
        """Return the form with independent errors of a state.

        The share and the correlation time of autocorrelated errors are those of largest restricted likelihood, given
        all terms and free initial conditions.
        """
        errors = min(self._deviances, key=lambda rows: rows[1][equation])[0]
        if errors not in self.white:
            rows = tuple(tuple(row.whitened(*errors) for row in rows) for rows in self.objects)
            self.white[errors] = _IntegralForm(self.terms, rows) if errors[0] else self
        return self.white[errors]

    @cached_property
    def _deviances(self) -> list[tuple[tuple[float, float], Floats]]:
        """Return minus twice the restricted log-likelihood of each equation by shares and memories of errors."""
        step = float(np.median(np.concatenate([np.diff(row.times) for rows in self.objects for row in rows])))
        memories = [2 * step, 5 * step, 15 * step]
        mixed, count = list[tuple[Sequence[_Rows], Floats]](), len(self.terms)
        for rows in (rows[: settings.MAX_WINDOWS] for rows in self.objects[: settings.MAX_WINDOWS]):
            columns = np.concatenate([row.without_start[:, :count] for row in rows])
            scale = column_scales(columns)
            _, values, right = np.linalg.svd(columns / scale, full_matrices=False)
            kept = values > settings.MIN_SINGULAR_VALUE
            # The mixture of terms that is orthonormal over an object's trials
            mixed.append((rows, np.asarray(right[kept].T / values[kept] / scale[:, np.newaxis])))
        return [
            (errors, np.sum([self._restricted_deviances(*pair, *errors) for pair in mixed], axis=0))
            for errors in [(0.0, step), *product((0.2, 0.4, 0.6, 0.8, 0.95), memories)]
        ]

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
    """Return the minimal sufficient sets of variables of an equation; None if there is only one."""
    white = form.whitened(equation)
    criterion = white.criterion(equation)
    subsets = [subset for size in range(len(used) + 1) for subset in combinations(used, size)]

    def values(by_trial: bool) -> dict[Columns, float]:
        return {subset: criterion(white.fits(equation, white.over(subset), by_trial)) for subset in subsets}

    together = values(by_trial=False)
    sets, by_trial = _smallest(together), False
    if len(sets) < 2 and any(len(rows) > 1 for rows in form.objects):
        apart = values(by_trial=True)
        by_trial = min(apart.values()) < min(together.values())
        sets = _smallest(apart) if by_trial else sets
    if len(sets) < 2:
        return None
    names, concerned = form.terms.variables.names, sorted(set().union(*sets))
    blocks = np.array([curve.values[0] for curve in curves]), np.concatenate([curve.values for curve in curves])
    starts, visited = (
        {names[i]: (float(block[:, i].min()), float(block[:, i].max())) for i in concerned} for block in blocks
    )
    return ConfoundedVariables(
        form.terms.variables.states[equation],
        tuple(tuple(names[i] for i in subset) for subset in sets),
        tuple(form.rms(form.fits(equation, form.over(subset), by_trial)) for subset in sets),
        form.rms(form.fits(equation, form.over(used))),
        by_trial,
        starts,
        visited,
    )


def _smallest(values: Mapping[Columns, float]) -> list[Columns]:
    """Return the minimal sets with a criterion within 10 of the best, given criteria of sets from small to large."""
    smallest: list[Columns] = []
    least = min(values.values())
    for subset, value in values.items():
        if value < least + settings.VERY_STRONG and not any(set(smaller) <= set(subset) for smaller in smallest):
            smallest.append(subset)
    return smallest


def _fits(columns: Sequence[Floats], targets: Sequence[Floats]) -> list[tuple[float, int]]:
    """Return the residual sum of squares of a target, and the rank of columns, of each trial."""
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
    """Return the Cholesky factor of ``(1 - share) I + share exp(-|t - t'| / memory)``, shape (n, n)."""
    samples = np.frombuffer(times)
    correlated = np.exp(-np.abs(samples[:, np.newaxis] - samples) / memory)
    return np.asarray(np.linalg.cholesky((1 - share) * np.eye(len(correlated)) + share * correlated))
