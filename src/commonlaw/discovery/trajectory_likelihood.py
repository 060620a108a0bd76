"""States and coefficients fitted together to what was measured, terms chosen by their evidence."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar, Literal, get_args

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.diagnostics import Diagnostic
from commonlaw.discovery.candidate import MAX_TERMS_OF_SIMPLE_LAW, Candidate
from commonlaw.discovery.derivative_regression import DerivativeRegression, suitable_differentiation
from commonlaw.discovery.many_objects import Fitting, law_of_parts
from commonlaw.discovery.method import AbstractMethod, parsed, refuse_what_does_not_fit
from commonlaw.discovery.model_structure import ModelStructure
from commonlaw.discovery.orders import of_best_order, those_found, with_order_said
from commonlaw.discovery.screened import Screened
from commonlaw.effort import announce, check_memory
from commonlaw.errors import CommonlawError, check_choice
from commonlaw.inference import (
    CHOSEN,
    MAX_SAMPLES,
    PATH,
    CovarianceKind,
    ErrorKind,
    LawSearch,
    as_followed,
    begin_search,
    choose_errors,
    drives,
    error_kinds,
    explained_on_finer_mesh,
    explains_whole_trials,
    finish,
    known_noise,
    may_be_of_first_order,
    may_be_of_lower_order,
    may_be_simpler,
    most_explaining,
    resolved,
    search_supports,
    with_drive_said,
    with_interpolation,
    with_parametric_terms,
    with_parametric_terms_under_errors,
    with_unmeasured_state,
)
from commonlaw.integration import BETWEEN
from commonlaw.law import Law, Provenance
from commonlaw.law.text import order_in_words
from commonlaw.library import Offer, Order, ParametricTerm, TiedTerms, highest_order, one_order, order_of_each
from commonlaw.likelihood import HUBER_THRESHOLD, ObservationModel
from commonlaw.parallel import check_n_jobs, threads
from commonlaw.progress import ProgressCallback, part
from commonlaw.solvers import AbstractSolver, parse_solver
from commonlaw.trials import Trials, TrialStream
from commonlaw.trials.logarithms import with_logarithms
from commonlaw.validation import check_whole_number
from commonlaw.wording import counted

_FACTORS, _ARRAYS = 6, 20
"""Matrices of an object's coefficients, and arrays of a value for each sample and term, that are held at a time."""

_PLAIN = 0.2
"""Share of the time that plain terms are searched in where others are, too. It is only shown, while it works."""

_FEW = 3
"""Coefficients of an equation of higher order more than which may stand for richer terms of a lower order."""

_FEW_OBJECTS = 10
"""Objects up to which a library asks for such a state by itself: with more it takes minutes."""

_SECONDS_AN_OBJECT, _SECONDS_A_TRIAL, _SECONDS_A_SAMPLE = 0.1, 5e-3, 3e-4


@dataclass(frozen=True, kw_only=True)
class TrajectoryLikelihood(AbstractMethod):
    """Maximum likelihood of whole trajectories with free initial states; supports are compared by their evidence.

    The law knows how accurate it is. See `commonlaw.inference`, and docs/method.md for every step.

    Parameters
    ----------
    positive
        States that are above zero and modelled on a logarithmic scale, in laws of first order: errors of their
        measurement are shares of the state, and so is their noise; forecasts and their bands stay above zero. The law
        itself is in the units of the states.
    input_between
        The interpolation of inputs between samples: ``"held"``, ``"linear"`` or ``"cubic"``, see `Law.predict`.
        ``"auto"``: straight lines, unless the evidence of the law for another is strong.
    noise
        Standard deviation of each state's measurement noise by name. Default: it is estimated, but for states whose
        measurements have standard deviations of their own (``noise_columns`` of the trials).
    errors
        The errors beside white noise that are estimated with the law. ``"auto"``: the kind that the measurements ask
        for, if white noise does not explain them. ``"white"``: none; ``"proportional"``: noise that grows with the
        states; ``"correlated"``: errors of the measurements that have a memory; ``"walk"``, ``"force"``: a law that
        errs, by a random walk or by a smooth force.
    huber_threshold
        Standard deviations of noise beyond which a measurement counts as an outlier; infinite for none.
    covariance
        How the coefficients' covariance is found. ``"likelihood"``: from the curvature of the likelihood.
        ``"bootstrap"``: from the scatter of coefficients when blocks of the trials are drawn anew, for noise that is
        neither normal nor alike everywhere.
    partial_pooling
        Whether forecasts draw coefficients to their mean over objects as far as these are alike, see
        `Law.partial_pooling`. The law itself has those of each object's own trials.
    solver
        Whose path lists the candidates of each equation, or its text such as ``"best-subset"``; it has no value of its
        hyperparameter, as the evidence chooses. Default: best subset selection.
    max_samples
        Of more samples so many are fitted, and the law says so: thinned as far as these still tell noise from motion,
        and if that is not enough, in segments spread over the trials of each object. All of them tell the noise.
    unmeasured
        1 to ask, too, for a state that nobody measured: a depot or a drive that decays, a pool that is used up, one
        that keeps what it gets, a compartment; in laws with an equation of second order a drive. The law without it is
        one of the hypotheses. What it is counted in is said by the history of the law.
    seed
        Of the bootstrap.
    n_jobs
        Threads that share the objects and the searches; the law is the same for any number. Default: one for each core,
        or as many as the environment variable ``OMP_NUM_THREADS`` says.

    Raises
    ------
    CommonlawError
        If a text names nothing, or a value does not fit.
    """

    orders: ClassVar[tuple[int, ...]] = (1, 2)
    takes_mixed_orders: ClassVar[bool] = True
    takes_streams: ClassVar[bool] = True
    takes_noise_columns: ClassVar[bool] = True
    takes_constants: ClassVar[bool] = True

    positive: Sequence[str] = ()
    input_between: str = "auto"
    noise: Mapping[str, float] | None = None
    errors: ErrorKind | Literal["auto"] = "auto"
    huber_threshold: float = HUBER_THRESHOLD
    covariance: CovarianceKind = "likelihood"
    partial_pooling: bool = True
    solver: AbstractSolver | str | None = None
    max_samples: int = MAX_SAMPLES
    unmeasured: int = 0
    seed: int = 0
    n_jobs: int = field(default=-1, compare=False)

    def __post_init__(self) -> None:
        check_whole_number("seed", self.seed, 0)
        check_n_jobs(self.n_jobs)
        check_whole_number("unmeasured", self.unmeasured, 0, 1)
        check_whole_number("max_samples", self.max_samples, 100, 10**9)
        check_choice("covariance", self.covariance, get_args(CovarianceKind))
        check_choice("errors", self.errors, ("auto", *get_args(ErrorKind)))
        check_choice("input_between", self.input_between, ("auto", *BETWEEN))
        ObservationModel(np.ones(1), self.huber_threshold)  # Refuses thresholds that do not fit
        solver = parsed(self.solver, parse_solver)
        if solver is not None and solver.hyperparameter is not None:
            raise CommonlawError("solver-with-value", solver=solver)
        object.__setattr__(self, "solver", solver)

    def find(self, trials: Trials | TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        refuse_what_does_not_fit(self, trials, structure)
        if isinstance(trials, TrialStream):
            return self._of_parts(trials, structure, progress)
        orders = order_of_each(structure.order, len(trials.schema.states))
        with threads(self.n_jobs):
            best, *_ = self._ranked(trials, structure, [(each,) for each in orders], progress)[0]
            return self._finished(trials, best, progress)

    def _of_parts(self, trials: TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        """Return the law of objects that are fitted part by part, under white noise if nothing else is named."""
        inside = structure.parametric(trials.schema) or structure.ratios(trials.schema)
        if inside or self.unmeasured:
            what = "unmeasured=1" if self.unmeasured else "a term with constants inside"
            raise CommonlawError("stream-with-option", what=what)
        errors = "white" if self.errors == "auto" else self.errors
        return law_of_parts(
            trials,
            partial(_found_in, replace(self, errors=errors, covariance="likelihood", partial_pooling=False), structure),
            Fitting(self.noise, errors, self.huber_threshold, self.covariance, self.seed),
            lambda law: universal_in(law, structure),
            self.partial_pooling,
            progress,
        )

    def find_order(
        self,
        trials: Trials,
        structure: ModelStructure,
        possible: Sequence[Sequence[int]],
        progress: ProgressCallback,
    ) -> Law:
        """Return the law of largest evidence among those of several orders, each as probable beforehand.

        Higher orders are tried where a plain law of the lowest may be wrong or could be simpler, and richer terms where
        the best plain law may. All laws have white noise, if that explains what the best of them leaves; else each has
        the errors of its own largest evidence. An order of which no law can be found is left out.

        Parameters
        ----------
        trials
            What was measured.
        structure
            What is sought, whatever its order.
        possible
            The orders that each state may have.
        progress
            Takes the text of each step.

        Raises
        ------
        CommonlawError
            If no law of any order can be found: what `find` says of the last.
        """
        with threads(self.n_jobs):
            ranked, refused = self._ranked(trials, structure, possible, progress)
            best, *others = ranked
            if others and self.errors == "auto" and not explains_whole_trials(best.search):
                lacking = [
                    each for each in others if each.search.state.has_model_error and not each.search.approximation
                ]
                found, _ = those_found(lambda each: self._with_errors(trials, each, progress), lacking)
                ranked = [best, *(each for each in others if each not in lacking), *found]
                best = ranked[most_explaining([each.search for each in ranked])]
            law = self._finished(trials, best, progress)
        against = [(each.order, each.score - best.score) for each in ranked if each is not best]
        return with_order_said(law, against, refused)

    def _ranked(
        self,
        trials: Trials,
        structure: ModelStructure,
        possible: Sequence[Sequence[int]],
        progress: ProgressCallback,
    ) -> tuple[list[Candidate], list[CommonlawError]]:
        """Return the best law of each order that is tried, the largest evidence first, and why others have none."""

        def begun(order: Order) -> Candidate:
            own = replace(structure, order=order)
            if several:
                progress(f"seeking laws of order {order_in_words(order, trials.schema.states)}")
            refuse_what_does_not_fit(self, trials, own)
            screened = Screened.of(with_logarithms(trials, self.positive), own)
            found = self._begun(trials, screened, several and order == lowest, progress)
            if several and order == lowest:
                found = self._of_higher_degree(found, progress)
            may_end = several and order == lowest and not found.search.lack_of_fit
            return self._richer(found, progress) if may_end and not found.is_simple else found

        several = any(len(each) > 1 for each in possible)
        lowest = one_order([each[0] for each in possible])
        found, refused = of_best_order(begun, possible, lambda each: each.score, lambda each: each.is_simple)
        best = min(found, key=lambda each: each.score)
        if several and not (best.is_simple and not may_be_of_lower_order(best.search)):
            found = [self._finer(each, progress) for each in found]
        found = self._with_richer_terms(found, progress)
        best = min(found, key=lambda each: each.score)
        if len(found) > 1 and self.errors == "auto" and not best.search.reason_for_errors:
            # A coarse mesh may hide a reason
            found = [self._resolved(each, progress) for each in found]
            best = min(found, key=lambda each: each.score)
        if len(found) == 1 or self.errors != "auto" or best.search.reason_for_errors:
            found, failed = those_found(lambda each: self._with_errors(trials, each, progress), found)
            refused += failed
            if not found:
                raise refused[-1]
        return sorted(found, key=lambda each: each.score), refused

    def _finer(self, found: Candidate, progress: ProgressCallback) -> Candidate:
        """Return a law on a mesh that may explain what was measured, if it was sought on a coarse one."""
        if not found.is_coarse:
            return found
        return self._found(found.screened, found.followed, found.search, False, progress)

    def _resolved(self, found: Candidate, progress: ProgressCallback) -> Candidate:
        """Return a law on a mesh that is fine enough; on its own if it does not explain what was measured anyway."""
        return found if found.search.lack_of_fit else replace(found, search=resolved(found.search, progress))

    def _begun(self, trials: Trials, screened: Screened, is_first: bool, progress: ProgressCallback) -> Candidate:
        """Search among terms that were kept, and what is offered first, with the interpolation of inputs chosen.

        The first of several orders is sought on a coarse mesh, of single states, where another order takes less time.
        """
        followed = as_followed(trials, self.positive, self.input_between)
        first = next(iter(screened.whole.library.offers(screened.terms.variables)))
        if first.count or self.unmeasured:
            return self._found(screened, followed, None, True, progress)
        begun = None
        if is_first and len(trials.schema.states) == 1:
            begun = self._search_among(followed, screened.structure, progress)
            if begun.state.has_model_error:
                return Candidate(screened, begun, (), followed, has_richer=False, is_coarse=True)
        return self._found(screened, followed, begun, False, progress)

    def _with_richer_terms(self, found: Sequence[Candidate], progress: ProgressCallback) -> list[Candidate]:
        """Offer richer terms, to one order after the other, where the best law so far may be wrong or be simpler.

        The best law first; but that of the lowest order where the best law is what one of lower order implies, or where
        rates may be a function of the states.
        """
        left, done = sorted(found, key=lambda each: each.score), list[Candidate]()
        while left:
            best = min([*done, *left], key=lambda each: each.score)
            lowest = min(left, key=lambda each: each.total_order)
            is_lower = lowest.total_order < best.total_order
            may_be_lower = is_lower and may_be_of_first_order(best.search.problem)
            implied = is_lower and may_be_of_lower_order(best.search)
            if best.is_simple and not implied and not (may_be_lower and best.most_terms > _FEW):
                break
            chosen = lowest if implied or may_be_lower else left[0]
            left = [each for each in left if each is not chosen]
            done.append(self._richer(chosen, progress))
        return [*done, *left]

    def _richer(self, found: Candidate, progress: ProgressCallback) -> Candidate:
        """Return the law of largest evidence among richer terms, too."""
        found = self._of_higher_degree(found, progress)
        if found.is_simple or found.has_richer or not any(each.count for each in self._offers(found.screened)[1]):
            return found
        return self._found(found.screened, found.followed, found.search, True, progress)

    def _of_higher_degree(self, found: Candidate, progress: ProgressCallback) -> Candidate:
        """Return the law among plain terms of higher degree where fewer may be wrong, if those explain the trials.

        They are a linear problem, so they come before terms with constants inside, latent states and other orders.
        A law that leaves something unexplained, or is a truncated series, extrapolates worse than one of fewer terms.
        """
        whole = found.screened.whole
        if found.is_simple or found.has_richer or found.is_coarse or not (higher := whole.library.higher):
            return found
        progress("searching among terms of higher degree")
        screened = Screened.of(found.followed, replace(whole, library=higher))
        more = replace(self._found(screened, found.followed, None, False, progress), is_of_higher_degree=True)
        return more if more.is_simple and more.score < found.score else found

    def _found(
        self,
        screened: Screened,
        followed: Trials,
        plain: LawSearch | None,
        richer: bool,
        progress: ProgressCallback,
    ) -> Candidate:
        """Search for a law with the interpolation of inputs that is chosen.

        Parameters
        ----------
        screened
            What is sought.
        followed
            What was measured, as the law follows it.
        plain
            The search among plain terms, if it is done, or but for those that were left out and finer meshes.
        richer
            Whether terms are sought, too, that are offered beside plain ones.
        progress
            Takes what is being done.
        """

        def begin(trials: Trials, progress: ProgressCallback) -> LawSearch:
            done = plain if trials is followed else None
            if not richer:
                return self._search(screened, trials, progress, done)
            done = done or self._search(screened, trials, part(progress, 0.0, _PLAIN))
            return self._search_richer(screened, done, part(progress, _PLAIN, 1.0))

        search, steps = begin_search(
            begin,
            followed,
            input_between=self.input_between,
            errors=self.errors,
            progress=progress,
            is_chosen=richer and plain is not None,
        )
        chosen = search.problem.trials.schema.input_between
        if chosen != followed.schema.input_between:
            followed = with_interpolation(followed, chosen)
        if richer:  # Once, as this takes longest: under the interpolation that laws without such a state choose
            search = self._with_latent_state(screened, search, followed, progress)
        return Candidate(screened, search, steps, followed, richer)

    def _with_errors(self, trials: Trials, found: Candidate, progress: ProgressCallback) -> Candidate:
        """Choose errors, and search again where terms that were left out improve the law under these.

        They are chosen again on the mesh that the law needs if a coarser one hid what speaks against white noise.
        """
        may_hide = self.errors == "auto"
        while True:
            propose = partial(_by_derivatives, trials, found.screened, progress)
            search = choose_errors(found.search, errors=self.errors, propose=propose, progress=progress)
            if found.has_richer:
                offers, before = self._offers(found.screened)[1], found.search.problem.errors
                search = with_parametric_terms_under_errors(search, before, offers, progress)
            screened = found.screened.among(search.among_plain)
            more = screened.with_missed(search) if search.solver and search.problem.errors else None
            if more is not None:
                found = self._found(more, found.followed, None, found.has_richer, progress)
                continue
            fine = resolved(search, progress)
            found = replace(found, screened=screened, search=fine)
            if not may_hide or search.reason_for_errors or not fine.reason_for_errors:
                return found
            may_hide = False

    def _finished(self, trials: Trials, found: Candidate, progress: ProgressCallback) -> Law:
        law = finish(
            found.search,
            kinds=error_kinds(self.errors, trials.schema),
            covariance=self.covariance,
            universal=lambda law: universal_in(law, found.screened.structure),
            partial_pooling=self.partial_pooling,
            seed=self.seed,
            progress=part(progress, CHOSEN, 1.0),
        )
        steps = (*found.screened.steps, *found.steps, *law.history)
        return replace(law, provenance=replace(law.provenance, history=steps))

    def _search_richer(self, screened: Screened, found: LawSearch, progress: ProgressCallback) -> LawSearch:
        """Search for the law of largest evidence among all that is offered, also terms with constants inside."""
        driven, offers = self._offers(screened)
        if any(each.count for each in offers):
            found = with_parametric_terms(found, offers, progress)
        return with_drive_said(found, driven) if driven else found

    def _with_latent_state(
        self, screened: Screened, found: LawSearch, trials: Trials, progress: ProgressCallback
    ) -> LawSearch:
        """Return the law of largest evidence with a latent state or without, if one is asked for or may be missing."""
        # One trial alone has no other start to tell such a state by
        few = len(trials.objects) <= _FEW_OBJECTS and len(trials) > 1
        seeks = screened.whole.library.seeks_unmeasured and few and may_be_simpler(found, MAX_TERMS_OF_SIMPLE_LAW)
        if screened.whole.order == 1 and (self.unmeasured or seeks):
            found = with_unmeasured_state(found, trials, most_samples=self.max_samples, progress=progress)
        return found

    def _offers(self, screened: Screened) -> tuple[Sequence[ParametricTerm | TiedTerms], list[Offer]]:
        """Return the drives that nobody measured among what equations may have besides plain terms, and all of that."""
        variables = screened.terms.variables
        driven = drives(variables) if self.unmeasured and highest_order(screened.whole.order) == 2 else ()
        first, *richer = screened.whole.library.offers(variables)
        return driven, [replace(first, terms=(*first.terms, *driven)), *richer]

    def _search(
        self, screened: Screened, trials: Trials, progress: ProgressCallback, begun: LawSearch | None = None
    ) -> LawSearch:
        """Search for the supports of largest evidence, until no finer mesh or term that was left out improves them."""
        found = explained_on_finer_mesh(begun or self._search_among(trials, screened.structure, progress), progress)
        while more := screened.with_missed(found):
            progress("searching again with terms that were left out and improve the law")
            screened = more
            found = explained_on_finer_mesh(self._search_among(trials, more.structure, progress), progress)
        if found.problem.least_variance >= 1 and not (found.lack_of_fit or found.is_determined):
            # Of exact measurements a needless term may stand for the discretization error of a coarse mesh
            found = resolved(found, progress)
        return found

    def _search_among(self, trials: Trials, structure: ModelStructure, progress: ProgressCallback) -> LawSearch:
        terms, known = structure.terms(trials.schema), structure.known_coefficients(trials.schema, trials.objects)
        _check_effort(trials, len(terms), self.max_samples)
        provenance = Provenance(suitable_differentiation(trials, structure.order))
        return search_supports(
            trials,
            Law(terms, trials.schema, structure.order, trials.objects, np.nan_to_num(known), provenance=provenance),
            known,
            solver=parsed(self.solver, parse_solver) or PATH,
            noise=known_noise(self.noise, trials),
            huber_threshold=self.huber_threshold,
            kinds=error_kinds(self.errors, trials.schema),
            most_samples=self.max_samples,
            progress=progress,
        )


def with_unmeasured(method: AbstractMethod, count: int) -> AbstractMethod:
    """Return the method that asks, too, for so many states that nobody measured."""
    if not count:
        return method
    if not isinstance(method, TrajectoryLikelihood):
        name = type(method).__name__
        remedy = Diagnostic("leave-out" if 0 in method.orders else "use-trajectory-likelihood")
        raise CommonlawError("latent-states-unsupported", count=count, method=name, remedy=remedy)
    return replace(method, unmeasured=count)


def universal_in(law: Law, asked: ModelStructure) -> Bools:
    """Return which coefficients of a law all objects are to have in common, shape (equations, terms)."""
    schema = replace(law.schema, states=law.schema.measured, starts={}, starts_at=None)
    universal, names = asked.universal_coefficients(schema), asked.terms(schema).names
    universal = np.pad(universal, ((0, len(law.states) - len(universal)), (0, 0)))
    columns = {name: universal[:, k] for k, name in enumerate(names)}
    return np.column_stack([columns.get(name, np.zeros(len(universal), dtype=bool)) for name in law.terms.names])


def _found_in(method: TrajectoryLikelihood, structure: ModelStructure, trials: Trials) -> Law:
    return method.find(trials, structure, lambda _: None)


def _by_derivatives(trials: Trials, screened: Screened, progress: ProgressCallback, found: LawSearch) -> Bools | None:
    """Return the support that regression on derivatives finds among the same terms, None if it finds none."""
    with suppress(CommonlawError):
        sought = screened.among(found).structure
        return DerivativeRegression().find(trials.without_noise(), sought, progress).support
    return None


def _check_effort(trials: Trials, terms: int, most_samples: int) -> None:
    """Refuse more terms than memory can hold the factors of, and announce a search that takes long."""
    objects, samples = len(trials.objects), min(sum(map(len, trials)), most_samples)
    of = f"{counted(len(trials), 'trial')} of {counted(objects, 'object')} with {counted(terms, 'term')}"
    what = f"the trajectory likelihood of {of}"
    size = 8 * (_FACTORS * objects * (terms * len(trials.schema.states)) ** 2 + _ARRAYS * samples * terms)
    check_memory(what, size, "take a smaller library")
    seconds = _SECONDS_AN_OBJECT * objects + _SECONDS_A_TRIAL * len(trials) + _SECONDS_A_SAMPLE * samples
    announce(what, seconds, Diagnostic("fewer-trials-or-regression"))
