"""Maximum likelihood of whole trajectories: propose laws, fit each, score each by one sum, and choose the best.

A candidate is the `Pool` of the fits of one order. This is all that is chosen, in this order, by what, and where:

    plain terms       evidence of supports on the path of a solver        `search_supports`, `search_on_finer_mesh`
    strange objects   evidence of their own laws and one of the others    `with_objects_apart`
    interpolation     strong evidence, given the terms                    `choose_interpolation`
    orders to try     lack of fit or many coefficients of the best        `search_orders`, `_with_richer_terms`
    error model       evidence, if residuals are not white noise          `choose_errors`
    richer terms      evidence, with the multiplicity of all offers       `with_parametric_terms`
    latent state      evidence, with the multiplicity of its equations    `with_latent_state`
    order             evidence of converged fits                          `law_of_best_order`
    strange objects   the same, where the law has richer terms            `with_objects_apart`
    support           the first by linearized evidence, if it fits best   `with_leading_support`
    textbook law      evidence of converged fits                          `with_textbook_laws`
    forecaster        held-out forecasts, if the errors are too large     `best_forecaster`

`candidate_search` has the steps of one order, and `inference.result.assembly` makes the law of the last pool.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from typing import ClassVar, NamedTuple

from commonlaw.array_types import evenly_spaced
from commonlaw.diagnostics import note
from commonlaw.discovery.best_so_far import Best
from commonlaw.discovery.candidate_search import Candidate, CandidateSearch
from commonlaw.discovery.log_scale import likelier_scale
from commonlaw.discovery.method import AbstractMethod, ModelStructure, check_supported, parsed
from commonlaw.discovery.orders import (
    apply_to_each,
    attempt_each,
    is_first_order_possible,
    is_implied_by_lower_order,
    search_orders,
    with_order_step,
)
from commonlaw.discovery.strange_objects import (
    in_other_units,
    with_objects_apart,
    with_strange_objects,
    without_strange_objects,
)
from commonlaw.discovery.textbook import with_textbook_laws
from commonlaw.errors import CommonlawError
from commonlaw.inference import refine, settings
from commonlaw.inference.fit.final_score import final
from commonlaw.inference.result.assembly import assemble, reported
from commonlaw.inference.result.held_out_forecasts import best_forecaster, standardized_errors
from commonlaw.inference.score.score import Kind, Score
from commonlaw.inference.search.law_search import with_leading_support
from commonlaw.inference.search.pool import Pool
from commonlaw.inference.search.setup import RefitOptions, error_kinds
from commonlaw.inference.verbs.chunks import fitted_by_parts, objects_apart, typical
from commonlaw.inference.verbs.collocation import refined
from commonlaw.inference.verbs.comparison import compare_by_parts, written_alike
from commonlaw.law import Law, Step, pool_objects
from commonlaw.law.population import with_pooled_forecasts
from commonlaw.law.text import order_in_words
from commonlaw.library import Order, one_order, order_of_each
from commonlaw.likelihood.levels import states_of_open_scale
from commonlaw.runtime.arguments import check_type
from commonlaw.runtime.cluster import done_in_parts
from commonlaw.runtime.fit_options import FitOptions, documented
from commonlaw.runtime.parallel import threads
from commonlaw.runtime.progress import ProgressCallback, in_words, part, silent, unannounced
from commonlaw.runtime.time_limit import OutOfTimeError, check, current_limit, unlimited
from commonlaw.solvers import AbstractSolver, parse_solver
from commonlaw.text import counted
from commonlaw.trials import Trials, TrialStream


@documented
@dataclass(frozen=True, kw_only=True)
class TrajectoryLikelihood(FitOptions, AbstractMethod):
    """Maximum likelihood of whole trajectories with free initial states; supports are compared by their evidence.

    The law has standard errors and intervals. See `commonlaw.inference`, and docs/method for all formulas.

    Raises `CommonlawError` if a text cannot be parsed, or a value is invalid.

    Parameters
    ----------
    {parameters}
    """

    orders: ClassVar[tuple[int, ...]] = (1, 2)
    takes_mixed_orders: ClassVar[bool] = True
    takes_noise_columns: ClassVar[bool] = True
    takes_parameters: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        check_type("solver", self.solver, (AbstractSolver, str, type(None)), "a solver or its text")
        solver = parsed(self.solver, parse_solver)
        if solver is not None and solver.hyperparameter is not None:
            raise CommonlawError("solver-with-value", solver=solver)
        object.__setattr__(self, "solver", solver)

    def find(self, trials: Trials, structure: ModelStructure, progress: ProgressCallback) -> Law:
        check_supported(self, trials.schema, structure)
        orders = structure.possible or [(order,) for order in order_of_each(structure.order, len(trials.schema.states))]
        first = replace(structure, order=1, possible=((1,),) * len(orders))
        is_first = all(1 in of_state for of_state in orders)
        states = states_of_open_scale(
            trials,
            errors=self.errors,
            noise=self.noise,
            log_states=self.log_states or None,
            is_first_order=is_first and not self.latent_states,
        )
        with threads(self.n_jobs):
            search = CandidateSearch(trials, self, progress, best=Best())
            if not states:
                return law_of_best_order(search, first if is_first and self.log_states else structure)

            def refined_on_linear_scale(law: Law) -> Law:
                with unlimited():
                    return refine(law, trials, log_states=(), progress=silent)

            return likelier_scale(
                partial(
                    law_of_best_order, replace(search, options=replace(self, log_states=states), best=Best()), first
                ),
                partial(law_of_best_order, search, structure),
                refined_on_linear_scale,
                trials,
            )

    def find_by_file(self, stream: TrialStream, structure: ModelStructure, progress: ProgressCallback) -> Law:
        """Return the law of a stream: proposed by groups of objects, chosen by its evidence over all, fitted to each.

        Parts return only laws, evidences and coefficients; they are fitted under white noise by default.
        """
        check_supported(self, stream.schema, structure)
        nonlinear = structure.parametric(stream.schema) or structure.ratios(stream.schema)
        if nonlinear or self.latent_states:
            what = "latent_states=1" if self.latent_states else "a term with nonlinear parameters"
            raise CommonlawError("stream-with-option", what=what)
        errors = "white" if self.errors == "auto" else self.errors
        alone = replace(self, errors=errors, covariance="likelihood", partial_pooling=False)
        parts = stream.files
        objects_apart(parts, part(progress, 0.0, 0.05))
        some = [parts[i] for i in evenly_spaced(len(parts), settings.MAX_WINDOWS)]
        laws = done_in_parts(
            partial(_proposed, alone, structure), some, "seeking laws of groups of objects", part(progress, 0.05, 0.2)
        )
        proposed = {"; ".join(law.structure): law for law in reversed(laws)}
        groups = f"{counted(len(some), 'group')} of at most {settings.OBJECT_GROUPS[0]} objects"
        what = f"{counted(len(proposed), 'law')} of {groups}"
        steps = [Step("proposals", what, "terms proposed by a search among few objects")]
        best = next(iter(proposed.values()))
        if len(proposed) > 1:
            weighing = {"noise": self.noise, "errors": errors, "threshold": self.huber_threshold, "n_jobs": self.n_jobs}
            frame = compare_by_parts(proposed, parts, weighing, part(progress, 0.2, 0.4))
            (first, second), evidence = frame["law"][:2], frame["2 log B"][1]
            reason = f"2 log B = {evidence:.4g} for it over {second}, summed over {counted(len(parts), 'part')}"
            best = proposed[first]
            steps.append(Step("support", first, reason))
        options = RefitOptions(
            noise=self.noise,
            errors=errors,
            huber_threshold=self.huber_threshold,
            covariance=self.covariance,
            seed=self.seed,
        )
        fit = partial(_fitted, best, options)
        law = fitted_by_parts([fit] * len(parts), parts, part(progress, 0.4, 1.0), errors)
        provenance = replace(
            best.provenance,
            domain=law.provenance.domain,
            outcomes=(),
            alternatives=(),
            history=(*best.provenance.history, *steps),
        )
        law = replace(law, provenance=provenance)
        return with_pooled_forecasts(law, structure.shared_in(law), self.partial_pooling)


def _proposed(method: TrajectoryLikelihood, structure: ModelStructure, part: TrialStream) -> Law:
    """Return the law of the first objects of a part, whose library are its own terms."""
    trials = part.read()
    some = [trial for name in trials.objects[: settings.OBJECT_GROUPS[0]] for trial in trials.of_object(name)]
    with unannounced():
        law = method.find(trials.with_trials(some), structure, silent)
    return replace(written_alike(law, law.schema), provenance=with_strange_objects(law.provenance))


def _fitted(law: Law, options: RefitOptions, trials: Trials) -> Law:
    """Return a law fitted to the objects of a part, each starting from the average coefficients."""
    return refined(typical(law, trials.objects), trials, options, silent)


def law_of_best_order(search: CandidateSearch, structure: ModelStructure) -> Law:
    """Return the law of largest evidence among those of several orders, or that so far if the time is over.

    Raises `CommonlawError` if no law of any order can be fitted: the last reason.
    """
    limit, best = current_limit(), search.best
    if limit is None or best is None:
        return _law_of_best_order(search, structure)
    limit.await_result()
    try:
        law = _law_of_best_order(search, structure)
        return stopped(law, limit.elapsed, [*dict.fromkeys(best.left_out)]) if best.left_out else law
    except OutOfTimeError:
        search, elapsed = best.search or search, limit.elapsed
    with unlimited():
        law, _ = _law(search, best.candidate, is_stopped=True)
    untried = dict.fromkeys((*best.left_out, *best.untried, _TEXTBOOK, _RIVALS))
    return stopped(without_strange_objects(law, search.strange), elapsed, [*untried])


def stopped(law: Law, seconds: float, untried: Sequence[str]) -> Law:
    """Return a law with a note, and a step of its history, on what its search has not tried in so many seconds."""
    time, provenance = in_words(seconds), law.provenance
    outcome = note("search-stopped", time=time, untried=untried)
    step = Step("search", f"stopped after {time}", f"not tried, or not to the end: {', '.join(untried)}")
    outcomes, history = (outcome, *provenance.outcomes), (*provenance.history, step)
    return replace(law, provenance=replace(provenance, outcomes=outcomes, history=history))


def _law_of_best_order(search: CandidateSearch, structure: ModelStructure, chosen: "_Chosen | None" = None) -> Law:
    """Return the law of largest evidence among those of several orders with equal prior probabilities.

    Objects that are strange to a law of richer terms are left out, too: plain terms may imitate the laws of all. Their
    search has `chosen` the laws of the others then.

    Raises `CommonlawError` if no law of any order can be fitted: the last reason.
    """
    search, candidates, failures, several = chosen or _candidates_of_orders(search, structure)
    best, of_others = candidates[0], dict[tuple[str, ...], _Chosen]()

    def of_some(some: CandidateSearch) -> Candidate:
        if len(some.trials.objects) == 1:
            return some.plain(replace(structure, order=best.order), is_coarse=False)
        kept = replace(some, options=replace(some.options, strange_objects="keep"))
        of_others[some.trials.objects] = _candidates_of_orders(kept, structure)
        return of_others[some.trials.objects].candidates[0]

    if best.has_richer or in_other_units(best, len(search.strange)):
        best = with_objects_apart(best, search, of_some, is_plain=False)
        if best.apart:
            rest = search.without_strange_of(best)
            return _law_of_best_order(rest, structure, of_others[rest.trials.objects]._replace(search=rest))
    law, score = _law(search, best)
    law = without_strange_objects(law, search.strange)
    if not several:
        return law
    others = [(candidate.order, candidate.reported_score - score) for candidate in candidates[1:]]
    return with_order_step(law, others, failures)


class _Chosen(NamedTuple):
    """The best law of each order, the best first, of a search without strange objects, and errors of orders without."""

    search: CandidateSearch
    candidates: Sequence[Candidate]
    failures: Sequence[CommonlawError]
    several: bool


_ERRORS, _RICHER = "errors other than white noise", "richer terms"
_TEXTBOOK, _RIVALS = "textbook laws", "rivals by forecasts of held-out data"
"""What a search tries besides plain terms, in words."""


def _in_share(
    search: CandidateSearch, share: float, step: Callable[[], tuple[list[Candidate], list[CommonlawError]]]
) -> tuple[list[Candidate], list[CommonlawError]]:
    """Return what a step of a search returns, or the candidates so far if it takes more than a share of the time.

    So each of orders, error models and richer terms has a third of it, or what the one before leaves.
    """
    limit, best = current_limit(), search.best
    if limit is None or best is None:
        return step()
    none = list[Candidate](), list[CommonlawError]()
    with limit.until(share):
        candidates, failed = search.in_time(step, none)
    check()
    return candidates or [*best.candidates.values()], failed


def _candidates_of_orders(search: CandidateSearch, structure: ModelStructure) -> _Chosen:
    """Return the best law of each order.

    Higher orders are tried if the best plain law of the lowest order has a lack of fit or many coefficients, and richer
    terms if the best plain law has. All laws have white noise if the residuals of the best are white; else each has the
    error model of its largest evidence. An order is left out if no law can be fitted. Objects that are strange to the
    best plain law are left out, and the search begins again.

    Raises `CommonlawError` if no law of any order can be fitted: the last reason.
    """
    orders = order_of_each(structure.order, len(search.trials.schema.states))
    possible = structure.possible or tuple((order,) for order in orders)
    several = any(len(orders) > 1 for orders in possible)
    lowest = one_order([orders[0] for orders in possible])

    def of_order(order: Order, simple: Candidate | None) -> Candidate:
        if several:
            what = f"laws of order {order_in_words(order, search.trials.schema.states)}"
            search.has_not_tried(what, _ERRORS, _RICHER)
            search.progress(f"searching {what}")
        is_first, library = several and order == lowest, structure.library
        if simple and simple.has_richer:  # Where it is a law of first order, most terms of second order are redundant
            library = library.linear or library
        is_coarse, plain = simple is not None or (is_first and len(possible) == 1), replace(structure, order=order)
        plain = replace(plain, library=library)
        candidate = search.plain(plain, is_coarse)
        candidate = with_objects_apart(candidate, search, lambda some: some.plain(plain, is_coarse), is_plain=True)
        if is_first and not candidate.apart:
            candidate = search.of_higher_degree(candidate)
            if not (candidate.pool.best.lack_of_fit or candidate.is_simple):
                candidate = search.richer(candidate)
            elif is_first_order_possible(candidate.pool.best):
                candidate = search.in_place_of_misfit(candidate)
        return candidate

    def of_orders() -> tuple[list[Candidate], list[CommonlawError]]:
        return search_orders(of_order, possible)

    search.has_not_tried("strange objects", _ERRORS, _RICHER)
    candidates, refused = _in_share(search, 1 / 3, of_orders)
    best = min(candidates)
    if best.apart:
        return _candidates_of_orders(search.without_strange_of(best), structure)
    candidates = [replace(candidate, apart=None) for candidate in candidates]
    if several and (not best.is_simple or is_implied_by_lower_order(best.pool)):
        candidates, _ = apply_to_each(search.finer, candidates)
    if search.options.errors == "auto" and min(candidates).pool.best.reason_for_error_model:
        # Before richer terms that are no better, which would explain the errors of measurements
        search.has_not_tried(_ERRORS, _RICHER)
        finer, _ = _in_share(search, 2 / 3, partial(apply_to_each, search.finer, candidates))
        best = min(finer)
        if not best.was_offered and best.pool.best.lack_of_fit:
            more, _ = _in_share(search, 1 / 2, partial(apply_to_each, search.in_place_of_misfit, [best]))
            finer = [*more, *(candidate for candidate in finer if candidate is not best)]
        candidates, _ = _in_share(search, 2 / 3, partial(apply_to_each, search.with_errors, finer))
    search.has_not_tried(_RICHER)
    candidates = _with_richer_terms(search, candidates)
    candidates, failed = _with_errors(search, candidates)
    return _Chosen(search, candidates, [*refused, *failed], several)


def _with_richer_terms(search: CandidateSearch, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Offer richer terms to one order after the other while the best law has a lack of fit or many coefficients.

    The best law comes first; but that of the lowest order if it implies the best law, or if rates may be a function of
    the states. They end where process noise explains more than richer terms of the same order.
    """
    offered = [attempt_each(search.with_first_offer, [candidate])[0] or [candidate] for candidate in candidates]
    waiting, done = sorted(chain.from_iterable(offered)), list[Candidate]()
    while waiting:
        best = min([*done, *waiting])
        lowest = min(waiting, key=lambda candidate: candidate.total_order)
        if best.has_richer and best.pool.best.has_process_noise:
            break
        is_lower = lowest.total_order < best.total_order
        may_be_lower = is_lower and is_first_order_possible(best.pool.best)
        implied = is_lower and is_implied_by_lower_order(best.pool)
        if best.is_simple and not implied and not (may_be_lower and best.most_terms > settings.MAX_TERMS_OF_SIMPLE_LAW):
            break
        chosen = lowest if implied or may_be_lower else waiting[0]
        waiting = [candidate for candidate in waiting if candidate is not chosen]
        richer, _ = attempt_each(search.richer, [chosen])
        done += richer or [replace(chosen, has_richer=True)]
    return [*done, *waiting]


def _with_errors(search: CandidateSearch, candidates: list[Candidate]) -> tuple[list[Candidate], list[CommonlawError]]:
    """Return candidates under the chosen error models, the best first, and the errors of those without one."""
    is_auto, best, failed = search.options.errors == "auto", min(candidates), list[CommonlawError]()
    if len(candidates) > 1 and is_auto and not best.pool.best.reason_for_error_model:
        candidates, failed = apply_to_each(search.resolved, candidates)  # A coarse mesh may hide it
        best = min(candidates)
    if len(candidates) == 1 or not is_auto or best.pool.best.reason_for_error_model:
        candidates, more = apply_to_each(lambda one: one if one.has_errors else search.with_errors(one), candidates)
        failed = [*failed, *more]
    if len(candidates) > 1:
        candidates = sorted(candidates, key=lambda candidate: candidate.reported_score)
    return candidates, failed


def _law(search: CandidateSearch, best: Candidate, is_stopped: bool = False) -> tuple[Law, Score]:
    """Return the law of a candidate, or of a better forecaster from its pool, and its score.

    If the search `is_stopped` it is that of the candidate, and has no rivals.
    """
    options, shared, progress = search.options, best.screened.structure.shared_in, part(search.progress, 0.9, 1.0)
    kinds = error_kinds(options.errors, search.trials.schema)

    def pooled(law: Law) -> Law:
        return pool_objects(law, shared(law), options.partial_pooling)

    pool = Pool((best.pool.best.with_alternatives(()),)) if is_stopped else best.pool
    if not is_stopped:
        pool = search.in_time(lambda: with_textbook_laws(with_leading_support(best.pool)), pool, _TEXTBOOK)
    with unlimited():
        errors = standardized_errors(pool.best, pooled)
    if not is_stopped:
        of_best = pool, errors
        pool, errors = search.in_time(lambda: best_forecaster(*of_best, kinds, pooled, progress), of_best, _RIVALS)
    progress("computing standard errors and inclusion probabilities")
    with unlimited():
        printed, is_converged = reported(pool)
        law = assemble(
            printed,
            is_converged,
            errors=errors,
            pooled=lambda law: with_pooled_forecasts(law, shared(law), options.partial_pooling),
            covariance=options.covariance,
            seed=options.seed,
            tried_errors=len(kinds) > 1,
        )
    history = (*best.screened.steps, *best.steps, *law.history)
    score = printed.best.score if printed.best.score.kind is Kind.EVIDENCE else final(pool.best)[0].score
    return replace(law, provenance=replace(law.provenance, history=history)), score
