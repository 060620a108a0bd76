"""Laws whose equations have given sets of terms: fitted to the trajectories once, the likeliest first.

One whose parameters inside terms are not identifiable, or whose denominators vanish, is no law to choose.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import fit_supports, fit_with, rescale_noise
from commonlaw.inference.fit.fit import ANY_ERROR, NO_ERROR, PLAUSIBLE, Fit, Status, best_of
from commonlaw.inference.fit.lack_of_fit import has_poles
from commonlaw.inference.fit.multistart import best_fits, full_schedule, short_schedule, shrink_to_pooled
from commonlaw.inference.fit.parameter_grid import frequencies_in_time
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.propose.integral_ranking import CandidateSupport, Start
from commonlaw.library import Offer, Term, Terms, parse_term
from commonlaw.library.parametric import ParametricTerm, free_name
from commonlaw.likelihood import Estimate
from commonlaw.runtime.parallel import in_parallel


@dataclass(frozen=True, eq=False)
class LawsOfSets:
    """What was fitted so far, by the terms of all equations, besides the law among `plain` terms.

    And of the short way: what is `near`, along the same curves, and what a `typical` object loses. Equations of a law
    that noise explains have more than the `fewest` numbers if they may be simpler by what is offered. All that the
    search among plain terms came by was `explored`.
    """

    plain: Fit
    explored: Sequence[Fit]
    base: SearchProblem
    offer: Offer
    fewest: int = -1
    fitted: dict[tuple[CandidateSupport, ...], Fit] = field(default_factory=dict)
    near: dict[tuple[CandidateSupport, ...], list[Estimate]] = field(default_factory=dict)
    typical: dict[tuple[CandidateSupport, ...], float] = field(default_factory=dict)

    def offering(self, offer: Offer, fewest: int) -> "LawsOfSets":
        """Return the search for laws with something else, which was to choose from, too."""
        base = replace(self.base, besides=self.base.besides + offer.count)
        return replace(self, base=base, offer=offer, fewest=fewest)

    def rows_of_plain(self) -> tuple[CandidateSupport, ...]:
        """Return the terms of the law among plain ones."""
        supports, estimates = self.plain.supports, self.plain.estimates
        return tuple(
            CandidateSupport(
                tuple(np.flatnonzero(own).tolist()),
                starts=(Start(np.array([each.coefficients[j, own] for each in estimates])),),
            )
            for j, own in enumerate(supports)
        )

    def with_coefficients(self, rows: Sequence[CandidateSupport], fit: Fit) -> tuple[CandidateSupport, ...]:
        """Return the terms of a law that was fitted with its coefficients and parameters."""
        whole = np.array([each.coefficients for each in fit.estimates])
        built, found = terms_of_sets(self.base, rows), []
        for j, row in enumerate(rows):
            places, inside = built.places[j], built.parameters[j]
            parameters = tuple(whole[:, j, list(own)] for own in inside)
            found.append(replace(row, starts=(Start(whole[:, j, list(places)], parameters),)))
        return tuple(found)

    def fit(self, rows: tuple[CandidateSupport, ...], estimates: Sequence[Estimate]) -> Fit:
        """Return the fit of a law of these terms, from states that are near."""
        if rows not in self.fitted:
            self.fitted[rows] = self._fit(rows, estimates)
        return self.fitted[rows]

    def better(
        self,
        best: Fit,
        rows: tuple[CandidateSupport, ...],
        listed: Sequence[tuple[CandidateSupport, ...]],
        most: int,
        estimates: Sequence[Estimate],
        done: Callable[[float], None],
    ) -> tuple[Fit, tuple[CandidateSupport, ...]]:
        """Return the law of largest evidence, and its terms: one that is known, or of those listed the likeliest."""
        likely = self.likeliest(listed, estimates, done)[:most]
        fits = in_parallel(lambda each: self.fit(each, estimates), likely, done=_shown(done, 0.5, len(likely)))
        for terms, fit in zip(likely, fits, strict=True):
            if fit < best:
                best, rows = fit, terms
        return best, rows

    def with_one_less(self, best: Fit, rows: tuple[CandidateSupport, ...]) -> Iterator[tuple[CandidateSupport, ...]]:
        """Yield the terms of a law but for one that it may do without, by the likelihood linearised about its fit."""
        built = terms_of_sets(self.base, rows)
        for j, row in enumerate(self.with_coefficients(rows, best)):
            terms = len(row.plain) + len(row.others)
            for k in range(terms) if terms > 1 else ():
                supports = best.supports.copy()
                supports[j, built.indices_of(j, row, k)] = False
                if best.evidence.value(supports) < best.score.total + PLAUSIBLE:
                    yield (*rows[:j], row.without(k), *rows[j + 1 :])
            yield from ((*rows[:j], each, *rows[j + 1 :]) for each in self._reflected(row))

    def _reflected(self, row: CandidateSupport) -> Iterator[CandidateSupport]:
        """Yield terms without a constant that may be part of a sigmoid: of s with parameters p, 1 - s(p) = s(-p)."""
        first = len(self.base.terms.variables.measured)
        intercepts = [k for k, i in enumerate(row.plain) if self.base.terms.names[i] == "1"]
        for less in (row.without(k) for k in intercepts):
            for m, other in enumerate(less.others):
                if isinstance(other, ParametricTerm) and not other.tied and _is_sigmoid(other, first):
                    place = less.places_of(len(less.plain) + m)
                    yield replace(less, starts=tuple(_with_opposite(each, place, m) for each in less.starts))

    def together(self, rows: tuple[CandidateSupport, ...]) -> list[tuple[CandidateSupport, ...]]:
        """Return laws of what is best in each equation with these terms of the others.

        None of it may improve a law alone, as where the terms of two equations make up for each other's errors.
        """
        best = []
        for j in range(len(rows)):
            own = {
                terms[j]: fit.score
                for terms, fit in self.fitted.items()
                if fit.is_usable and terms[:j] == rows[:j] and terms[j + 1 :] == rows[j + 1 :]
            }
            best.append(sorted(own, key=lambda each: own[each])[: tried_together(len(rows))])
        return list(product(*best))

    def likeliest(
        self,
        listed: Sequence[tuple[CandidateSupport, ...]],
        estimates: Sequence[Estimate],
        done: Callable[[float], None],
    ) -> list[tuple[CandidateSupport, ...]]:
        """Return laws that were not fitted yet, those first that fit a typical object best for their numbers.

        By a short way, which may get stuck in single objects; without those that are hopeless next to fitted ones.
        """
        new, ranked = [each for each in dict.fromkeys(listed) if each not in self.fitted], list[tuple[float, int]]()
        short = [each for each in new if each not in self.near]
        near = in_parallel(lambda each: self._shortly(each, estimates), short, done=_shown(done, 0.0, len(short)))
        self.near.update(zip(short, near, strict=True))
        price = float(np.log(np.median(self.base.measured)))
        for k, rows in enumerate(new):
            fits = [each.objective for each in self.near[rows]]
            if fits and np.isfinite(fits).all():  # A root of less than zero is not
                self.typical[rows] = float(np.median(fits))
                ranked.append((self.typical[rows] + price * sum(row.numbers for row in rows), k))
        fitted = [self.typical[rows] for rows, fit in self.fitted.items() if fit.is_usable and rows in self.typical]
        relative, margin = settings.MAX_DEVIANCE
        most = relative * min(fitted, default=np.inf) + margin
        return [new[k] for _, k in sorted(ranked) if self.typical[new[k]] < most]

    def _shortly(self, rows: tuple[CandidateSupport, ...], estimates: Sequence[Estimate]) -> list[Estimate]:
        """Return the fit of a law of these terms by a short way, along curves that are near; none if there is none."""
        try:
            return best_fits(*self._posed(rows, estimates), short_schedule)
        except (CommonlawError, np.linalg.LinAlgError):  # Terms that cannot be written, or are nowhere finite
            return []

    def _posed(
        self, rows: tuple[CandidateSupport, ...], estimates: Sequence[Estimate]
    ) -> tuple[SearchProblem, Sequence[Estimate], list[Floats]]:
        """Return the problem of fitting a law, states that are near, and the coefficients that fits begin with."""
        built = terms_of_sets(self.base, rows)
        models = tuple(replace(each, terms=built.terms) for each in self.base.models)
        besides = self.base.besides - int(built.terms.is_factor.sum())
        problem = replace(self.base, models=models, known=built.known, besides=besides, solver=None)
        several = max(len(row.starts) for row in rows)
        begun = [[row.starts[min(k, len(row.starts) - 1)] for row in rows] for k in range(several)]
        return problem, estimates, [built.coefficients(each) for each in begun]

    def _fit(self, rows: tuple[CandidateSupport, ...], estimates: Sequence[Estimate]) -> Fit:
        try:
            alone, near, begun = self._posed(rows, estimates)
            if not len(alone.terms):
                return Fit.failed(self.base, self.plain.supports, Status.WITHOUT_EFFECT)
            fit = Fit.failed(alone, alone.allowed, Status.NOT_COMPUTABLE)
            for way in (short_schedule, full_schedule):
                known = self.near.get(rows) if way is short_schedule else None
                free = known or best_fits(alone, near, begun, way)
                if not free:
                    break
                problem, best = shrink_to_pooled(alone, free)
                fit = fit_with(problem, problem.allowed, NO_ERROR, best)
                if not fit.is_usable or fit.has_converged:
                    break
            return _acceptable(fit)
        except (CommonlawError, np.linalg.LinAlgError):
            return Fit.failed(self.base, self.plain.supports, Status.REFUSED)

    def on_finer_mesh(self, best: Fit, points: int) -> "tuple[LawsOfSets, tuple[Estimate, ...]]":
        """Return the search on a finer mesh, and the estimates of its best law there."""
        plain, estimates = self.plain, without_processes(best, best.estimates)
        base, problem = replace(self.base, starts=estimates), plain.problem.about(plain.estimates)
        while base.points < points:
            base = base.finer()
        while problem.points < points:
            problem = problem.finer()
        plain = best_of([rescale_noise(fit_supports(problem, plain.supports, ANY_ERROR))])
        finer = replace(self, plain=plain, explored=(plain,), base=base, fitted={}, near={}, typical={})
        return finer, base.starts

    def listed(self) -> list[Fit]:
        """Return all that was fitted, and the law among plain terms."""
        return [self.plain, *(fit for fit in self.fitted.values() if fit.is_usable)]


def _is_sigmoid(other: ParametricTerm, first: int) -> bool:
    """Return whether the sum of a term and of that with opposite parameters is one, at random points."""
    points = np.random.default_rng(0).uniform(0.5, 2.0, (settings.GENERIC_POINTS, first + len(other.parameters)))
    opposite = points.copy()
    opposite[:, first:] *= -1
    with np.errstate(all="ignore"):
        total = other.term.evaluate(points) + other.term.evaluate(opposite)
    return bool(other.parameters and (np.abs(total - 1) < settings.ROUNDING).all())


def _with_opposite(start: Start, places: Sequence[int], m: int) -> Start:
    """Return a start with the opposite coefficient, and parameters, of one of the terms with parameters."""
    coefficients = start.coefficients.copy()
    coefficients[:, places] *= -1
    parameters = tuple(-own if i == m else own for i, own in enumerate(start.parameters))
    return Start(coefficients, parameters)


def _acceptable(fit: Fit) -> Fit:
    """Return a fit under noise of the size that it leaves, as one that failed where its evidence means nothing."""
    fit = rescale_noise(replace(fit, problem=replace(fit.problem, starts=fit.estimates))) if fit.is_usable else fit
    if not fit.is_usable:
        return fit
    if not fit.has_converged:
        return fit.but(Status.NOT_CONVERGED)
    if not are_parameters_identifiable(fit):
        return fit.but(Status.NOT_IDENTIFIABLE)
    return fit.but(Status.HAS_POLE) if has_poles(fit.problem, fit.estimates) else fit


def tried_together(equations: int) -> int:
    """Return how many sets of each equation are tried with those of the others."""
    sets, laws = settings.MAX_JOINT_LAWS
    return next(count for count in range(sets, 0, -1) if count == 1 or count**equations <= laws)


def _shown(done: Callable[[float], None], begun: float, count: int) -> Callable[[int], None]:
    """Return what takes how many of some pieces of work are done, which are half of a stage."""
    return lambda many: done(begun + 0.5 * many / count)


def without_processes(fit: Fit, estimates: Sequence[Estimate]) -> tuple[Estimate, ...]:
    """Return estimates whose states are without what other processes there are."""
    width = fit.problem.models[0].width
    return tuple(replace(each, states=tuple(own[:, :width] for own in each.states)) for each in estimates)


@dataclass(frozen=True, eq=False)
class TermsOfSets:
    """The terms of a law, and where those of each equation, and the parameters of its others, are among them.

    Known coefficients have the shape (objects, equations, terms), NaN where they are to be found.
    """

    terms: Terms
    known: Floats
    places: tuple[tuple[int, ...], ...]
    parameters: tuple[tuple[tuple[int, ...], ...], ...]

    def indices_of(self, equation: int, row: CandidateSupport, k: int) -> list[int]:
        """Return the indices of a term of an equation, by its place in the equation's set, and of its parameters."""
        inside = self.parameters[equation][k - len(row.plain)] if k >= len(row.plain) else ()
        return [*(self.places[equation][place] for place in row.places_of(k)), *inside]

    def coefficients(self, starts: Sequence[Start]) -> Floats:
        """Return what a fit begins with, shape (objects, equations, terms), from the starts of each equation."""
        found = np.nan_to_num(self.known)
        for j, start in enumerate(starts):
            found[:, j, list(self.places[j])] = start.coefficients
            for indices, own in zip(self.parameters[j], start.parameters, strict=True):
                found[:, j, list(indices)] = own
        return found


def terms_of_sets(problem: SearchProblem, rows: Sequence[CandidateSupport]) -> TermsOfSets:
    """Return the terms of a law whose equations have these."""
    whole = problem.models[0].terms
    variables, certain = whole.variables, np.nan_to_num(problem.known)
    plain = sorted({i for row in rows for i in row.plain} | {*np.flatnonzero(certain.any(axis=(0, 1))).tolist()})
    names, written = list[str](), list[list[tuple[list[str], list[str]]]]()
    for row in rows:
        written.append([])
        for other in row.others:
            new = list[str]()
            for each in other.shared_parameters:
                new.append(free_name(each, (*variables.measured, *names, *new)))
            names += new
            written[-1].append((other.expressions(variables, new), new))
    variables = replace(variables, parameters=tuple(names))
    texts = list(
        dict.fromkeys(text for own in written for listed, _ in own for text in listed)
    )  # Equations share those without parameters
    texts = [*(whole.terms[i].expression(whole.variables.names) for i in plain), *texts]
    parameters = (Term(parameter=variables.index(name)) for name in names)
    terms = Terms(variables, (*(parse_term(each, variables) for each in texts), *parameters))
    known = np.zeros((*certain.shape[:2], len(terms)))
    known[:, :, : len(plain)] = certain[:, :, plain]
    places, inside = [], []
    for j, (row, own) in enumerate(zip(rows, written, strict=True)):
        places.append(
            (*(plain.index(i) for i in row.plain), *(texts.index(text) for listed, _ in own for text in listed))
        )
        inside.append(tuple(tuple(len(texts) + names.index(each) for each in new) for _, new in own))
        known[:, j, [*places[-1], *(i for each in inside[-1] for i in each)]] = np.nan
    return TermsOfSets(terms, known, tuple(places), tuple(inside))


def are_parameters_identifiable(fit: Fit) -> bool:
    """Return whether measurements tell the parameters of a law apart from what stands before their terms.

    Of ``V s/(K + s)`` for instance they tell V/K alone where s is small compared with K. There the likelihood is
    nothing like the one that is linearised about a fit, and evidence that is computed from that means nothing. And of a
    drive that no trial has a whole cycle of they do not tell that it repeats itself, nor of one with less than two
    samples a cycle (Nyquist) its frequency, as slower ones have the same values there.
    """
    terms, trials = fit.problem.terms, fit.problem.trials
    first, times = len(terms.variables.measured), [trial.times for trial in trials]
    longest, shortest = max(map(np.ptp, times)), np.concatenate([*map(np.diff, times)]).min()
    for column in frequencies_in_time(terms):
        own = terms.parameters[column - first]
        frequencies = [np.abs(each.coefficients[:, own]).sum() for each in fit.estimates]
        if np.median(frequencies) * longest < 2 * np.pi or np.max(frequencies) * shortest > np.pi:
            return False
    equations, chosen = np.nonzero(fit.supports)
    constant = ~terms.is_factor[chosen]
    bent = constant | np.array(terms.have_parameters, dtype=bool)[chosen]
    squares = []
    for each, estimate in zip(fit.evidence.problems, fit.estimates, strict=True):
        columns = each.factor[:, np.flatnonzero(fit.supports)]
        found = estimate.coefficients[fit.supports]
        try:
            inverse = np.linalg.inv(np.linalg.qr(columns, mode="r"))
        except np.linalg.LinAlgError:
            return False
        with np.errstate(over="ignore"):
            squares.append(found**2 / np.sum(inverse**2, axis=1))
    signs = np.sign([each.coefficients[fit.supports] for each in fit.estimates])
    least = np.where(np.ptp(signs, axis=0) == 0, np.median(squares, axis=0), np.min(squares, axis=0))
    lost = bent & ~(least >= settings.SIGNIFICANT**2)
    return not any(
        lost[own].sum() > 1 and (lost & constant)[own].any() for own in equations == equations[:, np.newaxis]
    )
