"""Laws of states that are seen through observation equations of known form ``y = g(x; p)``.

There are as many measured quantities as states, so that parameters p determine the states. ``y' = (dg/dx) f(x)`` is
linear in the coefficients of f, and residuals of its weak form (Messenger and Bortz 2021), whitened by their covariance
(Bortz, Messenger and Dukic 2023), have a sum of squares that does not depend on p where f has all terms of a library
that is closed under changes of p. The p is sought with which most terms cost nothing to leave out, and the best few
laws are fitted to the trials by maximum likelihood.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation import SmoothingSpline, noise_level
from commonlaw.discovery.hints import law_under_errors
from commonlaw.discovery.known_physics import Base, with_base
from commonlaw.discovery.method import ModelStructure
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.estimation.beginning import Beginning, begin
from commonlaw.estimation.fitting import Fitted, fit_model
from commonlaw.estimation.model import ModelText
from commonlaw.estimation.problem import TrialData
from commonlaw.estimation.search import FINISHED, IMPROVED, first_values
from commonlaw.formulation.weak import CompactTestFunctions, corner_radius
from commonlaw.inference.search.error_models import under_likeliest_errors
from commonlaw.inference.settings import (
    MAX_ITERATIONS,
    MAX_KEPT,
    MAX_REDUCED_CHI_SQUARED,
    SAME_DEVIANCE,
    VERY_STRONG,
)
from commonlaw.law import Law, Step
from commonlaw.law.restrictions import ALL
from commonlaw.law.text import Addend, free_parameter_names, written_equations
from commonlaw.library import AbstractLibrary, PolynomialLibrary, Terms
from commonlaw.library.notation import quoted
from commonlaw.runtime.progress import ProgressCallback
from commonlaw.trials import Trial, Trials
from commonlaw.trials.trial import property_names

_SHORTEST = 15
"""Samples in the shortest trial."""


@dataclass(frozen=True, eq=False)
class _Rows:
    """One trial: smoothed values of n samples and m quantities, and the weak form of their rates on k test functions.

    The targets have shape (k, m), `tested` integrates samples against test functions, and `response` is how targets
    follow from the noise of samples, shape (k, n) both.
    """

    data: TrialData
    times: Floats
    values: Floats
    inputs: Floats
    noise: Floats
    tested: Floats
    targets: Floats
    response: Floats

    @classmethod
    def of(cls, data: TrialData) -> "_Rows":
        trial = data.trial
        rows = np.isfinite(trial.states).all(axis=1)
        if rows.sum() < _SHORTEST:
            raise CommonlawError("observed-trial-short", trial=trial.label, samples=int(rows.sum()), least=_SHORTEST)
        times, states = trial.times[rows], trial.states[rows]
        known = trial.noise[rows]
        with np.errstate(invalid="ignore"):
            noise = np.where(np.isfinite(known).all(axis=0), known.mean(axis=0), noise_level(times, states))
        noise = np.maximum(noise, 1e-6 * np.ptp(states, axis=0))  # Exact values have that of quadrature
        tests = CompactTestFunctions.over(times, corner_radius(times, states, noise), narrowest=3)
        tested, slopes = (weights.toarray() for weights in tests.weights(times, 1))
        smooth = SmoothingSpline().differentiate(times, states, 1).states
        return cls(data, times, smooth, trial.inputs[rows], noise, tested, -slopes @ states, -slopes)

    def whitened(self, slopes: Floats) -> tuple[Floats, Floats]:
        """Return what makes white rows of rates, shape (k m, m n), and white targets, shape (k m,).

        `slopes` are the derivatives of the rates by the measured values, shape (n, m, m).
        """
        from scipy.linalg import block_diag, solve_triangular

        size = self.values.shape[1]
        blocks = [
            [(self.response * (i == j) - self.tested * slopes[:, i, j]) * self.noise[j] for j in range(size)]
            for i in range(size)
        ]
        response = np.block(blocks)
        covariance = response @ response.T
        covariance[np.diag_indices_from(covariance)] *= 1 + 1e-10
        factor = np.linalg.cholesky(covariance)
        rows = solve_triangular(factor, block_diag(*[self.tested] * size), lower=True)
        return rows, solve_triangular(factor, self.targets.T.ravel(), lower=True)


@dataclass(frozen=True)
class _Candidate:
    """A support, shape (d terms,), the parameters of observations that fit best with it, and the score."""

    support: tuple[bool, ...]
    parameters: tuple[float, ...]
    score: float


class _WeakSearch:
    """The weak form of all trials as a function of the parameters of observations."""

    def __init__(self, begun: Beginning, trials: Trials, structure: ModelStructure) -> None:
        self.model, self.problem = begun.model, begun.problem
        self.terms: Terms = structure.terms(begun.model.schema)
        known = structure.known_coefficients(begun.model.schema, trials.objects).reshape(len(trials.objects), -1)
        self.open: Bools = np.asarray(np.isnan(known).any(axis=0))
        self.fixed = np.nan_to_num(known)
        owners = {name: i for i, name in enumerate(trials.objects)}
        self.owners = [owners[trial.trial.object] for trial in begun.problem.trials]
        self.rows = [_Rows.of(trial) for trial in begun.problem.trials]
        self.lengths = [len(row.times) for row in self.rows]
        ends = np.cumsum([0, *self.lengths]).tolist()
        self.parts = [slice(first, last) for first, last in pairwise(ends)]
        self.values = np.concatenate([row.values for row in self.rows])
        self.given = np.concatenate([np.column_stack([row.inputs, row.times]) for row in self.rows])
        self.ranges = np.ptp(self.values, axis=0)
        self.objects, self.width = len(owners), self.model.width * len(self.terms)
        self.free = sorted({int(i) for trial in begun.problem.trials for i in trial.parameter if i >= 0})
        self.sizes = np.abs(begun.first[self.free])
        samples = np.bincount(self.owners, [row.values.size for row in self.rows])
        self.penalty = float(np.log(samples).sum())
        self.scale, self.white = 1.0, list[tuple[Floats, Floats]]()
        self.last: tuple[bytes, tuple[Floats, Floats, float]] | None = None

    def states(self, values: Floats, p: Floats) -> tuple[Floats, Floats]:
        """Return the states at measured values, by Newton's method, in all variables, and dg/dx, shape (n, m, d)."""
        model, width = self.model, self.model.width
        unknowns = np.zeros(self.problem.unknowns)
        unknowns[self.free] = p
        parameters = [np.tile(row.data.parameters(unknowns), (len(row.times), 1)) for row in self.rows]
        point = np.hstack([np.tile(self.problem.sizes[:width], (len(values), 1)), self.given, np.vstack(parameters)])
        for j, name in enumerate(model.schema.states):
            if name in model.observables and name not in model.text.observed:
                point[:, j] = values[:, model.observables.index(name)]
        for _ in range(MAX_ITERATIONS):
            slopes = model.outputs.jacobian(point)[:, :, :width]
            gap = values - model.outputs.evaluate(point)
            if not np.any(np.abs(gap) > 1e-9 * self.ranges):  # Nor where they are not finite
                break
            try:
                point[:, :width] += np.linalg.solve(slopes, gap[:, :, np.newaxis])[:, :, 0]
            except np.linalg.LinAlgError:
                point[:, :width] = np.nan
        else:
            point[:, :width] = np.nan
        return point, slopes

    def columns(self, values: Floats, p: Floats) -> Floats:
        """Return the rates of measured values by coefficient of the law, shape (n, m, d, terms)."""
        with np.errstate(all="ignore"):
            point, slopes = self.states(values, p)
            library = self.terms.evaluate(point[:, : self.model.first_parameter])
            return np.asarray(slopes[:, :, :, np.newaxis] * library[:, np.newaxis, np.newaxis, :])

    def whiten(self, p: Floats, sweeps: int = 3) -> bool:
        """Whiten rows by their covariance at the law with all terms; return whether rates are finite there."""
        size = len(self.model.observables)
        self.white = [row.whitened(np.zeros((len(row.values), size, size))) for row in self.rows]
        for _ in range(sweeps):
            self.last = None
            squares, coefficients, _ = self.fitted(p, self.open)
            if not np.isfinite(squares):
                return False
            of_rows = np.repeat(
                coefficients.reshape(self.objects, self.model.width, -1)[self.owners], self.lengths, axis=0
            )
            slopes = np.empty((len(self.values), size, size))
            for k, step in enumerate(1e-4 * self.ranges):  # Central differences
                low, high = (
                    np.einsum("nmdt,ndt->nm", self.columns(self.values + side * step * np.eye(size)[k], p), of_rows)
                    for side in (-1, 1)
                )
                slopes[:, :, k] = (high - low) / (2 * step)
            self.white = [row.whitened(slopes[part]) for row, part in zip(self.rows, self.parts, strict=True)]
        self.last = None
        freedom = sum(len(target) for _, target in self.white) - self.objects * int(self.open.sum())
        self.scale = max(1.0, self.fitted(p, self.open)[0] / max(freedom, 1))
        return True

    def normal(self, p: Floats) -> tuple[Floats, Floats, float]:
        """Return Gram matrices of the white rows, their products with targets, by object, and the targets' squares.

        With fixed coefficients k the targets are those of the others, ``y - X k``.
        """
        if self.last is None or self.last[0] != p.tobytes():
            gram, right = np.zeros((self.objects, self.width, self.width)), np.zeros((self.objects, self.width))
            total = 0.0
            columns = self.columns(self.values, p)
            for owner, part, (white, target) in zip(self.owners, self.parts, self.white, strict=True):
                rows = white @ columns[part].transpose(1, 0, 2, 3).reshape(-1, self.width)
                if self.fixed.any():
                    target = target - rows @ self.fixed[owner]
                gram[owner] += rows.T @ rows
                right[owner] += rows.T @ target
                total += float(target @ target)
            self.last = p.tobytes(), (gram, right, total)
        return self.last[1]

    def fitted(self, p: Floats, support: Bools) -> tuple[float, Floats, Floats]:
        """Return the sum of squares, coefficients by object, and how it grows without each of the terms, shape (k,).

        Those of fixed coefficients are in every support.
        """
        gram, right, total = self.normal(p)
        gram, right = gram[:, support][:, :, support], right[:, support]
        result, count = self.fixed.copy(), int(support.sum())
        if not np.isfinite(gram).all():
            return np.inf, result, np.zeros(count)
        with np.errstate(divide="ignore"):
            scale = np.nan_to_num(1 / np.sqrt(np.diagonal(gram, axis1=1, axis2=2)), posinf=0.0)
        gram, right = gram * scale[:, :, np.newaxis] * scale[:, np.newaxis], right * scale
        inverse = np.linalg.inv(gram + 1e-11 * np.eye(count))  # Terms may be combinations of others
        unit = np.einsum("oij,oj->oi", inverse, right)
        result[:, support] = unit * scale
        growth = (unit**2 / np.diagonal(inverse, axis1=1, axis2=2)).sum(axis=0)
        # Of these coefficients themselves, as the ridge keeps them off the least squares of an ill-conditioned problem
        squares = total - float((2 * right * unit).sum() - np.einsum("oi,oij,oj->", unit, gram, unit))
        return squares, result, growth

    def steps(self, p: Floats) -> float:
        """Return what is not explained, and the sum of ``log(1 + a)`` over steps that leave out one term after another.

        Here a is the cost of the term whose loss costs least, all in what a term has to be worth. Terms too many cost
        nothing, so parameters with the fewest terms have the least sum, and near them it decreases toward them.
        """
        squares = self.fitted(p, self.open)[0]
        if not np.isfinite(squares):
            return float(np.finfo(np.float64).max)  # A simplex takes no infinite value
        unit = self.scale * self.penalty
        return squares / unit + float(np.log1p(np.array(self.path(p)[1]) / unit).sum())

    def score(self, p: Floats, support: Bools) -> float:
        """Return the sum of squares with the penalty of terms, as in the Bayesian information criterion."""
        return self.fitted(p, support)[0] / self.scale + self.penalty * int(support.sum())

    def path(self, p: Floats) -> tuple[list[Bools], list[float]]:
        """Return supports from all terms to none, each without the term whose loss costs least, and these costs."""
        result, costs = [self.open], list[float]()
        while result[-1].any():
            growth, support = self.fitted(p, result[-1])[2], result[-1].copy()
            least = int(np.argmin(growth))
            support[np.flatnonzero(support)[least]] = False
            result.append(support)
            costs.append(max(float(growth[least]), 0.0))
        return result, costs

    def ends(self, starts: Sequence[Floats]) -> list[Floats]:
        """Return where searches for few terms end, the best first, and whiten rows there."""
        if not self.free:
            return list(starts[:1])
        minima = sorted((_least(self.steps, start, self.sizes) for start in starts), key=lambda end: end[0])
        apart = [end[1] for i, end in enumerate(minima) if not i or end[0] - minima[i - 1][0] > SAME_DEVIANCE]
        self.whiten(apart[0])
        return apart[:FINISHED]

    def candidates(self, ends: Sequence[Floats]) -> list[_Candidate]:
        """Return supports with their parameters, the best first."""
        by_support = dict[tuple[bool, ...], _Candidate]()

        def add(p: Floats, support: Bools) -> _Candidate:
            """Return the law with these terms, its parameters improved."""
            key = tuple(support.tolist())
            if len(p):
                p = _least(lambda q: self.score(q, support), p, self.sizes)[1]
            candidate = _Candidate(key, tuple(p.tolist()), self.score(p, support))
            if key not in by_support or candidate.score < by_support[key].score:
                by_support[key] = candidate
            return candidate

        for p in ends:
            best = add(p, min(self.path(p)[0], key=lambda support: self.score(p, support)))
            while any(best.support):
                # What is left out may change the parameters, so each is tried
                support, parameters = np.array(best.support), np.array(best.parameters)
                fewer = [support & (np.arange(len(support)) != i) for i in np.flatnonzero(support)]
                less = min((add(parameters, subset) for subset in fewer), key=lambda candidate: candidate.score)
                if less.score >= best.score:
                    break
                best = less
        return sorted(by_support.values(), key=lambda candidate: candidate.score)


def _apart(starts: Sequence[Floats], factor: float = 2.0) -> list[Floats]:
    """Return starts without those near to one before, each number within a factor: these lead to the same end."""
    result = list[Floats]()
    for start in starts:
        if not any(np.all((start / kept > 1 / factor) & (start / kept < factor)) for kept in result):
            result.append(start)
    return result


def _least(function: Callable[[Floats], float], start: Floats, sizes: Floats) -> tuple[float, Floats]:
    """Return the least value of a function, from a start, by the simplex of Nelder and Mead, and where it is."""
    from scipy.optimize import minimize

    def scaled(unit: Floats) -> float:
        return function(unit * sizes)

    options: Any = {"xatol": 1e-6, "fatol": 1e-3, "maxfev": 100 * len(start)}
    optimum = minimize(scaled, start / sizes, method="Nelder-Mead", options=options)
    return float(optimum.fun), np.asarray(optimum.x * sizes)


def discover_observed(
    trials: Trials,
    observe: Mapping[str, str],
    latent: Sequence[str],
    library: AbstractLibrary | None,
    known: Base,
    *,
    noise: Mapping[str, float] | None,
    seed: int,
    progress: ProgressCallback,
    calls: tuple[str, ...],
) -> Law:
    """Return the law of first order of states that are measured and latent ones, see `commonlaw.discover`.

    Without a library polynomials of degree 2 are its terms, and of degree 3 where these show lack of fit.

    Raises `CommonlawError` if there are not as many states as measured quantities, fixed coefficients differ between
    objects, no parameters give finite states, or the best laws cannot be fitted.
    """
    for name in observe:
        check_choice("measured quantity", name, trials.schema.states)
    states = (*(name for name in trials.schema.states if name not in observe), *latent)
    if len(set(states)) != len(trials.schema.states):
        raise CommonlawError("observed-states", states=states, measured=trials.schema.states)
    begun = _begun(trials, observe, states, noise)
    ends, schema = list[Floats](), begun.model.schema
    rests = [
        Trial(name, "1", np.zeros(1), np.zeros((1, len(states))), np.zeros((1, len(schema.inputs))))
        for name in trials.objects
    ]
    of_states = Trials(tuple(rests), schema, trials.properties)
    for offered in (PolynomialLibrary(2), PolynomialLibrary(3)) if library is None else (library,):
        structure = ModelStructure(1, *with_base(offered, known, 1, of_states))
        search = _WeakSearch(begun, trials, structure)
        if (search.fixed != search.fixed[0]).any():
            raise CommonlawError("known-by-object-with-observation", objects=trials.objects)
        starts = first_values(begun.first, begun.guessed, begun.bounds, seed)[:, search.free]
        progress("looking for parameters of observations with which the law has few terms")
        if not any(search.whiten(start) for start in starts):
            raise CommonlawError("observation-not-invertible", observations=[f"{k} = {v}" for k, v in observe.items()])
        ends = search.ends(_apart(sorted(starts, key=search.steps))[:IMPROVED])
        if search.scale >= MAX_REDUCED_CHI_SQUARED:  # The first parameters may be far from the library's laws
            ends = search.ends(ends)
        if search.scale < MAX_REDUCED_CHI_SQUARED:
            break
    candidates = search.candidates(ends)
    worst = candidates[0].score + 2 * VERY_STRONG
    near = [candidate for candidate in candidates[:MAX_KEPT] if candidate.score < worst]
    fits, refused = list[tuple[float, Fitted]](), list[CommonlawError]()
    for i, candidate in enumerate(near):
        progress(f"fitting law {i + 1} of {len(near)}")
        try:
            equations, first, shared = _equations(search, begun, trials, candidate)
            text = ModelText.of(equations, observe)
            whole = begin(text, trials, {}, shared=dict.fromkeys(shared, ALL), noise=noise)
            whole = replace(whole, first=np.array([first[label] for label in whole.unknowns.labels]))
            fitted = fit_model(whole, seed, progress, draws=1)
        except CommonlawError as error:
            refused.append(error)
            continue
        deviance = -2 * fitted.optimum.log_likelihood
        fits.append((deviance + search.penalty * sum(candidate.support), fitted))
    if not fits:
        raise refused[0]
    white = min(fits, key=lambda pair: pair[0])[1]
    law = law_under_errors(under_likeliest_errors(white), white, calls)
    others = [candidate for candidate in candidates if candidate.support != candidates[0].support]
    apart = f"; the score of the next law is {others[0].score - candidates[0].score:.3g} larger" if others else ""
    step = Step(
        "terms",
        f"{sum(candidates[0].support)} of {search.open.sum()}",
        f"the fewest for any parameters of observations{apart}",
    )
    return replace(law, provenance=replace(law.provenance, history=(step, *law.history)))


def _begun(
    trials: Trials, observe: Mapping[str, str], states: Sequence[str], noise: Mapping[str, float] | None
) -> Beginning:
    """Return observations alone, of states that rest, with parameters that all objects share."""
    text = ModelText.of("; ".join(f"{quoted(name)}' = 0" for name in states), observe)
    apart = begin(text, trials, {}, noise=noise or {})
    properties = property_names(trials.properties)
    shared = [name for name in apart.model.parameters if name not in properties]
    return begin(text, trials, {}, shared=dict.fromkeys(shared, ALL), noise=noise or {})


def _equations(
    search: _WeakSearch, begun: Beginning, trials: Trials, found: _Candidate
) -> tuple[str, dict[str, float], list[str]]:
    """Return the equations of a candidate, initial guesses of all unknowns, and the names of shared parameters."""
    p, support, fixed = np.array(found.parameters), np.array(found.support), search.fixed[0]
    variables, shared = search.terms.variables, [begun.unknowns.names[i] for i in search.free]
    names = [quoted(name) for name in variables.names]
    used = (*variables.names, *begun.model.parameters, *trials.schema.states, *property_names(trials.properties))
    parameters = free_parameter_names(int(support.sum()), used)
    coefficients, states = search.fitted(p, support)[1][:, support], search.model.schema.states
    signs = np.where(np.median(coefficients, axis=0) < 0, -1.0, 1.0)
    numbers, is_negative = [f"{abs(number)!r}" for number in fixed.tolist()], fixed < 0
    for place, parameter, sign in zip(np.flatnonzero(support).tolist(), parameters, signs, strict=True):
        numbers[place], is_negative[place] = parameter, sign < 0
    rows: list[list[Addend]] = [[] for _ in states]
    for place in np.flatnonzero(support | (fixed != 0)).tolist():
        j, term = divmod(place, len(search.terms))
        rows[j].append(Addend(bool(is_negative[place]), numbers[place], search.terms.terms[term].text(names)))
    text = "; ".join(written_equations([f"{quoted(name)}'" for name in states], rows))
    first = dict(zip(shared, p.tolist(), strict=True))
    for owner, values in zip(trials.objects, signs * coefficients, strict=True):
        for parameter, value in zip(parameters, values.tolist(), strict=True):
            first[parameter if len(trials.objects) == 1 else f"{parameter} of {owner}"] = value
    point, _ = search.states(search.values, p)
    for row, part in zip(search.rows, search.parts, strict=True):
        label = row.data.trial.label
        first |= {f"{name}(0) of {label}": float(point[part.start, j]) for j, name in enumerate(states)}
    return text, first, shared
