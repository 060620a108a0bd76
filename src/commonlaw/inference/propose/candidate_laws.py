"""Laws whose equations have given sets of terms: fitted to the trajectories once, the likeliest first."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.annealing import fit_supports, fit_with, to_scale
from commonlaw.inference.fit.multistart import best_fits, drawn_together, every_way, short_way
from commonlaw.inference.fit.practical_identifiability import are_constants_told
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.state import ANY_ERROR, NO_ERROR, PLAUSIBLE, evidence_about, is_settled
from commonlaw.inference.fit.validity import has_poles
from commonlaw.inference.propose.integral_ranking import Start, TermSet
from commonlaw.inference.search.law_search import LawSearch
from commonlaw.law import Law
from commonlaw.library import Constant, Offer, Terms, parse_term
from commonlaw.library.parametric import free_name
from commonlaw.likelihood import Estimate, NotPositiveError
from commonlaw.parallel import in_parallel

FAR, _MARGIN = 2.0, 100.0
"""Twice the log-likelihood that a typical object may lose, relative to the law that fits best so far and besides it: a
law that loses more is not fitted in all ways, whatever the noise is. Along curves of a law that noise explains, a set
of terms that leaves as many times the least sum of squares is not fitted at all."""

_TOGETHER, _LAWS = 3, 27
"""Sets of each equation that are tried with those of the others, and laws of these, at most."""


@dataclass(frozen=True, eq=False)
class LawsOfSets:
    """What was fitted so far, by the terms of all equations.

    And of the short way: what is `near`, along the same curves, and what a `typical` object loses. Equations of a law
    that noise explains have more than the `fewest` numbers if they may be simpler by what is offered.
    """

    found: LawSearch
    base: SearchProblem
    offer: Offer
    fewest: int = -1
    fitted: dict[tuple[TermSet, ...], LawSearch | None] = field(default_factory=dict)
    near: dict[tuple[TermSet, ...], list[Estimate]] = field(default_factory=dict)
    typical: dict[tuple[TermSet, ...], float] = field(default_factory=dict)

    def offering(self, offer: Offer, fewest: int) -> "LawsOfSets":
        """Return the search for laws with something else, which was to choose from, too."""
        base = replace(self.base, besides=self.base.besides + offer.count)
        return replace(self, base=base, offer=offer, fewest=fewest)

    def rows_of_found(self) -> tuple[TermSet, ...]:
        """Return the terms of the law without others."""
        supports, estimates = self.found.state.supports, self.found.state.estimates
        return tuple(
            TermSet(
                tuple(np.flatnonzero(own).tolist()),
                starts=(Start(np.array([each.coefficients[j, own] for each in estimates])),),
            )
            for j, own in enumerate(supports)
        )

    def with_coefficients(self, rows: Sequence[TermSet], fitted: LawSearch) -> tuple[TermSet, ...]:
        """Return the terms of a law that was fitted with its coefficients and constants."""
        whole = np.array([each.coefficients for each in fitted.state.estimates])
        built, found = terms_of_sets(self.base, rows), []
        for j, row in enumerate(rows):
            places, inside = built.places[j], built.constants[j]
            constants = tuple(whole[:, j, list(own)] for own in inside)
            found.append(replace(row, starts=(Start(whole[:, j, list(places)], constants),)))
        return tuple(found)

    def fit(self, rows: tuple[TermSet, ...], estimates: Sequence[Estimate]) -> LawSearch | None:
        """Return the fit of a law of these terms, from states that are near; none if it cannot be fitted."""
        if rows not in self.fitted:
            self.fitted[rows] = None
            with suppress(CommonlawError, np.linalg.LinAlgError):
                self.fitted[rows] = self._fit(rows, estimates)
        return self.fitted[rows]

    def better(
        self,
        best: LawSearch,
        rows: tuple[TermSet, ...],
        listed: Sequence[tuple[TermSet, ...]],
        most: int,
        estimates: Sequence[Estimate],
        done: Callable[[float], None],
    ) -> tuple[LawSearch, tuple[TermSet, ...]]:
        """Return the law of largest evidence, and its terms: one that is known, or of those listed the likeliest."""
        likely = self.likeliest(listed, estimates, done)[:most]
        fits = in_parallel(lambda each: self.fit(each, estimates), likely, done=_shown(done, 0.5, len(likely)))
        for terms, fitted in zip(likely, fits, strict=True):
            if fitted is not None and fitted.state.score < best.state.score:
                best, rows = fitted, terms
        return best, rows

    def with_one_less(self, best: LawSearch, rows: tuple[TermSet, ...]) -> Iterator[tuple[TermSet, ...]]:
        """Yield the terms of a law but for one that it may do without, by the likelihood linearised about its fit."""
        evidence, built = evidence_about(best.problem, best.state), terms_of_sets(self.base, rows)
        for j, row in enumerate(self.with_coefficients(rows, best)):
            terms = len(row.plain) + len(row.others)
            for k in range(terms) if terms > 1 else ():
                supports = best.state.supports.copy()
                supports[j, built.indices_of(j, row, k)] = False
                if evidence.value(supports) < best.state.score.total + PLAUSIBLE:
                    yield (*rows[:j], row.without(k), *rows[j + 1 :])

    def together(self, rows: tuple[TermSet, ...]) -> list[tuple[TermSet, ...]]:
        """Return laws of what is best in each equation beside these terms of the others.

        None of it may improve a law alone, as where the terms of two equations make up for each other's errors.
        """
        best = []
        for j in range(len(rows)):
            own = {
                terms[j]: found.state.score
                for terms, found in self.fitted.items()
                if found is not None and terms[:j] == rows[:j] and terms[j + 1 :] == rows[j + 1 :]
            }
            best.append(sorted(own, key=lambda each: own[each])[: tried_together(len(rows))])
        return list(product(*best))

    def likeliest(
        self, listed: Sequence[tuple[TermSet, ...]], estimates: Sequence[Estimate], done: Callable[[float], None]
    ) -> list[tuple[TermSet, ...]]:
        """Return laws that were not fitted yet, those first that fit a typical object best for their numbers.

        By a short way, which may get stuck in single objects; without those that are hopeless beside what was fitted.
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
        fitted = [self.typical[rows] for rows, found in self.fitted.items() if found and rows in self.typical]
        most = FAR * min(fitted, default=np.inf) + _MARGIN
        return [new[k] for _, k in sorted(ranked) if self.typical[new[k]] < most]

    def _shortly(self, rows: tuple[TermSet, ...], estimates: Sequence[Estimate]) -> list[Estimate]:
        """Return the fit of a law of these terms by a short way, along curves that are near; none if there is none."""
        with suppress(CommonlawError, np.linalg.LinAlgError):
            _, problem, begun = self._posed(rows)
            return best_fits(problem, estimates, begun, short_way)
        return []

    def _posed(self, rows: tuple[TermSet, ...]) -> "tuple[TermsOfSets, SearchProblem, list[Floats]]":
        """Return the terms of a law, the problem of fitting it, and the coefficients that fits begin with."""
        built = terms_of_sets(self.base, rows)
        models = tuple(replace(each, terms=built.terms) for each in self.base.models)
        besides = self.base.besides - int(built.terms.is_factor.sum())
        problem = replace(self.base, models=models, known=built.known, besides=besides)
        several = max(len(row.starts) for row in rows)
        begun = [[row.starts[min(k, len(row.starts) - 1)] for row in rows] for k in range(several)]
        return built, problem, [built.coefficients(each) for each in begun]

    def _fit(self, rows: tuple[TermSet, ...], estimates: Sequence[Estimate]) -> LawSearch:
        (built, problem, begun), template = self._posed(rows), self.found.template
        alone = problem
        for way in (short_way, every_way):
            known = self.near.get(rows) if way is short_way else None
            problem, best = drawn_together(alone, known or best_fits(alone, estimates, begun, way))
            state = fit_with(problem, problem.allowed, NO_ERROR, best)
            if is_settled(problem, state):
                break
        problem, state = to_scale(replace(problem, starts=state.estimates), state)
        if not (is_settled(problem, state) and are_constants_told(problem, state)) or has_poles(problem, state):
            raise NotPositiveError
        law = Law(built.terms, template.schema, template.order, template.objects, np.nan_to_num(built.known))
        law = replace(law, provenance=template.provenance)
        return LawSearch(law, problem, state, None, (state,))

    def on_finer_mesh(self, best: LawSearch, points: int) -> "tuple[LawsOfSets, tuple[Estimate, ...]]":
        """Return the search on a finer mesh, and the estimates of its best law there."""
        plain, estimates = self.found, without_processes(best, best.state.estimates)
        base, problem = replace(self.base, starts=estimates), plain.problem.about(plain.state.estimates)
        while base.points < points:
            base = base.finer()
        while problem.points < points:
            problem = problem.finer()
        problem, state = to_scale(problem, fit_supports(problem, plain.state.supports, ANY_ERROR))
        plain = replace(plain, problem=problem, state=state, found=(state,))
        return replace(self, found=plain, base=base, fitted={}, near={}, typical={}), base.starts

    def listed(self) -> list[LawSearch]:
        """Return all that was fitted, and the law without others."""
        return [self.found, *(each for each in self.fitted.values() if each is not None)]


def tried_together(equations: int) -> int:
    """Return how many sets of each equation are tried with those of the others."""
    return next(count for count in range(_TOGETHER, 0, -1) if count == 1 or count**equations <= _LAWS)


def _shown(done: Callable[[float], None], begun: float, count: int) -> Callable[[int], None]:
    """Return what takes how many of some pieces of work are done, which are half of a stage."""
    return lambda many: done(begun + 0.5 * many / count)


def without_processes(found: LawSearch, estimates: Sequence[Estimate]) -> tuple[Estimate, ...]:
    """Return estimates whose states are without what other processes there are."""
    width = found.problem.models[0].width
    return tuple(replace(each, states=tuple(own[:, :width] for own in each.states)) for each in estimates)


@dataclass(frozen=True, eq=False)
class TermsOfSets:
    """The terms of a law, and where those of each equation, and the constants of its others, are among them.

    Known coefficients have the shape (objects, equations, terms), NaN where they are to be found.
    """

    terms: Terms
    known: Floats
    places: tuple[tuple[int, ...], ...]
    constants: tuple[tuple[tuple[int, ...], ...], ...]

    def indices_of(self, equation: int, row: TermSet, k: int) -> list[int]:
        """Return the indices of a term of an equation, by its place in the equation's set, and of its constants."""
        inside = self.constants[equation][k - len(row.plain)] if k >= len(row.plain) else ()
        return [*(self.places[equation][place] for place in row.places_of(k)), *inside]

    def coefficients(self, starts: Sequence[Start]) -> Floats:
        """Return what a fit begins with, shape (objects, equations, terms), from the starts of each equation."""
        found = np.nan_to_num(self.known)
        for j, start in enumerate(starts):
            found[:, j, list(self.places[j])] = start.coefficients
            for indices, own in zip(self.constants[j], start.constants, strict=True):
                found[:, j, list(indices)] = own
        return found


def terms_of_sets(problem: SearchProblem, rows: Sequence[TermSet]) -> TermsOfSets:
    """Return the terms of a law whose equations have these."""
    whole = problem.models[0].terms
    variables, certain = whole.variables, np.nan_to_num(problem.known)
    plain = sorted({i for row in rows for i in row.plain} | {*np.flatnonzero(certain.any(axis=(0, 1))).tolist()})
    names, written = list[str](), list[list[tuple[list[str], list[str]]]]()
    for row in rows:
        written.append([])
        for other in row.others:
            new = list[str]()
            for each in other.constants:
                new.append(free_name(each, (*variables.measured, *names, *new)))
            names += new
            written[-1].append((other.expressions(variables, new), new))
    variables = replace(variables, constants=tuple(names))
    texts = list(
        dict.fromkeys(text for own in written for listed, _ in own for text in listed)
    )  # Equations share those without constants
    texts = [*(whole.terms[i].expression(whole.variables.names) for i in plain), *texts]
    constants = (Constant(variables.index(name)) for name in names)
    terms = Terms(variables, (*(parse_term(each, variables) for each in texts), *constants))
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
