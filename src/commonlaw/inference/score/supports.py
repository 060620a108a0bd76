"""Best-subset selection of the supports of all equations by their evidence and prior probability.

The least-squares problems have the terms of one equation after the other as columns.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import lgamma

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.formulation import LeastSquaresProblem, least_squares_of_each
from commonlaw.inference.score.evidence import (
    NoiseScale,
    coefficient_penalty,
    minus_twice_log_evidence,
    residual_squares,
    rss_with_added_term,
)
from commonlaw.inference.score.score import Part, Score
from commonlaw.inference.settings import GENERIC_POINTS, MAX_SWEEPS, MAX_TERMS, ROUNDING
from commonlaw.library import Terms
from commonlaw.runtime.checkpoint import checkpointed
from commonlaw.runtime.forking import cached_property
from commonlaw.solvers import AbstractSolver

BITS = 2.0
"""Description length of a factor of a term, in bits.

Among supports of one size, the 48 polynomial equations of degree 3 or less of `commonlaw.named_models` are most
probable with 2.6 bits, between 2.0 and 3.2 at 95 %, if a constant counts as one factor.
"""


@dataclass(frozen=True, eq=False)
class StructurePrior:
    """The prior of the support of one equation.

    A support S of s out of N terms has minus twice the log prior

        -2 log [B(1 + s, 2 N - s) / B(1, N)] + sum of w_k over S + c z(S).

    The first part is beta-binomial: each term is included with a probability that has the beta distribution of
    parameters 1 and N, so that one term is expected (Castillo, Schmidt-Hieber and van der Vaart 2015). w_k is the
    description length of term k, `BITS` for each factor, and z(S) counts the states with an arbitrary origin
    of which S fixes the origin.

    The penalties w_k of terms have shape (terms,); `zero` is the penalty c of a fixed origin, that of one fitted
    number. `shifted` has for each state with an arbitrary origin which terms each term needs to be invariant to a shift
    of the origin, shape (terms, terms). N includes `excluded_terms`, those that were screened out before.
    """

    terms: Floats
    shifted: Sequence[Bools] = ()
    zero: float = 0.0
    excluded_terms: int = 0

    def of(self, support: Bools) -> float:
        """Return minus twice the log prior of a support, shape (terms,)."""

        def betaln(a: float, b: float) -> float:
            return lgamma(a) + lgamma(b) - lgamma(a + b)

        count, size = len(support) + self.excluded_terms, int(support.sum())
        log_prior = betaln(1 + size, 2 * count - size) - betaln(1, count)
        fixed_origins = sum(bool((needed[support] & ~support).any()) for needed in self.shifted)
        return -2 * log_prior + float(self.terms[support].sum()) + fixed_origins * self.zero


def shifted(terms: Terms, column: int) -> Bools:
    """Return which other terms each term needs to be invariant to a shift of a variable, shape (terms, terms).

    They are the terms of its derivative by the variable; all, if that is not in the span of the terms.
    """
    points = np.random.default_rng(0).uniform(0.5, 2.0, (4 * len(terms) + GENERIC_POINTS, len(terms.variables.names)))
    with np.errstate(all="ignore"):
        values, slopes = terms.evaluate(points), terms.jacobian(points)[:, :, column]
    if not (np.isfinite(values).all() and np.isfinite(slopes).all()):
        return np.zeros((len(terms), len(terms)), dtype=bool)
    mixtures = np.linalg.lstsq(values, slopes, rcond=1e-12)[0].T
    wrong = np.abs(values @ mixtures.T - slopes).max(axis=0) > ROUNDING * np.maximum(1.0, np.abs(slopes).max(axis=0))
    return np.where(wrong[:, np.newaxis], True, np.abs(mixtures) > ROUNDING)


@dataclass(frozen=True, eq=False)
class SupportEvidence:
    """The evidence for supports of the equations that all objects share, with at most `most` terms of each equation.

    Problems, one for each object, have residuals of unit variance, and as columns all terms of the first equation, then
    of the second, ... The `allowed` terms of each equation have shape (equations, terms); equations that are `stated`,
    shape (equations,), keep all of theirs. Offsets are parts of the score that all supports have in common. Random
    effects are the logarithms of coefficients with a value other than zero in `log_parametrized`, shape (objects,
    columns): nonlinear parameters, and coefficients of terms that contain them.
    """

    problems: Sequence[LeastSquaresProblem]
    allowed: Bools
    noise_scale: NoiseScale
    structure_prior: StructurePrior
    most: int = MAX_TERMS
    offsets: Mapping[Part, float] = field(default_factory=dict)
    stated: Bools | None = None
    log_parametrized: Floats | None = None

    @checkpointed
    def choose(self, start: Bools, solver: AbstractSolver) -> Bools:
        """Return supports of largest evidence by coordinate ascent over equations, shape (equations, terms).

        Each is chosen from the path of the solver given the others, at first those of `start`.
        """
        supports, known = start.copy(), dict[int, bytes]()
        for _ in range(MAX_SWEEPS):
            before = supports.copy()
            for j in self._chosen:
                others = np.delete(supports, j, axis=0).tobytes()
                if known.get(j) != others:  # Else the same would be chosen again
                    known[j], supports[j] = others, self._choose_equation(supports, j, solver)
            if np.array_equal(before, supports):
                break
        return supports

    def value(self, supports: Bools) -> float:
        """Return the total of the `score` of supports of all equations."""
        evidence = minus_twice_log_evidence(self._random_effects, np.flatnonzero(supports), self.noise_scale)
        return sum(self.offsets.values()) + evidence + sum(self.structure_prior.of(support) for support in supports)

    def of_objects(self, indices: Sequence[int], count: int, scale: float) -> "SupportEvidence":
        """Return the evidence for supports of some objects, of so many measurements, alone.

        The noise is taken as known, of so many times its present standard deviation.
        """
        some = list(indices)
        problems = [replace(self.problems[o], factor=self.problems[o].factor / scale) for o in some]
        values = None if self.log_parametrized is None else self.log_parametrized[some]
        return replace(
            self, problems=problems, noise_scale=NoiseScale(count), offsets={}, stated=None, log_parametrized=values
        )

    def score(self, supports: Bools) -> Score:
        """Return minus twice the log-evidence and log prior of supports of all equations, in its parts."""
        indices, objects = np.flatnonzero(supports), len(self.problems)
        evidence = minus_twice_log_evidence(self._random_effects, indices, self.noise_scale)
        likelihood = float(self.noise_scale.deviance(self.squares(supports), len(indices) * objects))
        coefficients = coefficient_penalty(len(indices), objects, self.noise_scale)
        return Score(
            {
                **self.offsets,
                "likelihood": likelihood,
                "coefficients": coefficients,
                "scatter": evidence - likelihood - coefficients,
                "structure": sum(self.structure_prior.of(support) for support in supports),
            }
        )

    def squares(self, supports: Bools) -> float:
        """Return the residual sum of squares of supports of all equations."""
        return residual_squares(self._random_effects, np.flatnonzero(supports))

    def noise_variance(self, supports: Bools) -> float:
        """Return the noise variance from the residuals of supports of all equations, in units of its present value."""
        indices = np.flatnonzero(supports)
        squares = residual_squares(self._factors, indices)
        return self.noise_scale.variance(squares, len(indices) * len(self._factors))

    def path(self, supports: Bools, equation: int, solver: AbstractSolver) -> list[Bools]:
        """Return the supports on the path of a solver for one equation given the others, each of shape (terms,)."""
        listed = _path(self._alone(supports, equation), self.allowed[equation], solver)
        return [support for support in listed if support.sum() <= self.most]

    @checkpointed
    def neighbours(
        self, supports: Bools, fitted: Sequence[tuple[float, Bools]] = ()
    ) -> list[list[tuple[float, Bools]]]:
        """Return for each equation the chosen support and those that differ by one term or a swap of two.

        They are sorted, each with 2 log B of the chosen against it, given the supports of the other equations. The
        values of `fitted` ones replace those of the linearization.
        """
        ranked = []
        for j, chosen in enumerate(supports):
            if j not in self._chosen:
                ranked.append([(0.0, chosen)])
                continue
            equation = self._equation(supports, j, self._alone(supports, j))
            near = equation.neighbours(chosen, self.allowed[j], max(self.most, chosen.sum()))
            several = [chosen, *(support for _, support in near), *(candidate[j] for _, candidate in fitted)]
            listed = list({support.tobytes(): support for support in several}.values())
            others = np.delete(supports, j, axis=0)
            exact = {
                candidate[j].tobytes(): above
                for above, candidate in fitted
                if np.array_equal(np.delete(candidate, j, axis=0), others)
            }
            here = equation.value(chosen)
            compared = [
                (exact[key] if (key := support.tobytes()) in exact else equation.value(support) - here, support)
                for support in listed
            ]
            ranked.append(sorted(compared, key=lambda pair: pair[0]))
        return ranked

    def coefficients(self, supports: Bools, held: Floats | None = None) -> Floats:
        """Return each object's least-squares coefficients, shape (objects, equations, terms).

        Those with a value other than zero in `held`, of the same shape, are fixed there.
        """
        fixed = np.zeros((len(self.problems), *supports.shape)) if held is None else held
        reduced = [
            problem.subtract(offset.reshape(1, -1)) if offset.any() else problem
            for problem, offset in zip(self.problems, fixed, strict=True)
        ]
        return least_squares_of_each(reduced, supports.ravel(), 0).reshape(fixed.shape) + fixed

    def _choose_equation(self, supports: Bools, equation: int, solver: AbstractSolver) -> Bools:
        """Return the support of one equation given the others: the best of a path and of its neighbours in turn."""
        allowed, alone = self.allowed[equation], self._alone(supports, equation)
        evidence, listed = self._equation(supports, equation, alone), _path(alone, allowed, solver)
        if not np.array_equal(supports[equation], allowed):
            listed.append(supports[equation])
        none = np.zeros_like(allowed)
        floors = [(evidence.value(support, -np.inf), support) for support in listed if support.sum() <= self.most]
        best, value = evidence.best(floors, none, evidence.value(none))
        while True:
            better, value = evidence.best(evidence.neighbours(best, allowed, self.most), best, value)
            if better is best:
                return best
            best = better

    def _equation(self, supports: Bools, equation: int, alone: Sequence[LeastSquaresProblem]) -> "_EquationEvidence":
        others = int(np.delete(supports, equation, axis=0).sum())
        noise_scale = self.noise_scale.without(others * len(self.problems))
        return _EquationEvidence(np.array([problem.factor for problem in alone]), noise_scale, self.structure_prior)

    def _alone(self, supports: Bools, equation: int) -> list[LeastSquaresProblem]:
        """Return the problems of one equation, projected orthogonally to the terms of the others."""
        terms = supports.shape[1]
        mine = np.arange(equation * terms, (equation + 1) * terms)
        others = np.setdiff1d(np.flatnonzero(supports), mine)
        columns = [*others, *mine, supports.size]
        factors = np.asarray(np.linalg.qr(self._factors[:, :, columns], mode="r"))[:, len(others) :, len(others) :]
        return [
            LeastSquaresProblem(np.asfortranarray(factor), terms, problem.rows)
            for factor, problem in zip(factors, self.problems, strict=True)
        ]

    @property
    def _chosen(self) -> list[int]:
        return [j for j in range(len(self.allowed)) if self.stated is None or not self.stated[j]]

    @cached_property
    def _factors(self) -> Floats:
        return np.array([problem.factor for problem in self.problems])

    @cached_property
    def _random_effects(self) -> Floats:
        return random_effect_factors(self._factors, self.log_parametrized)


def random_effect_factors(factors: Floats, log_parametrized: Floats | None) -> Floats:
    """Return the factors in the coordinates of the random effects: coefficients, or logarithms of their sizes.

    To first order about values b, ``X beta = X (b log|beta|)`` plus a constant. In V s/(K + s) with K much larger than
    s, only V/K is identifiable: lines of constant V/K all meet at the origin of (V, K), where the between-object
    variance would vanish, and are parallel in logarithms.
    """
    if log_parametrized is None:
        return factors
    scaled, values = factors.copy(), log_parametrized[:, np.newaxis, :]
    logarithms = np.log(np.abs(values), out=np.zeros_like(values), where=values != 0)
    scaled[:, :, :-1] *= np.where(values != 0, values, 1.0)
    # Relative to the mean logarithm, whatever the units
    scaled[:, :, -1] += np.sum(scaled[:, :, :-1] * (logarithms - logarithms.mean(axis=0)), axis=2)
    return scaled


@dataclass(frozen=True, eq=False)
class _EquationEvidence:
    """The evidence for supports of one equation; `factors` of shape (objects, terms + 1, terms + 1)."""

    factors: Floats
    noise_scale: NoiseScale
    structure_prior: StructurePrior

    def value(self, support: Bools, needed: float = np.inf) -> float:
        """Return minus twice the log-evidence and log prior of a support, or a lower bound not below `needed`."""
        prior, indices = self.structure_prior.of(support), np.flatnonzero(support)
        return prior + minus_twice_log_evidence(self.factors, indices, self.noise_scale, needed - prior)

    def best(self, listed: Iterable[tuple[float, Bools]], best: Bools, value: float) -> tuple[Bools, float]:
        """Return the best support and its value among one of known value and listed ones with lower bounds."""
        for floor, support in sorted(listed, key=lambda pair: pair[0]):
            if floor >= value:
                break
            candidate = self.value(support, value)
            best, value = (support, candidate) if candidate < value else (best, value)
        return best, value

    def neighbours(self, support: Bools, allowed: Bools, most: int) -> Iterator[tuple[float, Bools]]:
        """Yield supports that differ by one term or a swap of two, with lower bounds of their values."""
        objects, outside = len(self.factors), np.flatnonzero(allowed & ~support).tolist()
        for leaving in (-1, *np.flatnonzero(support).tolist()):
            staying = support.copy()
            staying[leaving] &= leaving < 0
            rests = rss_with_added_term(self.factors, np.flatnonzero(staying))
            for entering in outside if leaving < 0 else (-1, *outside):
                changed = staying.copy()
                changed[entering] |= entering >= 0
                size = int(changed.sum())
                if size <= most:
                    least = float(self.noise_scale.deviance(float(rests[entering]), size * objects))
                    cost = coefficient_penalty(size, objects, self.noise_scale)
                    yield least + cost + self.structure_prior.of(changed), changed


def _path(problems: Sequence[LeastSquaresProblem], allowed: Bools, solver: AbstractSolver) -> list[Bools]:
    return [np.asarray(model.support.any(axis=0)) for model in solver.path(problems, 0, allowed)]
