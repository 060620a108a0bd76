"""The search for laws that have terms with constants inside, from a law that has none.

Sets of terms that may explain each equation are proposed along curves that are near, see `term_sets`; those of
all equations are fitted to the trajectories, one equation's after the other, and the law of largest evidence gives
curves that are nearer. The law without such terms stays unless the evidence pays for the larger choice.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference.alike_objects import best_fits, drawn_together, every_way, short_way
from commonlaw.inference.error_search import kind_of
from commonlaw.inference.law_search import LawSearch, best_of, resolved, with_error_models
from commonlaw.inference.poles import has_poles
from commonlaw.inference.ratio_sets import matching_ratios
from commonlaw.inference.search import fit_supports, fit_with, to_scale
from commonlaw.inference.search_problem import SearchProblem
from commonlaw.inference.search_state import ANY_ERROR, NO_ERROR, PLAUSIBLE, evidence_about, is_settled
from commonlaw.inference.term_sets import HOPELESS, MOST_NUMBERS, Start, TermSet, matching_sets
from commonlaw.inference.terms_of_sets import TermsOfSets, terms_of_sets
from commonlaw.inference.told_constants import are_constants_told
from commonlaw.law import Law
from commonlaw.library import Offer
from commonlaw.likelihood import ErrorModel, Estimate, NotPositiveError
from commonlaw.progress import ProgressCallback, Stage

_ROUNDS = 4
"""How often sets are proposed along curves, of the best law or smoothed, and fitted."""

_LOOSE = 0.3
"""Model error from which states are near the measurements, whatever the law."""

_MOST_TRIED, _MOST_FITTED = 30, 8
"""Sets of an equation that are fitted in a round at most, from where they were proposed, and those of them that are
fitted in all ways."""

_FAR, _MARGIN = 2.0, 100.0
"""Twice the log-likelihood that a typical object may lose, relative to the law that fits best so far and besides it: a
law that loses more is not fitted in all ways, whatever the noise is. Along curves of a law that noise explains, a set
of terms that leaves as many times the least sum of squares is not fitted at all."""

_TOGETHER, _MOST_TOGETHER = 3, 4
"""Sets of each equation that are tried with those of the others, and laws of these that are fitted in all ways."""

_RESOLVED = 1.0
"""What a finer mesh may take from twice the log-evidence of a law whose curves it leaves as they are."""

_FEWEST, _MORE = 2, 1
"""Coefficients and constants that a ratio has at least; and by how many more than those of an equation that explains
what was measured another is fitted that may explain it better."""


def with_parametric_terms(found: LawSearch, offers: Sequence[Offer], progress: ProgressCallback) -> LawSearch:
    """Return the law of largest evidence with some of what is offered or without, with the others as its rivals.

    Parameters
    ----------
    found
        The law among plain terms.
    offers
        What an equation may have besides. Those after the first are tried where `may_be_simpler`, and pay for what was
        to choose from before, too.
    progress
        Takes what is being done.
    """
    search, best = _Search(found, _base(found), Offer(())), found
    rows = search.rows_of_found()
    for i, offer in enumerate(offers):
        fewest = _FEWEST if i else -1  # The first is tried in any equation
        if not may_be_simpler(best, fewest):
            break
        search, best, rows = _with_offer(search.offering(offer, fewest), best, rows, progress)
    return best_of(search.listed())


def with_parametric_terms_under_errors(
    found: LawSearch, before: ErrorModel, offers: Sequence[Offer], progress: ProgressCallback
) -> LawSearch:
    """Return the law of largest evidence when what is offered is sought under errors of the measurements, too.

    Beside white noise, if there are any: under noise in proportion small values say more, where such terms may bend.
    Parameters are those of `with_parametric_terms`; the law is found with its errors, and such terms were sought under
    those `before`.
    """
    plain = found.among_plain
    errors = plain.problem.errors
    if not any(each.count for each in offers) or errors.of_law or kind_of(errors) in ("white", kind_of(before)):
        return found
    again = with_parametric_terms(plain, offers, progress)
    again = with_error_models(again, None, (kind_of(errors),), progress)
    return best_of([found, *found.rivals, again, *again.rivals])


def may_be_simpler(found: LawSearch, numbers: int) -> bool:
    """Return whether a law of richer terms may say more than one that was found, or as much in so few numbers."""
    most = int(found.state.supports.sum(axis=1).max())
    return most > numbers or bool(found.beyond_errors)


def _with_offer(
    search: "_Search", best: LawSearch, rows: "tuple[TermSet, ...]", progress: ProgressCallback
) -> "tuple[_Search, LawSearch, tuple[TermSet, ...]]":
    """Return a search with the law of largest evidence, and its terms, on a mesh that is fine enough."""
    curves = _near(search.found)
    if not best.beyond_errors:  # Its solutions are as near as can be
        curves = (_without_processes(best, best.state.estimates),)
    known = _Known()
    while True:
        best, rows, known = _searched(search, rows, curves, known, progress)
        worse = best.state.value >= search.found.state.value
        finer = search.base.points if worse else resolved(best, progress).problem.points
        if finer <= search.base.points:
            return search, best, rows
        progress("fitting laws again on a finer mesh")
        search, near = search.on_finer_mesh(best, finer)
        curves = (near,)


@dataclass(frozen=True)
class _Known:
    """Sets of terms that were proposed for each equation.

    And minus twice the log-evidence of a law that explains what was measured, along whose curves they were.
    """

    sets: tuple[list[list[TermSet]], ...] = ()
    value: float = -np.inf

    def suffice(self, best: LawSearch) -> bool:
        """Return whether others would propose the same, as a law that is as likely was along its own curves.

        A finer mesh may show that it is not.
        """
        return best.state.value < self.value + _RESOLVED


def _searched(
    search: "_Search",
    rows: "tuple[TermSet, ...]",
    curves: Sequence[Sequence[Estimate]],
    known: _Known,
    progress: ProgressCallback,
) -> "tuple[LawSearch, tuple[TermSet, ...], _Known]":
    """Return the law of largest evidence on one mesh, and its terms, from the terms of a law that is known.

    And the sets of terms that were proposed, beside those that are known.
    """
    departs = search.found.state.has_model_error  # Which makes up for what one equation lacks while another has it
    best = search.fit(rows, curves[0]) if departs or any(row.others for row in rows) else None
    best, left = best or search.found, list(curves)
    for number in range(_ROUNDS):
        before, begun, most = best, rows, _most(best, rows)
        near, *left = left
        if not known.suffice(best):
            progress(Stage("proposing terms with constants inside", number / _ROUNDS))
            sets = (*search.proposed(best, rows, near), *known.sets)
            known = _Known(sets, best.state.value if number > 0 and not best.beyond_errors else -np.inf)
        steps = len(rows) + 2  # All equations together, one after the other, and together what is best in each
        done = [partial(_stage, progress, (number + k / steps) / _ROUNDS, 1 / steps / _ROUNDS) for k in range(steps)]
        if len(rows) > 1:
            best, rows = search.better(best, rows, _joint(known.sets, most), _MOST_TOGETHER, near, done[0])
        for j, own in enumerate(zip(*known.sets, strict=True)):
            few = [each for each in _in_turn(own) if each.numbers <= _most(best, rows)[j]]
            listed = [(*rows[:j], each, *rows[j + 1 :]) for each in few[:_MOST_TRIED]]
            best, rows = search.better(best, rows, listed, _MOST_FITTED, near, done[j + 1])
        if len(rows) > 1 and best.beyond_errors:
            best, rows = search.better(best, rows, search.together(begun), _MOST_TOGETHER, near, done[-1])
        if best is not before:
            left = [_without_processes(best, best.state.estimates), *(left if best.beyond_errors else ())]
            rows = search.with_coefficients(rows, best)
            search.near.clear()
        if not left:
            break
    return *_with_fewer(search, best, rows, progress), known


def _with_fewer(
    search: "_Search", best: LawSearch, rows: "tuple[TermSet, ...]", progress: ProgressCallback
) -> "tuple[LawSearch, tuple[TermSet, ...]]":
    """Return the law of largest evidence when terms are left out, one after the other, that it may do without."""
    done, before = partial(_stage, progress, 1.0, 0.0), None
    while best is not before and best is not search.found:
        before, near = best, _without_processes(best, best.state.estimates)
        best, rows = search.better(best, rows, list(search.with_one_less(best, rows)), _MOST_TOGETHER, near, done)
    return best, rows


def _base(found: LawSearch) -> SearchProblem:
    """Return the problem of a search without errors of the law, and how many terms are to choose from `besides`.

    These are all: the terms of a law are not yet among them.
    """
    problem = replace(found.problem, besides=len(found.template.terms))
    return problem.under_white_noise if problem.errors.of_law else problem


def _near(found: LawSearch) -> tuple[tuple[Estimate, ...], ...]:
    """Return states near the true ones, in two ways.

    Those that follow the measurements with the help of the law, but may leave it, and those that were smoothed.
    """
    loose = next((each for each in found.found if each.model_error >= _LOOSE), None)
    smoothed = found.problem.starts
    curves = ([loose.estimates] if loose else []) + [smoothed]
    return tuple(_without_processes(found, each) for each in curves)


def _in_turn(proposed: Sequence[Sequence[TermSet]]) -> list[TermSet]:
    """Return sets of several lists, each the most promising first: the best of each size before the second best."""
    ranks, found = Counter[tuple[int, int]](), dict[TermSet, tuple[int, int]]()
    for number, own in enumerate(proposed):
        for each in own:
            found.setdefault(each, (ranks[number, each.numbers], each.numbers))
            ranks[number, each.numbers] += 1
    return sorted(found, key=lambda each: found[each])


def _without_processes(found: LawSearch, estimates: Sequence[Estimate]) -> tuple[Estimate, ...]:
    """Return estimates whose states are without what other processes there are."""
    width = found.problem.models[0].width
    return tuple(replace(each, states=tuple(own[:, :width] for own in each.states)) for each in estimates)


def _joint(known: Sequence[Sequence[Sequence[TermSet]]], most: Sequence[int]) -> list[tuple[TermSet, ...]]:
    """Return sets for all equations together, of lists of each equation's, the most promising first.

    The first of each, and those with most numbers of the first of each size, up to a size that all have.
    """
    found = dict[tuple[TermSet, ...], None]()
    for proposed in known:
        found |= dict.fromkeys(product(*(own[:_TOGETHER] for own in proposed)))
    in_turn = [_in_turn(own) for own in zip(*known, strict=True)]
    for numbers in range(1, max(most) + 1):
        small = [[each for each in own if each.numbers <= numbers] for own in in_turn]
        if all(small):
            found[tuple(max(own, key=lambda each: each.numbers) for own in small)] = None
    return [rows for rows in found if all(row.numbers <= own for row, own in zip(rows, most, strict=True))]


def _most(best: LawSearch, rows: Sequence[TermSet]) -> list[int]:
    """Return how many numbers are looked at in each equation: where noise explains the law, fewer or few more.

    There is nothing for more numbers to explain where a law leaves less of exact measurements than tells others apart.
    """
    if best.beyond_errors:
        return [MOST_NUMBERS] * len(rows)
    left = sum(each.deviance for each in best.state.estimates) / sum(best.problem.measured)
    more = _MORE if left > best.problem.counted.least else 0
    return [row.numbers + more for row in rows]


@dataclass(frozen=True, eq=False)
class _Search:
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

    def proposed(
        self, best: LawSearch, rows: Sequence[TermSet], estimates: Sequence[Estimate]
    ) -> Iterator[list[list[TermSet]]]:
        """Yield sets of terms of each equation beside the best law so far and its terms, the most promising first.

        With others, and with ratios of sums. Where noise explains the law, equations that may not be simpler keep
        their terms.
        """
        sought = [bool(best.beyond_errors) or row.numbers > self.fewest for row in rows]
        most = {j: own for j, (own, is_sought) in enumerate(zip(_most(best, rows), sought, strict=True)) if is_sought}
        hopeless = HOPELESS if best.beyond_errors else _FAR
        listed = [matching_sets(self.base, estimates, self.offer.terms, most, hopeless)]
        if self.offer.ratios:
            listed.append(matching_ratios(self.base, estimates, self.offer.ratios, most, hopeless))
        for found in listed:
            yield [found.get(j, [row]) for j, row in enumerate(rows)]

    def offering(self, offer: Offer, fewest: int) -> "_Search":
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
            with suppress(CommonlawError, NotPositiveError, np.linalg.LinAlgError):
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
        for k, terms in enumerate(likely):
            done(0.5 + 0.5 * k / len(likely))
            fitted = self.fit(terms, estimates)
            if fitted is not None and fitted.state.value < best.state.value:
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
                if evidence.value(supports) < best.state.value + PLAUSIBLE:
                    yield (*rows[:j], row.without(k), *rows[j + 1 :])

    def together(self, rows: tuple[TermSet, ...]) -> list[tuple[TermSet, ...]]:
        """Return laws of what is best in each equation beside these terms of the others.

        None of it may improve a law alone, as where the terms of two equations make up for each other's errors.
        """
        best = []
        for j in range(len(rows)):
            own = {
                terms[j]: found.state.value
                for terms, found in self.fitted.items()
                if found is not None and terms[:j] == rows[:j] and terms[j + 1 :] == rows[j + 1 :]
            }
            best.append(sorted(own, key=lambda each: own[each])[:_TOGETHER])
        return list(product(*best))

    def likeliest(
        self, listed: Sequence[tuple[TermSet, ...]], estimates: Sequence[Estimate], done: Callable[[float], None]
    ) -> list[tuple[TermSet, ...]]:
        """Return laws that were not fitted yet, those first that fit a typical object best for their numbers.

        By a short way, which may get stuck in single objects; without those that are hopeless beside what was fitted.
        """
        new, ranked = [each for each in dict.fromkeys(listed) if each not in self.fitted], list[tuple[float, int]]()
        for k, rows in enumerate(new):
            done(0.5 * k / len(new))
            with suppress(CommonlawError, NotPositiveError, np.linalg.LinAlgError):
                _, problem, begun = self._posed(rows)
                if rows not in self.near:
                    self.near[rows] = best_fits(problem, estimates, begun, short_way)
                fits = [each.objective for each in self.near[rows]]
                if np.isfinite(fits).all():  # A root of less than zero is not
                    self.typical[rows] = float(np.median(fits))
                    price = sum(row.numbers for row in rows) * float(np.log(np.median(problem.measured)))
                    ranked.append((self.typical[rows] + price, k))
        fitted = [self.typical[rows] for rows, found in self.fitted.items() if found and rows in self.typical]
        most = _FAR * min(fitted, default=np.inf) + _MARGIN
        return [new[k] for _, k in sorted(ranked) if self.typical[new[k]] < most]

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

    def on_finer_mesh(self, best: LawSearch, points: int) -> "tuple[_Search, tuple[Estimate, ...]]":
        """Return the search on a finer mesh, and the estimates of its best law there."""
        plain, estimates = self.found, _without_processes(best, best.state.estimates)
        base, problem = replace(self.base, starts=estimates), plain.problem.about(plain.state.estimates)
        while base.points < points:
            base = base.finer()
        while problem.points < points:
            problem = problem.finer()
        state = fit_supports(problem, plain.state.supports, ANY_ERROR)
        if not state.has_model_error:
            problem, state = to_scale(problem, state)
        plain = replace(plain, problem=problem, state=state, found=(state,))
        return replace(self, found=plain, base=base, fitted={}, near={}, typical={}), base.starts

    def listed(self) -> list[LawSearch]:
        """Return all that was fitted, and the law without others."""
        return [self.found, *(each for each in self.fitted.values() if each is not None)]


def _stage(progress: ProgressCallback, begun: float, share: float, done: float) -> None:
    progress(Stage("fitting laws with constants inside of terms", begun + share * done))
