"""Fits of laws with parametric terms to the trajectories, each once, in the order of a prescreening.

A law with unidentifiable parameters, or with a denominator that vanishes along its solutions, is rejected.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import fit_supports, fit_with, rescale_noise
from commonlaw.inference.fit.fit import ANY_ERROR, NO_ERROR, PLAUSIBLE, Fit, Status, best_fit
from commonlaw.inference.fit.lack_of_fit import has_pole
from commonlaw.inference.fit.multistart import full_schedule, multistart, short_schedule, shrink_to_pooled
from commonlaw.inference.fit.parameter_grid import frequencies_in_time
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.propose.integral_ranking import CandidateSupport, Start
from commonlaw.library import Offer, Term, Terms, parse_term
from commonlaw.library.parametric import ParametricTerm, free_name
from commonlaw.likelihood import Estimate
from commonlaw.runtime.parallel import in_parallel


@dataclass(frozen=True, eq=False)
class ParametricSearch:
    """The search among laws with offered terms, with all fits so far by the terms of their equations.

    It starts from the best law among plain terms, and all fits explored in its search. Equations without lack of fit
    are only replaced if they have more parameters than `fewest`. Quick fits `near` the current curves are kept, and
    their median objectives over objects.
    """

    plain: Fit
    explored: Sequence[Fit]
    base: SearchProblem
    offer: Offer
    fewest: int = -1
    fitted: dict[tuple[CandidateSupport, ...], Fit] = field(default_factory=dict)
    near: dict[tuple[CandidateSupport, ...], list[Estimate]] = field(default_factory=dict)
    typical: dict[tuple[CandidateSupport, ...], float] = field(default_factory=dict)

    def rows_of_plain(self) -> tuple[CandidateSupport, ...]:
        """Return the best law among plain terms as candidate supports."""
        supports, estimates = self.plain.supports, self.plain.estimates
        return tuple(
            CandidateSupport(
                tuple(np.flatnonzero(support).tolist()),
                starts=(Start(np.array([estimate.coefficients[j, support] for estimate in estimates])),),
            )
            for j, support in enumerate(supports)
        )

    def with_coefficients(self, rows: Sequence[CandidateSupport], fit: Fit) -> tuple[CandidateSupport, ...]:
        """Return the supports of a fit with its estimates as starting values."""
        whole = np.array([estimate.coefficients for estimate in fit.estimates])
        assembled, result = assemble_terms(self.base, rows), []
        for j, row in enumerate(rows):
            places, inside = assembled.places[j], assembled.parameters[j]
            parameters = tuple(whole[:, j, list(own)] for own in inside)
            result.append(replace(row, starts=(Start(whole[:, j, list(places)], parameters),)))
        return tuple(result)

    def fit(self, rows: tuple[CandidateSupport, ...], estimates: Sequence[Estimate]) -> Fit:
        """Return the fit of a law with these terms, starting from estimated states."""
        if rows not in self.fitted:
            self.fitted[rows] = self._fit(rows, estimates)
        return self.fitted[rows]

    def improve(
        self,
        best: Fit,
        rows: tuple[CandidateSupport, ...],
        listed: Sequence[tuple[CandidateSupport, ...]],
        most: int,
        estimates: Sequence[Estimate],
        done: Callable[[float], None],
    ) -> tuple[Fit, tuple[CandidateSupport, ...]]:
        """Return the law of largest evidence, and its terms, among the best and the most promising of those listed."""
        promising = self.prescreen(listed, estimates, done)[:most]
        fits = in_parallel(lambda each: self.fit(each, estimates), promising, done=_shown(done, 0.5, len(promising)))
        for terms, fit in zip(promising, fits, strict=True):
            if fit < best:
                best, rows = fit, terms
        return best, rows

    def drop_one_term(self, best: Fit, rows: tuple[CandidateSupport, ...]) -> Iterator[tuple[CandidateSupport, ...]]:
        """Yield laws with one term less that are plausible by the likelihood linearised about the best."""
        assembled = assemble_terms(self.base, rows)
        for j, row in enumerate(self.with_coefficients(rows, best)):
            terms = len(row.plain) + len(row.others)
            for k in range(terms) if terms > 1 else ():
                supports = best.supports.copy()
                supports[j, assembled.indices_of(j, row, k)] = False
                if best.evidence.value(supports) < best.score.total + PLAUSIBLE:
                    yield (*rows[:j], row.without(k), *rows[j + 1 :])
            yield from ((*rows[:j], each, *rows[j + 1 :]) for each in self._reflected(row))

    def _reflected(self, row: CandidateSupport) -> Iterator[CandidateSupport]:
        """Yield supports whose constant is absorbed by a sigmoid s with parameters p: 1 - s(p) = s(-p)."""
        first = len(self.base.terms.variables.measured)
        intercepts = [k for k, i in enumerate(row.plain) if self.base.terms.names[i] == "1"]
        for less in (row.without(k) for k in intercepts):
            for m, other in enumerate(less.others):
                if isinstance(other, ParametricTerm) and not other.tied and _is_sigmoid(other, first):
                    place = less.places_of(len(less.plain) + m)
                    yield replace(less, starts=tuple(_with_opposite(start, place, m) for start in less.starts))

    def combine_equations(self, rows: tuple[CandidateSupport, ...]) -> list[tuple[CandidateSupport, ...]]:
        """Return laws that combine the best supports of each equation, given these terms of the others.

        A change in two equations may improve the fit although neither does alone, since errors of one equation can
        compensate for those of the other.
        """
        best = []
        for j in range(len(rows)):
            own = {
                terms[j]: fit.score
                for terms, fit in self.fitted.items()
                if fit.is_usable and terms[:j] == rows[:j] and terms[j + 1 :] == rows[j + 1 :]
            }
            best.append(sorted(own, key=lambda each: own[each])[: max_joint_supports(len(rows))])
        return list(product(*best))

    def prescreen(
        self,
        listed: Sequence[tuple[CandidateSupport, ...]],
        estimates: Sequence[Estimate],
        done: Callable[[float], None],
    ) -> list[tuple[CandidateSupport, ...]]:
        """Return laws that are not fitted yet, ranked by the BIC of a quick fit to the median object.

        A quick fit may fail in single objects. Laws far worse than those fitted so far are left out.
        """
        new, ranked = [each for each in dict.fromkeys(listed) if each not in self.fitted], list[tuple[float, int]]()
        short = [each for each in new if each not in self.near]
        near = in_parallel(lambda each: self._quick_fit(each, estimates), short, done=_shown(done, 0.0, len(short)))
        self.near.update(zip(short, near, strict=True))
        penalty = float(np.log(np.median(self.base.measured)))
        for k, rows in enumerate(new):
            fits = [each.objective for each in self.near[rows]]
            if fits and np.isfinite(fits).all():  # Not so for the root of a negative number
                self.typical[rows] = float(np.median(fits))
                ranked.append((self.typical[rows] + penalty * sum(row.numbers for row in rows), k))
        fitted = [self.typical[rows] for rows, fit in self.fitted.items() if fit.is_usable and rows in self.typical]
        relative, margin = settings.MAX_DEVIANCE
        most = relative * min(fitted, default=np.inf) + margin
        return [new[k] for _, k in sorted(ranked) if self.typical[new[k]] < most]

    def _quick_fit(self, rows: tuple[CandidateSupport, ...], estimates: Sequence[Estimate]) -> list[Estimate]:
        """Return a quick fit of a law with these terms along estimated states; empty if there is none."""
        try:
            return multistart(*self._fit_problem(rows, estimates), short_schedule)
        except (CommonlawError, np.linalg.LinAlgError):  # Terms that cannot be parsed, or are nowhere finite
            return []

    def _fit_problem(
        self, rows: tuple[CandidateSupport, ...], estimates: Sequence[Estimate]
    ) -> tuple[SearchProblem, Sequence[Estimate], list[Floats]]:
        assembled = assemble_terms(self.base, rows)
        models = tuple(replace(model, terms=assembled.terms) for model in self.base.models)
        excluded = self.base.excluded_terms - int(assembled.terms.is_factor.sum())
        problem = replace(self.base, models=models, known=assembled.known, excluded_terms=excluded, solver=None)
        several = max(len(row.starts) for row in rows)
        begun = [[row.starts[min(k, len(row.starts) - 1)] for row in rows] for k in range(several)]
        return problem, estimates, [assembled.coefficients(each) for each in begun]

    def _fit(self, rows: tuple[CandidateSupport, ...], estimates: Sequence[Estimate]) -> Fit:
        try:
            alone, near, begun = self._fit_problem(rows, estimates)
            if not len(alone.terms):
                return Fit.failed(self.base, self.plain.supports, Status.WITHOUT_EFFECT)
            fit = Fit.failed(alone, alone.allowed, Status.NOT_COMPUTABLE)
            for way in (short_schedule, full_schedule):
                known = self.near.get(rows) if way is short_schedule else None
                free = known or multistart(alone, near, begun, way)
                if not free:
                    break
                problem, best = shrink_to_pooled(alone, free)
                fit = fit_with(problem, problem.allowed, NO_ERROR, best)
                if not fit.is_usable or fit.has_converged:
                    break
            return _acceptable(fit)
        except (CommonlawError, np.linalg.LinAlgError):
            return Fit.failed(self.base, self.plain.supports, Status.REFUSED)

    def on_finer_mesh(self, best: Fit, points: int) -> "tuple[ParametricSearch, tuple[Estimate, ...]]":
        """Return the search on a finer mesh, and the estimates of the best law there."""
        plain, estimates = self.plain, without_processes(best, best.estimates)
        base = replace(self.base, starts=estimates).with_points(points)
        problem = plain.problem.about(plain.estimates).with_points(points)
        plain = best_fit([rescale_noise(fit_supports(problem, plain.supports, ANY_ERROR))])
        finer = replace(self, plain=plain, explored=(plain,), base=base, fitted={}, near={}, typical={})
        return finer, base.starts


def _is_sigmoid(other: ParametricTerm, first: int) -> bool:
    """Return whether s(p) + s(-p) = 1 at random points, for a term s with parameters p."""
    points = np.random.default_rng(0).uniform(0.5, 2.0, (settings.GENERIC_POINTS, first + len(other.parameters)))
    opposite = points.copy()
    opposite[:, first:] *= -1
    with np.errstate(all="ignore"):
        total = other.term.evaluate(points) + other.term.evaluate(opposite)
    return bool(other.parameters and (np.abs(total - 1) < settings.ROUNDING).all())


def _with_opposite(start: Start, places: Sequence[int], m: int) -> Start:
    """Return starting values with the signs of the coefficient and parameters of the m-th parametric term changed."""
    coefficients = start.coefficients.copy()
    coefficients[:, places] *= -1
    parameters = tuple(-parameter if i == m else parameter for i, parameter in enumerate(start.parameters))
    return Start(coefficients, parameters)


def _acceptable(fit: Fit) -> Fit:
    """Return a fit under its residual noise, with a status of failure where the Laplace approximation does not hold."""
    fit = rescale_noise(replace(fit, problem=replace(fit.problem, starts=fit.estimates))) if fit.is_usable else fit
    if not fit.is_usable:
        return fit
    if not fit.has_converged:
        return fit.but(Status.NOT_CONVERGED)
    if not are_parameters_identifiable(fit):
        return fit.but(Status.NOT_IDENTIFIABLE)
    has_poles = any(has_pole(fit.problem, o, estimate) for o, estimate in enumerate(fit.estimates))
    return fit.but(Status.HAS_POLE) if has_poles else fit


def max_joint_supports(equations: int) -> int:
    """Return how many supports of each equation are combined with those of the others."""
    sets, laws = settings.MAX_JOINT_LAWS
    return next(count for count in range(sets, 0, -1) if count == 1 or count**equations <= laws)


def _shown(done: Callable[[float], None], begun: float, count: int) -> Callable[[int], None]:
    """Return a progress callback for `count` tasks, which are half of a stage."""
    return lambda many: done(begun + 0.5 * many / count)


def without_processes(fit: Fit, estimates: Sequence[Estimate]) -> tuple[Estimate, ...]:
    """Return estimates without the states of error processes."""
    width = fit.problem.models[0].width
    return tuple(
        replace(estimate, states=tuple(state[:, :width] for state in estimate.states)) for estimate in estimates
    )


@dataclass(frozen=True, eq=False)
class AssembledTerms:
    """The terms of a law, with the indices of each equation's terms and of the parameters of its others.

    Known coefficients have the shape (objects, equations, terms), NaN where they are estimated.
    """

    terms: Terms
    known: Floats
    places: tuple[tuple[int, ...], ...]
    parameters: tuple[tuple[tuple[int, ...], ...], ...]

    def indices_of(self, equation: int, row: CandidateSupport, k: int) -> list[int]:
        """Return the indices of the k-th term of an equation, and of its parameters."""
        inside = self.parameters[equation][k - len(row.plain)] if k >= len(row.plain) else ()
        return [*(self.places[equation][place] for place in row.places_of(k)), *inside]

    def coefficients(self, starts: Sequence[Start]) -> Floats:
        """Return starting values, shape (objects, equations, terms), from those of each equation."""
        result = np.nan_to_num(self.known)
        for j, start in enumerate(starts):
            result[:, j, list(self.places[j])] = start.coefficients
            for indices, parameter in zip(self.parameters[j], start.parameters, strict=True):
                result[:, j, list(indices)] = parameter
        return result


def assemble_terms(problem: SearchProblem, rows: Sequence[CandidateSupport]) -> AssembledTerms:
    """Return the terms of a law with these supports in its equations."""
    whole = problem.models[0].terms
    variables, certain = whole.variables, np.nan_to_num(problem.known)
    plain = sorted({i for row in rows for i in row.plain} | {*np.flatnonzero(certain.any(axis=(0, 1))).tolist()})
    names, written = list[str](), list[list[tuple[list[str], list[str]]]]()
    for row in rows:
        written.append([])
        for other in row.others:
            new = list[str]()
            for shared_parameter in other.shared_parameters:
                new.append(free_name(shared_parameter, (*variables.measured, *names, *new)))
            names += new
            written[-1].append((other.expressions(variables, new), new))
    variables = replace(variables, parameters=tuple(names))
    texts = list(dict.fromkeys(text for own in written for listed, _ in own for text in listed))
    texts = [*(whole.terms[i].expression(whole.variables.names) for i in plain), *texts]
    parameters = (Term(parameter=variables.index(name)) for name in names)
    terms = Terms(variables, (*(parse_term(text, variables) for text in texts), *parameters))
    known = np.zeros((*certain.shape[:2], len(terms)))
    known[:, :, : len(plain)] = certain[:, :, plain]
    places, inside = [], []
    for j, (row, own) in enumerate(zip(rows, written, strict=True)):
        places.append(
            (*(plain.index(i) for i in row.plain), *(texts.index(text) for listed, _ in own for text in listed))
        )
        inside.append(tuple(tuple(len(texts) + names.index(each) for each in new) for _, new in own))
        known[:, j, [*places[-1], *(i for each in inside[-1] for i in each)]] = np.nan
    return AssembledTerms(terms, known, tuple(places), tuple(inside))


def are_parameters_identifiable(fit: Fit) -> bool:
    """Return whether the nonlinear parameters of a law and the coefficients of their terms are separately identifiable.

    In ``V s/(K + s)`` for instance only V/K is, where s is small compared with K. There the likelihood is far from the
    normal distribution about the estimates, and the Laplace approximation of the evidence does not hold. A periodic
    forcing is identifiable if some trial contains a whole cycle, and its frequency is below the Nyquist limit of two
    samples a cycle.
    """
    terms, trials = fit.problem.terms, fit.problem.trials
    first, times = len(terms.variables.measured), [trial.times for trial in trials]
    longest, shortest = max(map(np.ptp, times)), np.concatenate([*map(np.diff, times)]).min()
    for column in frequencies_in_time(terms):
        own = terms.parameters[column - first]
        frequencies = [np.abs(estimate.coefficients[:, own]).sum() for estimate in fit.estimates]
        if np.median(frequencies) * longest < 2 * np.pi or np.max(frequencies) * shortest > np.pi:
            return False
    equations, chosen = np.nonzero(fit.supports)
    constant = ~terms.is_factor[chosen]
    is_nonlinear = constant | np.array(terms.have_parameters, dtype=bool)[chosen]
    squares = []
    for problem, estimate in zip(fit.evidence.problems, fit.estimates, strict=True):
        columns = problem.factor[:, np.flatnonzero(fit.supports)]
        found = estimate.coefficients[fit.supports]
        try:
            inverse = np.linalg.inv(np.linalg.qr(columns, mode="r"))
        except np.linalg.LinAlgError:
            return False
        with np.errstate(over="ignore"):
            squares.append(found**2 / np.sum(inverse**2, axis=1))
    signs = np.sign([estimate.coefficients[fit.supports] for estimate in fit.estimates])
    least = np.where(np.ptp(signs, axis=0) == 0, np.median(squares, axis=0), np.min(squares, axis=0))
    is_lost = is_nonlinear & ~(least >= settings.SIGNIFICANT**2)
    return not any(
        is_lost[own].sum() > 1 and (is_lost & constant)[own].any() for own in equations == equations[:, np.newaxis]
    )
