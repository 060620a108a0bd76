"""The search for the law of one order: screened terms, the best law so far, and the steps of the pipeline."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial, wraps
from typing import Concatenate, ParamSpec, TypeVar

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.diagnostics import Diagnostic
from commonlaw.discovery.best_so_far import Best
from commonlaw.discovery.method import ModelStructure, parsed
from commonlaw.discovery.regression import DerivativeRegression, suitable_differentiation
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.data.noise import known_noise
from commonlaw.inference.fit.final_score import final, score_of_order
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.propose.few_measurements import under_proportional_noise, with_ranked_supports
from commonlaw.inference.propose.latent_states import drives, with_forcing_step, with_latent_state
from commonlaw.inference.propose.parametric import (
    is_truncated_series,
    may_be_simpler,
    with_parametric_terms,
    with_parametric_terms_under_errors,
)
from commonlaw.inference.propose.screening import screen_terms, terms_by_score_test
from commonlaw.inference.score.score import Score
from commonlaw.inference.search.error_models import choose_errors, fit_each_kind
from commonlaw.inference.search.law_search import (
    PATH,
    choose_interpolation,
    resolved,
    search_on_finer_mesh,
    search_supports,
)
from commonlaw.inference.search.pool import Pool
from commonlaw.inference.search.setup import error_kinds, transform_trials, with_interpolation
from commonlaw.inference.search.strange_objects import Apart, StrangeObject
from commonlaw.law import Step
from commonlaw.library import Offer, Order, ParametricTerm, SelectedLibrary, Terms, highest_order, order_of_each
from commonlaw.runtime.fit_options import FitOptions
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.progress import ProgressCallback, announce, check_memory, part, silent
from commonlaw.runtime.time_limit import OutOfTimeError
from commonlaw.solvers import BestSubset, parse_solver
from commonlaw.text import counted
from commonlaw.trials import Trials
from commonlaw.trials.transformations import with_logarithms, without_objects


@dataclass(frozen=True, eq=False)
class Screened:
    """The structure with the candidate terms kept by a screening, shape (terms,); all if they are few."""

    whole: ModelStructure
    terms: Terms
    kept: Bools

    @classmethod
    def of(cls, trials: Trials, structure: ModelStructure) -> "Screened":
        """Return the structure after a screening of its terms on trials."""
        terms, schema = structure.terms(trials.schema), trials.schema
        known = structure.known_coefficients(schema, trials.objects)
        needed = (structure.shared_coefficients(schema) | ~np.isnan(known).any(axis=0)).any(axis=0)
        return cls(structure, terms, screen_terms(trials, terms, known, np.asarray(needed)))

    @cached_property
    def structure(self) -> ModelStructure:
        """The structure with the plain terms that were kept."""
        if self.kept.all() and not self.whole.library.parametric(self.terms.variables):
            return self.whole
        names = tuple(self.terms.names[i] for i in np.flatnonzero(self.kept))
        return replace(self.whole, library=SelectedLibrary(self.whole.library, names))

    @cached_property
    def offers(self) -> tuple[Offer, ...]:
        """What the library offers besides plain terms."""
        return tuple(self.whole.library.offers(self.terms.variables))

    @property
    def steps(self) -> tuple[Step, ...]:
        """The step of the history that records it."""
        if self.kept.all():
            return ()
        why = "terms that explain most of the smoothed rates; none of the others improves the law"
        return (Step("screening", f"{int(self.kept.sum())} of {counted(len(self.terms), 'term')}", why),)

    def among(self, fit: Fit) -> "Screened":
        """Return the structure with the candidate terms of a fit."""
        return replace(self, kept=np.isin(self.terms.names, fit.problem.terms.names))

    def with_missed(self, fit: Fit) -> "Screened | None":
        """Return the structure with readmitted terms by a score test of a fit; None if there are none."""
        missed = terms_by_score_test(fit, self.terms)
        return replace(self, kept=self.kept | missed) if missed.any() else None


@dataclass(frozen=True, eq=False)
class Candidate:
    """The best law of one order so far, among the screened terms, with its rivals and the steps of its history.

    Trials are transformed by `transform_trials`. If the candidate `is_coarse`, only a coarse mesh was tried, on which
    the law has a model error. It `has_errors` if its error model was chosen, and it
    `was_offered` richer terms if these were tried in place of a misfit. If it is less probable than that `of_fewer`
    objects, the others are strange and `apart`.
    """

    screened: Screened
    pool: Pool
    steps: Sequence[Step]
    transformed: Trials
    has_richer: bool
    is_coarse: bool = False
    is_of_higher_degree: bool = False
    has_errors: bool = False
    was_offered: bool = False
    apart: Apart | None = None
    of_fewer: "Candidate | None" = None

    def __lt__(self, other: "Candidate") -> bool:
        """Return whether the score is less: the best candidate is the least."""
        return self.score < other.score

    @property
    def order(self) -> Order:
        return self.pool.best.problem.order

    @property
    def total_order(self) -> int:
        return sum(order_of_each(self.order, len(self.pool.best.supports)))

    @property
    def most_terms(self) -> int:
        return int(self.pool.best.supports.sum(axis=1).max())

    @cached_property
    def is_simple(self) -> bool:
        """Whether the law has no lack of fit, and richer terms were searched or would not need fewer coefficients."""
        return self.fits and (self.has_richer or (self.has_few_terms and not self.is_of_higher_degree))

    @property
    def suffices(self) -> bool:
        """Whether no other order needs to be tried: the law is simple, and if of richer terms, of two numbers each.

        Objects that are strange to a law of this order may share one of another order with the others.
        """
        return self.apart is None and self.is_simple and not (self.has_richer and may_be_simpler(self.pool.best, 2))

    @property
    def fits(self) -> bool:
        """Whether the law has no lack of fit, and is determined by the measurements."""
        return self.pool.is_determined and not self.pool.best.lack_of_fit

    @property
    def has_few_terms(self) -> bool:
        """Whether the law has few coefficients; if it is of higher degree, a third of its plain terms."""
        most = settings.MAX_TERMS_OF_SIMPLE_LAW
        if self.is_of_higher_degree:  # A truncated series has a third of them
            most = max(most, len(self.pool.best.problem.terms) // 3)
        return not (self.most_terms > most or is_truncated_series(self.pool.best))

    @cached_property
    def score(self) -> Score:
        """The score, comparable between orders."""
        return self.apart.score if self.apart else score_of_order(self.pool.best)

    @cached_property
    def reported_score(self) -> Score:
        """The score that is reported, on a resolved mesh."""
        return final(self.pool.best)[0].score


P = ParamSpec("P")
T = TypeVar("T")


def _kept(
    step: "Callable[Concatenate[CandidateSearch, P], Candidate]",
) -> "Callable[Concatenate[CandidateSearch, P], Candidate]":
    """Let a step of a search keep the candidate that it returns."""

    @wraps(step)
    def keeping(search: "CandidateSearch", /, *args: P.args, **kwargs: P.kwargs) -> Candidate:
        candidate = step(search, *args, **kwargs)
        if search.best is not None:
            search.best.take(search, candidate)
        return candidate

    return keeping


@dataclass(frozen=True, eq=False)
class CandidateSearch:
    """The steps of the search for laws; each takes a candidate and returns a better one.

    The `strange` objects were left out before. The search of all others keeps its `best` candidates.
    """

    trials: Trials
    options: FitOptions
    progress: ProgressCallback
    strange: tuple[StrangeObject, ...] = ()
    best: "Best[CandidateSearch, Candidate] | None" = None

    def of_objects(self, names: Sequence[str]) -> "CandidateSearch":
        """Return the search among the trials of some of the objects, without a word on its progress."""
        trials = self.trials.with_trials([trial for trial in self.trials if trial.object in names])
        return replace(self, trials=trials, progress=silent, best=None)

    def has_not_tried(self, *untried: str) -> None:
        """Keep in words what would remain to be tried if the search ended here."""
        if self.best is not None:
            self.best.untried = untried

    def in_time(self, step: Callable[[], T], otherwise: T, what: str = "") -> T:
        """Return what a step returns, or something else if its time is over.

        What was left out is kept in words, by default the first of what the search has not tried.
        """
        try:
            return step()
        except OutOfTimeError:
            if self.best is None:
                raise
        self.best.left_out += [what] if what else self.best.untried[:1]
        return otherwise

    def without_strange_of(self, candidate: Candidate) -> "CandidateSearch":
        """Return the search without the strange objects of a candidate, which begins again, with the law of fewer."""
        strange = candidate.apart.objects if candidate.apart else ()
        trials = without_objects(self.trials, tuple(stray.name for stray in strange))
        search = replace(self, trials=trials, strange=(*self.strange, *strange))
        if self.best is not None:
            self.best.begin_again()
            if candidate.of_fewer:
                self.best.take(search, candidate.of_fewer)
        return search

    @_kept
    def plain(self, structure: ModelStructure, is_coarse: bool) -> Candidate:
        """Return the best law among plain terms, and terms offered first, under the chosen interpolation of inputs.

        With `is_coarse`, only the coarse mesh is tried if the law has a model error there: another order may be
        faster, or fit better.
        """
        options = self.options
        screened = Screened.of(with_logarithms(self.trials, options.log_states), structure)
        transformed = transform_trials(self.trials, options.log_states, options.input_interpolation)
        first = next(iter(structure.library.offers(screened.terms.variables)))
        if first.count or options.latent_states:
            return self._candidate(screened, transformed, None, richer=True)
        coarse = None
        if is_coarse:
            coarse = self._among(transformed, screened.structure, self.progress)
            if coarse.best.has_model_error:
                return Candidate(screened, coarse, (), transformed, has_richer=False, is_coarse=True)
        return self._candidate(screened, transformed, coarse, richer=False)

    @_kept
    def finer(self, candidate: Candidate) -> Candidate:
        """Return a candidate searched on finer meshes if only a coarse one was tried."""
        if not candidate.is_coarse:
            return candidate
        return self._candidate(candidate.screened, candidate.transformed, candidate.pool, richer=False)

    @_kept
    def resolved(self, candidate: Candidate) -> Candidate:
        """Return a candidate on a refined mesh; unchanged if it has a lack of fit."""
        if candidate.pool.best.lack_of_fit:
            return candidate
        return replace(candidate, pool=resolved(candidate.pool, self.progress))

    @_kept
    def of_higher_degree(self, candidate: Candidate) -> Candidate:
        """Return the best law among plain terms of higher degree, if it fits with few terms; a simple law as it is.

        Their fit is linear, so they come before parametric terms, latent states and other orders. A law of higher
        degree with a lack of fit, or a truncated series, extrapolates worse than one of fewer terms.
        """
        whole, higher = candidate.screened.whole, candidate.screened.whole.library.higher
        if candidate.is_simple or candidate.has_richer or candidate.is_coarse or not higher:
            return candidate
        self.progress("searching among terms of higher degree")
        screened = Screened.of(candidate.transformed, replace(whole, library=higher))
        more = self._candidate(screened, candidate.transformed, None, richer=False)
        more = replace(more, is_of_higher_degree=True)
        return more if more.fits and more.has_few_terms and more.score < candidate.score else candidate

    @_kept
    def with_first_offer(self, candidate: Candidate) -> Candidate:
        """Return the law with terms of the first offer, if it is simple; a law of one term an equation as it is.

        The offer must have fewer terms than a later one. Central forces of vectors are an example:
        they come before terms of higher degree in all variables, and before other orders.
        """
        if candidate.has_richer or not may_be_simpler(candidate.pool.best, 1):
            return candidate
        offers = self._offers(candidate.screened)[1]
        first = next((i for i, offer in enumerate(offers) if offer.count), len(offers))
        most = max((offer.count for offer in offers[first + 1 :]), default=0)
        is_smaller = most > 0 and offers[first].count < most
        if not is_smaller:
            return candidate
        more = self._candidate(candidate.screened, candidate.transformed, candidate.pool, richer=True, most=first + 1)
        return replace(more, has_richer=True) if more.is_simple else candidate

    @_kept
    def richer(self, candidate: Candidate) -> Candidate:
        """Return the law of largest evidence among terms of higher degree, parametric terms and latent states."""
        candidate = self.of_higher_degree(candidate)
        if candidate.is_simple or candidate.has_richer or not any(x.count for x in self._offers(candidate.screened)[1]):
            return candidate
        return self._candidate(candidate.screened, candidate.transformed, candidate.pool, richer=True)

    @_kept
    def in_place_of_misfit(self, candidate: Candidate) -> Candidate:
        """Return the law of richer terms if it fits with few terms, and explains more than errors of the plain law.

        Then no other order, errors or latent state need be tried, of which each takes longer.
        """
        plain, offers = candidate.pool.best, self._offers(candidate.screened)[1]
        if candidate.is_simple or candidate.has_richer or candidate.is_coarse or not any(x.count for x in offers):
            return candidate
        more = self._candidate(candidate.screened, candidate.transformed, candidate.pool, richer=True, most=len(offers))
        more, candidate = replace(more, has_richer=True), replace(candidate, was_offered=True)
        if not more.suffices:
            return candidate
        kinds = error_kinds(self.options.errors, candidate.transformed.schema)
        misfits = fit_each_kind(plain.problem, plain.supports, kinds)
        return more if all(more.score < score_of_order(fit) for fit in misfits) else candidate

    @_kept
    def with_errors(self, candidate: Candidate) -> Candidate:
        """Return the candidate under the chosen error model, searched again if that readmits screened-out terms.

        The choice is repeated on the refined mesh if a coarser one had hidden the departures from white noise.
        """
        progress, may_hide = self.progress, self.options.errors == "auto"
        while True:
            propose = partial(self._by_derivatives, candidate.screened)
            pool = choose_errors(candidate.pool, errors=self.options.errors, propose=propose, progress=progress)
            if candidate.has_richer:
                offers, before = self._offers(candidate.screened)[1], candidate.pool.best.problem.errors
                pool = with_parametric_terms_under_errors(pool, before, offers, progress)
            screened = candidate.screened.among(pool.plain or pool.best)
            problem = pool.best.problem
            more = screened.with_missed(pool.best) if problem.solver and problem.errors else None
            if more is not None:
                candidate = self._candidate(more, candidate.transformed, None, richer=candidate.has_richer)
                continue
            fine = resolved(pool, progress)
            candidate = replace(candidate, screened=screened, pool=fine, has_errors=True)
            if not may_hide or pool.best.reason_for_error_model or not fine.best.reason_for_error_model:
                return candidate
            may_hide = False

    def _candidate(
        self, screened: Screened, transformed: Trials, plain: Pool | None, *, richer: bool, most: int | None = None
    ) -> Candidate:
        """Return the best law under the chosen interpolation of inputs.

        `plain` is the result of a search among plain terms, if it was done before. With `richer`, offered terms are
        added: all offers, or the first `most`, in place of the misfit of the plain law.
        """

        def begin(trials: Trials, progress: ProgressCallback) -> Pool:
            done = plain if trials is transformed else None
            if not richer:
                return self._plain(screened, trials, progress, done)
            pool = done or self._plain(screened, trials, part(progress, 0.0, 0.2))
            driven, offers = self._offers(screened)
            offers = offers[:most]
            if any(offer.count for offer in offers):
                in_place = most is not None
                pool = with_parametric_terms(pool, offers, part(progress, 0.2, 1.0), in_place_of_errors=in_place)
            return with_forcing_step(pool, driven) if driven else pool

        options = self.options
        pool, steps = choose_interpolation(
            begin,
            transformed,
            input_interpolation=options.input_interpolation,
            progress=self.progress,
            is_chosen=richer and plain is not None,
        )
        chosen = pool.best.problem.trials.schema.input_interpolation
        if chosen != transformed.schema.input_interpolation:
            transformed = with_interpolation(transformed, chosen)
        if richer and most is None:
            # Only once, as it takes longest, under the interpolation chosen without a latent state
            pool = self._with_latent_state(screened, pool, transformed)
        return Candidate(screened, pool, steps, transformed, richer and most is None)

    def _plain(
        self, screened: Screened, trials: Trials, progress: ProgressCallback, coarse: Pool | None = None
    ) -> Pool:
        """Return the supports of largest evidence after mesh refinement and readmission of screened-out terms."""
        pool = search_on_finer_mesh(coarse or self._among(trials, screened.structure, progress), progress)
        while more := screened.with_missed(pool.best):
            progress("searching again with screened-out terms that improve the law")
            screened = more
            pool = search_on_finer_mesh(self._among(trials, more.structure, progress), progress)
        if pool.best.problem.least_variance >= 1 and not (pool.best.lack_of_fit or pool.is_determined):
            # With exact measurements a needless term may fit the discretization error of a coarse mesh
            pool = resolved(pool, progress)
        return pool

    def _among(self, trials: Trials, structure: ModelStructure, progress: ProgressCallback) -> Pool:
        options, terms = self.options, structure.terms(trials.schema)
        _check_effort(trials, len(terms), options.max_samples)
        kinds = error_kinds(options.errors, trials.schema)
        pool = search_supports(
            trials,
            terms,
            structure.known_coefficients(trials.schema, trials.objects),
            solver=parsed(options.solver, parse_solver) or PATH,
            differentiation=suitable_differentiation(trials, structure.order),
            noise=known_noise(options.noise, trials),
            huber_threshold=options.huber_threshold,
            kinds=kinds,
            most_samples=options.max_samples,
            progress=progress,
        )
        return under_proportional_noise(with_ranked_supports(pool, progress), kinds)

    def _with_latent_state(self, screened: Screened, pool: Pool, trials: Trials) -> Pool:
        """Return the pool with laws with a latent state, if one is requested or the law may lack one."""
        # With more objects it takes minutes; with one trial a latent state is hardly identifiable
        few = len(trials.objects) <= settings.OBJECT_GROUPS[0] and len(trials) > 1
        may_have_one = few and may_be_simpler(pool.best, settings.MAX_TERMS_WITHOUT_LATENT_STATE)
        seeks = self.options.latent_states or (may_have_one and screened.whole.library.seeks_latent_states)
        if screened.whole.order != 1 or not seeks:
            return pool
        return with_latent_state(pool, trials, most_samples=self.options.max_samples, progress=self.progress)

    def _offers(self, screened: Screened) -> tuple[tuple[ParametricTerm, ...], list[Offer]]:
        """Return candidate forcing terms, and all offers of richer terms including these."""
        variables = screened.terms.variables
        forced = self.options.latent_states and highest_order(screened.whole.order) == 2
        driven = drives(variables) if forced else ()
        first, *richer = screened.offers
        return driven, [replace(first, terms=(*first.terms, *driven)), *richer]

    def _by_derivatives(self, screened: Screened, fit: Fit) -> Bools | None:
        """Return the support selected by regression on derivatives among the same terms; None if it fails."""
        try:
            structure = screened.among(fit).structure
            most = fit.problem.most_terms  # Larger supports are not chosen, and take a long proof where samples are few
            solver = BestSubset(largest=most) if most < BestSubset.largest else None
            method = DerivativeRegression(solver=solver, n_resamples=0)
            return method.find(self.trials.without_noise(), structure, self.progress).support
        except CommonlawError:
            return None


def _check_effort(trials: Trials, terms: int, most_samples: int) -> None:
    """Refuse terms whose matrices exceed the memory, and announce a long search."""
    objects, samples = len(trials.objects), min(sum(map(len, trials)), most_samples)
    of = f"{counted(len(trials), 'trial')} of {counted(objects, 'object')} with {counted(terms, 'term')}"
    what = f"the trajectory likelihood of {of}"
    # Matrices (coefficients, coefficients) of each object, and arrays (samples, terms), that are held at a time
    size = 8 * (6 * objects * (terms * len(trials.schema.states)) ** 2 + 20 * samples * terms)
    check_memory(what, size, "take a smaller library")
    seconds = 0.1 * objects + 5e-3 * len(trials) + 3e-4 * samples
    announce(what, seconds, Diagnostic("fewer-trials-or-regression"))
