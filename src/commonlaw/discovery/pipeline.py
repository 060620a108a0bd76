"""The pipeline from trials to a law: propose laws, fit each, score each by one sum, and choose the best.

A candidate is the `Pool` of the fits of one order. This is all that is chosen, in this order, by what, and where:

    plain terms       evidence of supports on the path of a solver        `search_supports`, `search_on_finer_mesh`
    interpolation     strong evidence, given the terms                    `choose_interpolation`
    orders to try     lack of fit or many coefficients of the best        `search_orders`, `_with_richer_terms`
    richer terms      evidence, with the multiplicity of all offers       `with_parametric_terms`
    latent state      evidence, with the multiplicity of its equations    `with_latent_state`
    error model       evidence, if residuals are not white noise          `choose_errors`
    order             evidence (`score_of_order`), residuals of trials    `_fitting_whole_trials`
    process noise     none if solutions fit whole trials better           `choose_deterministic`
    support           the first by linearized evidence, if it fits best   `with_leading_support`
    forecaster        held-out forecasts, if the errors are too large     `best_forecaster`

`candidate_search` has the steps of one order, and `inference.result.assembly` makes the law of the last pool.
"""

from collections.abc import Sequence
from dataclasses import replace

from commonlaw.discovery.candidate_search import Candidate, CandidateSearch
from commonlaw.discovery.method import ModelStructure
from commonlaw.discovery.orders import (
    apply_to_each,
    attempt_each,
    is_first_order_possible,
    is_implied_by_lower_order,
    search_orders,
    with_order_step,
)
from commonlaw.errors import CommonlawError
from commonlaw.forecast.population import with_pooled_forecasts
from commonlaw.inference.result.approximation import (
    choose_deterministic,
    fits_whole_trials,
    index_of_best_fit_to_whole_trials,
)
from commonlaw.inference.result.assembly import assemble
from commonlaw.inference.result.held_out_forecasts import best_forecaster
from commonlaw.inference.search.law_search import with_leading_support
from commonlaw.inference.search.setup import error_kinds
from commonlaw.law import Law, pool_objects
from commonlaw.law.text import order_in_words
from commonlaw.library import Order, one_order
from commonlaw.runtime.progress import part

MAX_TERMS_OF_HIGHER_ORDER = 3
"""An equation of higher order with more coefficients may be equivalent to one of lower order with richer terms."""


def law_of_best_order(search: CandidateSearch, structure: ModelStructure, possible: Sequence[Sequence[int]]) -> Law:
    """Return the law of largest evidence among those of several orders with equal prior probabilities.

    Higher orders are tried if the best plain law of the lowest order has a lack of fit or many coefficients, and richer
    terms if the best plain law has. All laws have white noise if the residuals of the best are white; else each has the
    error model of its largest evidence. `possible` has the orders of each state. An order is left out if no law can be
    fitted.

    Raises `CommonlawError` if no law of any order can be fitted: the last reason.
    """
    several = any(len(each) > 1 for each in possible)
    lowest = one_order([each[0] for each in possible])

    def of_order(order: Order, simple: Candidate | None) -> Candidate:
        if several:
            search.progress(f"searching laws of order {order_in_words(order, search.trials.schema.states)}")
        is_first, library = several and order == lowest, structure.library
        if simple and simple.has_richer:  # Where it is a law of first order, most terms of second order are redundant
            library = library.linear or library
        is_coarse = simple is not None or (is_first and len(possible) == 1)
        candidate = search.plain(replace(structure, order=order, library=library), is_coarse)
        if is_first:
            candidate = search.of_higher_degree(candidate)
            if not (candidate.pool.best.lack_of_fit or candidate.is_simple):
                candidate = search.richer(candidate)
        return candidate

    candidates, refused = search_orders(of_order, possible)
    best = min(candidates)
    if several and (not best.is_simple or is_implied_by_lower_order(best.pool)):
        candidates, _ = apply_to_each(search.finer, candidates)
    candidates = _with_richer_terms(search, candidates)
    candidates, failed = _with_errors(search, candidates)
    candidates, best = _fitting_whole_trials(search, candidates)
    law = _law(search, best)
    if not several:
        return law
    others = [(candidate.order, candidate.score - best.score) for candidate in candidates if candidate is not best]
    return with_order_step(law, others, [*refused, *failed])


def _with_richer_terms(search: CandidateSearch, candidates: Sequence[Candidate]) -> list[Candidate]:
    """Offer richer terms to one order after the other while the best law has a lack of fit or many coefficients.

    The best law comes first; but that of the lowest order if it implies the best law, or if rates may be a function of
    the states.
    """
    candidates = [(attempt_each(search.with_first_offer, [candidate])[0] or [candidate])[0] for candidate in candidates]
    left, done = sorted(candidates), list[Candidate]()
    while left:
        best = min([*done, *left])
        lowest = min(left, key=lambda each: each.total_order)
        is_lower = lowest.total_order < best.total_order
        may_be_lower = is_lower and is_first_order_possible(best.pool.best)
        implied = is_lower and is_implied_by_lower_order(best.pool)
        if best.is_simple and not implied and not (may_be_lower and best.most_terms > MAX_TERMS_OF_HIGHER_ORDER):
            break
        chosen = lowest if implied or may_be_lower else left[0]
        left = [each for each in left if each is not chosen]
        found, _ = attempt_each(search.richer, [chosen])
        done += found or [replace(chosen, has_richer=True)]
    return [*done, *left]


def _with_errors(search: CandidateSearch, candidates: list[Candidate]) -> tuple[list[Candidate], list[CommonlawError]]:
    """Return candidates under the chosen error models, the best first, and the errors of those without one."""
    is_auto, best, failed = search.options.errors == "auto", min(candidates), list[CommonlawError]()
    if len(candidates) > 1 and is_auto and not best.pool.best.reason_for_errors:
        candidates, failed = apply_to_each(search.resolved, candidates)  # A coarse mesh may hide it
        best = min(candidates)
    if len(candidates) == 1 or not is_auto or best.pool.best.reason_for_errors:
        candidates, more = apply_to_each(search.with_errors, candidates)
        failed = [*failed, *more]
    return sorted(candidates), failed


def _fitting_whole_trials(search: CandidateSearch, ranked: list[Candidate]) -> tuple[list[Candidate], Candidate]:
    """Return candidates, and the chosen one: the best, or another one if only its solutions fit whole trials."""
    best, *others = ranked
    if not others or search.options.errors != "auto" or fits_whole_trials(best.pool.best):
        return ranked, best
    without_deterministic = [each for each in others if each.pool.best.has_model_error and not each.pool.approximations]
    found, _ = attempt_each(search.with_errors, without_deterministic)
    ranked = [best, *(each for each in others if each not in without_deterministic), *found]
    return ranked, ranked[index_of_best_fit_to_whole_trials([each.pool for each in ranked])]


def _law(search: CandidateSearch, best: Candidate) -> Law:
    """Return the law of a candidate, or of a deterministic law or a better forecaster from its pool."""
    options, shared, progress = search.options, best.screened.structure.shared_in, part(search.progress, 0.9, 1.0)
    kinds = error_kinds(options.errors, search.trials.schema)

    def pooled(law: Law) -> Law:
        return pool_objects(law, shared(law), options.partial_pooling)

    pool = with_leading_support(choose_deterministic(best.pool, progress, pooled))
    pool, errors = best_forecaster(pool, kinds, pooled, progress)
    progress("computing standard errors and inclusion probabilities")
    law = assemble(
        pool,
        errors=errors,
        pooled=lambda law: with_pooled_forecasts(law, shared(law), options.partial_pooling),
        covariance=options.covariance,
        seed=options.seed,
        tried_errors=len(kinds) > 1,
    )
    history = (*best.screened.steps, *best.steps, *law.history)
    return replace(law, provenance=replace(law.provenance, history=history))
