"""Which variables trials can tell apart, before any law: whether laws in some of them fit as well as laws in others.

A trajectory is its start plus the integral of its law: ``x(t) = x(0) + sum of c_k times the integral of term k``, twice
over for laws of second order. With terms taken along smooth curves through the samples, what a law leaves of the
measurements is linear in its coefficients, no rate of the highest order is needed, and noise stays what it was (the
integral form of sparse regression; Schaeffer and McCalla 2017). Errors may be correlated in time.

Some variables suffice for an equation if no others have very strong evidence against them: the Bayesian information
criterion of the terms over them alone, with coefficients of each object's own, is within 10 of the best (Kass and
Raftery 1995). Where trials visit a single curve, one variable says on it what another says, and there are several
smallest sets that suffice, none part of another: laws in the one and in the other fit alike, and differ wherever the
curve is left. An object that visits more tells for all, as objects share their terms. Where trials of an object differ
by more than their noise, a variable may stand in for what makes them differ: so it is said, too, where evidence
prefers laws whose coefficients differ from trial to trial."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import combinations, islice

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation import SmoothingSpline
from commonlaw.errors import CommonlawError
from commonlaw.formulation import column_scales, law_variables
from commonlaw.inference import settings
from commonlaw.library import AbstractLibrary, Order, PolynomialLibrary, Terms, order_of_each, parse_library, with_rates
from commonlaw.trials import Trial, Trials
from commonlaw.trials.logarithms import natural

Columns = tuple[int, ...]
"""Variables, by their columns."""


@dataclass(frozen=True)
class StandIns:
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


def stand_ins(trials: Trials, order: Order, library: AbstractLibrary | str | None = None) -> tuple[StandIns, ...]:
    """Return the equations whose variables trials cannot tell apart.

    Parameters
    ----------
    trials
        What was measured.
    order
        Of the laws that are looked for, 1 or 2, or that of each equation.
    library
        Their candidate terms. Default: polynomials of degree 3, or of a lower one where trials have few samples.

    Raises
    ------
    CommonlawError
        If the library does not fit the variables.
    """
    with np.errstate(all="ignore"):
        return _stand_ins(trials, order, parse_library(library) if isinstance(library, str) else library)


def _stand_ins(trials: Trials, order: Order, given: AbstractLibrary | None) -> tuple[StandIns, ...]:
    curves = [curve for trial in _looked_at(trials) if (curve := _curve(trial, trials, order)) is not None]
    variables, states = law_variables(trials.schema, order), trials.schema.states
    orders = order_of_each(order, len(states))
    choices = [given] if given else [PolynomialLibrary(degree) for degree in (3, 2, 1)]
    for terms in (each.bind(variables) for each in choices):
        used = sorted(set().union(*(term.columns() for term in terms.terms)))
        if not 1 < len(used) <= settings.MAX_VARIABLES:
            continue
        forms = {each: _IntegralForm.of(curves, terms, each) for each in {*orders}}
        of_each = [form for each in orders if (form := forms[each]) is not None]
        if len(of_each) == len(states):
            found = (_one_equation(form, j, used) for j, form in enumerate(of_each))
            return tuple(
                _named(each, states[j], variables.names, curves) for j, each in enumerate(found) if each is not None
            )
    return ()


@dataclass(frozen=True, eq=False)
class _Curve:
    """Variables along a smooth curve through a trial, shape (n, variables), and its measured states, (n, states)."""

    object: str
    times: Floats
    values: Floats
    states: Floats


@dataclass(frozen=True)
class _Found:
    sets: tuple[Columns, ...]
    left: tuple[float, ...]
    left_by_all: float
    by_trial: bool


@dataclass(frozen=True, eq=False)
class _Rows:
    """A trial's integrals of terms and its states, shape (n, terms + states), and what a start explains, (n, order)."""

    times: Floats
    values: Floats
    start: Floats

    @property
    def without_start(self) -> Floats:
        """The values without what the start explains."""
        basis, _ = np.linalg.qr(self.start)
        return np.asarray(self.values - basis @ (basis.T @ self.values))


@dataclass(frozen=True, eq=False)
class _IntegralForm:
    """Rows of each object's trials, `objects`, and what a factorisation without their starts leaves of them, `factors`.

    Of each object `free` is the number of samples that starts leave.
    """

    terms: Terms
    objects: tuple[tuple[_Rows, ...], ...]
    factors: tuple[tuple[Floats, ...], ...]
    free: tuple[int, ...]

    @classmethod
    def of(cls, curves: Sequence[_Curve], terms: Terms, order: int) -> "_IntegralForm | None":
        """Return the form of the objects that have samples for all terms; None if none has."""
        objects = []
        for name in dict.fromkeys(each.object for each in curves):
            own = [each for each in curves if each.object == name]
            if sum(len(each.times) - order for each in own) >= 2 * len(terms):
                rows = tuple(_integrals(each, terms, order) for each in own)
                if all(np.isfinite(each.values).all() for each in rows):
                    objects.append(rows)
        return cls._made(terms, objects) if objects else None

    @classmethod
    def _made(cls, terms: Terms, objects: Sequence[tuple[_Rows, ...]]) -> "_IntegralForm":
        factors = tuple(
            tuple(np.asarray(np.linalg.qr(each.without_start, mode="r")) for each in own) for own in objects
        )
        free = tuple(sum(len(each.times) - each.start.shape[1] for each in own) for own in objects)
        return cls(terms, tuple(objects), factors, free)

    def over(self, variables: Sequence[int]) -> list[int]:
        """Return the terms over some variables alone."""
        return [k for k, term in enumerate(self.terms.terms) if set(term.columns()) <= set(variables)]

    def left(self, equation: int, over: Sequence[int], by_trial: bool = False) -> list[tuple[float, int]]:
        """Return of each object what some terms leave, a sum of squares, and how many coefficients they have."""
        column = len(self.terms) + equation
        found = []
        for own in self.factors:
            parts = own if by_trial else (np.concatenate(own),)
            fits = _fits([part[:, over] for part in parts], [part[:, column] for part in parts])
            found.append((sum(squares for squares, _ in fits), sum(size for _, size in fits)))
        return found

    def rms(self, left: Sequence[tuple[float, int]]) -> float:
        """Return the root mean square of what is left."""
        return float(np.sqrt(sum(squares for squares, _ in left) / sum(self.free)))

    def criterion(self, equation: int) -> Callable[[Sequence[tuple[float, int]]], float]:
        """Return what gives the Bayesian information criterion of what is left, comparable for one equation."""
        column = len(self.terms) + equation
        targets = [np.concatenate([factor[:, column] for factor in own]) for own in self.factors]
        floors = np.array([max(settings.ROUNDING**2 * float(each @ each), 1e-300) for each in targets])
        sizes = [size for _, size in self.left(equation, range(len(self.terms)))]
        freedom = np.maximum(np.array(self.free) - sizes, np.e)

        def value(left: Sequence[tuple[float, int]]) -> float:
            squares, counts = np.array(left).T
            return float(np.sum(freedom * np.log(squares + floors) + counts * np.log(freedom)))

        return value

    def whitened(self, equation: int) -> "_IntegralForm":
        """Return the form in which errors of a state are independent, by the most probable memory of theirs.

        Errors are white noise and a part that is correlated in time, of the same share and memory in all trials; these
        are chosen by the restricted likelihood, which knows what all terms and the starts have taken.
        """
        errors = min(self._deviances, key=lambda each: each[1][equation])[0]
        if errors not in self._white:
            rows = [tuple(_whitened(each, *errors) for each in own) for own in self.objects]
            self._white[errors] = self._made(self.terms, rows) if errors[0] else self
        return self._white[errors]

    @cached_property
    def _white(self) -> "dict[tuple[float, float], _IntegralForm]":
        """Forms that were made already, by shares and memories of errors, as equations often have the same."""
        return {}

    @cached_property
    def _deviances(self) -> list[tuple[tuple[float, float], Floats]]:
        """Return minus twice the restricted log-likelihood of each equation by shares and memories of errors."""
        step = float(np.median(np.concatenate([np.diff(each.times) for own in self.objects for each in own])))
        memories = [
            (share, step * steps) for share in settings.CORRELATED_SHARES for steps in settings.CORRELATION_TIMES
        ]
        few = [own[: settings.MAX_WINDOWS] for own in self.objects[: settings.MAX_WINDOWS]]
        mixed = [(own, self._mixture(own)) for own in few]
        return [
            (errors, np.sum([self._restricted_deviances(*own, errors) for own in mixed], axis=0))
            for errors in [(0.0, step), *memories]
        ]

    def _mixture(self, own: Sequence[_Rows]) -> Floats:
        """Return the mixture of terms that is orthonormal over an object's trials."""
        scale, mixed = _independent(np.concatenate([each.without_start[:, : len(self.terms)] for each in own]))
        return mixed / scale[:, np.newaxis]

    def _restricted_deviances(self, own: Sequence[_Rows], mixture: Floats, errors: tuple[float, float]) -> Floats:
        """Return minus twice the restricted log-likelihoods of an object's trials, given share and memory of errors."""
        white, count = [_whitened(each, *errors) for each in own], len(self.terms)
        starts = [np.asarray(np.linalg.qr(each.start, mode="r")) for each in white]
        rows = np.concatenate([each.without_start for each in white])
        columns, targets = rows[:, :count] @ mixture, rows[:, count:]
        basis, triangle = np.linalg.qr(columns)
        rest = targets - basis @ (basis.T @ targets)
        freedom = max(len(rows) - sum(each.start.shape[1] for each in own) - columns.shape[1], 1)
        information = sum(float(np.sum(np.log(np.abs(np.diag(each))))) for each in (*starts, triangle))
        determinant = sum(log_determinant(each.times, *errors) for each in own)
        squares = np.maximum(np.sum(rest**2, axis=0), 1e-300)
        return np.asarray(determinant + 2 * information + freedom * np.log(squares))


def _one_equation(form: _IntegralForm, equation: int, used: Sequence[int]) -> _Found | None:
    """Return the smallest sets of variables that suffice for an equation; None if there is one such set."""
    white = form.whitened(equation)
    criterion = white.criterion(equation)

    def value(variables: Columns, by_trial: bool = False) -> float:
        return criterion(white.left(equation, white.over(variables), by_trial))

    subsets = [each for size in range(len(used) + 1) for each in combinations(used, size)]
    values = {each: value(each) for each in subsets}
    sets, by_trial = _smallest(values), False
    if len(sets) < 2 and any(len(own) > 1 for own in form.objects):
        apart = {each: value(each, True) for each in subsets}
        by_trial = min(apart.values()) < min(values.values())
        sets = _smallest(apart) if by_trial else sets
    if len(sets) < 2:
        return None
    left = [form.rms(form.left(equation, form.over(each), by_trial)) for each in sets]
    by_all = form.rms(form.left(equation, form.over(used)))
    return _Found(tuple(sets), tuple(left), by_all, by_trial)


def _smallest(values: Mapping[Columns, float]) -> list[Columns]:
    """Return the sets that suffice and hold no smaller one that does, given criteria of sets from small to large."""
    found: list[Columns] = []
    least = min(values.values())
    for each, value in values.items():
        if value < least + settings.VERY_STRONG and not any(set(smaller) <= set(each) for smaller in found):
            found.append(each)
    return found


def _independent(columns: Floats) -> tuple[Floats, Floats]:
    """Return norms of columns, shape (terms,), and the mixture of columns so scaled that is orthonormal."""
    scale = column_scales(columns)
    _, values, right = np.linalg.svd(columns / scale, full_matrices=False)
    kept = values > settings.MIN_SINGULAR_VALUE
    return scale, np.asarray(right[kept].T / values[kept])


def _fits(columns: Sequence[Floats], targets: Sequence[Floats]) -> list[tuple[float, int]]:
    """Return what columns leave of a target, its sum of squares, and how many of them are independent, of each trial.

    Trials whose columns have one shape are decomposed together.
    """
    if len({each.shape for each in columns}) > 1:
        return [fit for pair in zip(columns, targets, strict=True) for fit in _fits([pair[0]], [pair[1]])]
    scaled, aims = np.array([each / column_scales(each) for each in columns]), np.array(targets)
    left, values, _ = np.linalg.svd(scaled, full_matrices=False)
    bases = left * (values > settings.MIN_SINGULAR_VALUE)[:, np.newaxis]
    rest = aims - np.einsum("tnk,tk->tn", bases, np.einsum("tnk,tn->tk", bases, aims))
    squares, sizes = np.einsum("tn,tn->t", rest, rest), (values > settings.MIN_SINGULAR_VALUE).sum(axis=1)
    return list(zip(squares.tolist(), sizes.tolist(), strict=True))


def _whitened(rows: _Rows, share: float, memory: float) -> _Rows:
    """Return rows whose errors are independent."""
    from scipy.linalg import solve_triangular

    factor = correlation_factor(rows.times.tobytes(), share, memory)
    values, start = (solve_triangular(factor, each, lower=True) for each in (rows.values, rows.start))
    return _Rows(rows.times, values, start)


def _looked_at(trials: Trials) -> list[Trial]:
    groups = sorted((trials.of_object(name) for name in trials.objects), key=len, reverse=True)
    complete = (_some(trial) for group in groups for trial in group if trial.complete or _complete_samples(trial).any())
    return list(islice(complete, settings.MAX_TRIALS))


def _some(trial: Trial) -> Trial:
    """Return the samples that have all states; of a long trial the first ones."""
    measured = trial if trial.complete else trial.rows(_complete_samples(trial))
    return measured.cut(settings.MAX_CURVE_POINTS) if len(measured) > settings.MAX_CURVE_POINTS else measured


def _complete_samples(trial: Trial) -> Bools:
    """Return the samples that have all states, shape (n,)."""
    return np.asarray(np.isfinite(trial.states).all(axis=1))


def _curve(trial: Trial, trials: Trials, order: Order) -> _Curve | None:
    """Return the variables along a smooth curve through a trial, and its states; None if it is too short."""
    states = natural(trial.states, trials.schema)
    try:
        rates = SmoothingSpline().differentiate(trial.times, states, 1)
    except CommonlawError:
        return None
    columns = [rates.states, rates.derivatives[0][:, with_rates(order, states.shape[1])], trial.inputs]
    return _Curve(trial.object, trial.times - trial.times[0], np.column_stack([*columns, trial.times]), states)


def _integrals(curve: _Curve, terms: Terms, order: int) -> _Rows:
    """Return the integrals of the terms along a curve, and its states."""
    from scipy.interpolate import CubicSpline

    start = np.vander(curve.times / curve.times[-1], order)
    values = terms.evaluate(curve.values)
    if np.isfinite(values).all():
        values = CubicSpline(curve.times, values).antiderivative(order)(curve.times)
    return _Rows(curve.times, np.column_stack([values, curve.states]), start)


def _named(found: _Found, state: str, names: Sequence[str], curves: Sequence[_Curve]) -> StandIns:
    first, values = (
        np.array([each.values[0] for each in curves]),
        np.concatenate([each.values for each in curves]),
    )
    concerned = sorted(set().union(*found.sets))
    starts, visited = (
        {names[i]: (float(each[:, i].min()), float(each[:, i].max())) for i in concerned} for each in (first, values)
    )
    sets = tuple(tuple(names[i] for i in each) for each in found.sets)
    return StandIns(state, sets, found.left, found.left_by_all, found.by_trial, starts, visited)


@lru_cache(maxsize=8)
def correlation_factor(times: bytes, share: float, memory: float) -> Floats:
    """Return the lower triangular factor of the errors' correlation at some times, shape (n, n)."""
    correlated = _decaying(times, memory)
    return np.asarray(np.linalg.cholesky((1 - share) * np.eye(len(correlated)) + share * correlated))


def log_determinant(times: Floats, share: float, memory: float) -> float:
    """Return the logarithm of the determinant of the errors' correlation."""
    return 2 * float(np.sum(np.log(np.diag(correlation_factor(times.tobytes(), share, memory)))))


@lru_cache(maxsize=8)
def _decaying(times: bytes, memory: float) -> Floats:
    samples = np.frombuffer(times)
    return np.asarray(np.exp(-np.abs(samples[:, np.newaxis] - samples) / memory))
