"""The last step from trials to a law: what was chosen with its errors, what else it could be, and every choice."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference.diagnose.convergence import converged
from commonlaw.inference.diagnose.trial_heterogeneity import differing_trials
from commonlaw.inference.fit.annealing import beside_those_ahead, to_scale
from commonlaw.inference.fit.covariance import CovarianceKind, fitted_law
from commonlaw.inference.fit.state import neighbours
from commonlaw.inference.result.approximation import approximated, with_approximation
from commonlaw.inference.result.averaging import other_laws, with_rivals
from commonlaw.inference.result.history import (
    ComparedTerms,
    alternatives,
    history,
    inclusion_probabilities,
    names_in,
    outcomes,
)
from commonlaw.inference.result.interval_calibration import standardized_errors, widening_of
from commonlaw.inference.result.predictive_choice import best_forecaster
from commonlaw.inference.score.score import Kind
from commonlaw.inference.search.error_levels import ErrorKind
from commonlaw.inference.search.law_search import LawSearch
from commonlaw.law import Law, PlausibleLaw
from commonlaw.law.population import with_pooled_forecasts
from commonlaw.progress import ProgressCallback

_SAME = 1e-3
"""Standard deviations of the noise in which the ends of trajectories agree where one law is written in two ways."""


def finish(
    found: LawSearch,
    *,
    kinds: Sequence[ErrorKind],
    covariance: CovarianceKind,
    universal: Callable[[Law], Bools],
    partial_pooling: bool,
    seed: int,
    progress: ProgressCallback,
) -> Law:
    """Return the law that was found: its terms, coefficients, their covariance, and every choice on the way.

    Parameters
    ----------
    found
        By `begin_search`, `choose_errors` and `resolved`.
    kinds
        Of errors that a law may have that forecasts better than that, see `best_forecaster`.
    covariance
        How the coefficients' covariance is found, see `covariance.covariances`.
    universal
        Returns which coefficients of a law all objects have in common, shape (equations, terms).
    partial_pooling
        Whether forecasts draw the others to their means as far as the objects are alike, see `Law.partial_pooling`.
    seed
        Of what is drawn.
    progress
        Takes what is being done.
    """

    def pooled(law: Law) -> Law:
        return law.partial_pooling(universal(law), partial_pooling)

    found = ranked_first(approximated(found, progress, pooled) or found)
    if found.is_approximation:
        errors = standardized_errors(found, pooled)
    else:
        found, errors = best_forecaster(found, kinds, pooled, progress)
    template = found.template
    progress("judging terms and coefficients")
    compared = compared_terms(found)
    problem, state, is_converged = found.problem, found.state, True
    coefficients = int(state.supports.sum()) * len(problem.models)
    is_told = problem.tells_noise or problem.is_determined(coefficients)
    if is_told and not problem.trials.schema.unmeasured.any():  # Latent states have a prior
        problem, state, is_converged = converged(problem, state)
    law = fitted_law(template, problem, state, covariance, seed)
    law = replace(
        law,
        uncertainty=replace(
            law.uncertainty,
            inclusion_probabilities=(
                None if found.state.score.kind is Kind.FORECASTS else inclusion_probabilities(template, compared)
            ),
            widening=widening_of(errors),
        ),
        provenance=replace(
            template.provenance,
            outcomes=(
                *template.provenance.outcomes,
                *with_approximation(
                    found, outcomes(template, problem, state, is_converged, tried_errors=len(kinds) > 1)
                ),
                *differing_trials(problem, state),
            ),
            alternatives=alternatives(template, compared, found.chosen_by),
            history=(*template.provenance.history, *history(template, problem, state, compared, found.chosen_by)),
        ),
    )
    others = other_laws(found.problem, found.state, law) if found.solver is not None else ()
    others = with_rivals(others, law, [(each.state.score - state.score, each.fitted) for each in _different(found)])

    def with_pooled(law: Law) -> Law:
        return with_pooled_forecasts(law, universal(law), partial_pooling)

    return with_pooled(law).with_others(tuple(PlausibleLaw(each.probability, with_pooled(each.law)) for each in others))


def ranked_first(found: LawSearch) -> LawSearch:
    """Return a search whose law is the best of those that the comparison of terms ranks ahead of it, once fitted."""
    if found.solver is None:
        return found
    state = beside_those_ahead(found.problem, found.state)
    if np.array_equal(state.supports, found.state.supports):
        return replace(found, state=state)
    problem, state = to_scale(found.problem, state)
    return replace(found, problem=problem, state=state)


def _different(found: LawSearch) -> list[LawSearch]:
    """Return the rivals that are not the same law in other words, as another or the law itself is."""
    listed = [found]
    for rival in found.rivals:
        if not any(_is_same(rival, each) for each in listed):
            listed.append(rival)
    return listed[1:]


def _is_same(one: LawSearch, other: LawSearch) -> bool:
    """Return whether laws with as many coefficients have the same trajectories, by far less than the noise."""
    if one.state.supports.sum() != other.state.supports.sum() or one.template.states != other.template.states:
        return False
    apart = np.abs(_ends(one) - _ends(other)).max(axis=(0, 1))
    return bool((apart < _SAME * one.problem.noise).all())


def _ends(found: LawSearch) -> Floats:
    """Return where trajectories start and end, without rates and other processes, shape (trajectories, 2, states)."""
    states = len(found.problem.noise)
    return np.array([own[[0, -1], :states] for each in found.state.estimates for own in each.states])


def compared_terms(found: LawSearch) -> list[list[ComparedTerms]]:
    """Return for each equation the terms that were chosen and those beside them, the other equations' being the same.

    Of terms that are given, these are those of rivals alone. What ranks ahead of the law could not be fitted, or its
    solutions do not follow the steps of the likelihood: it was no law to choose from, and is left out.
    """
    laws = [(each.state.score - found.state.score, _names(each)) for each in found.rivals]
    first, compared = _names(found), []
    near = neighbours(found.problem, found.state) if found.solver is not None else [[] for _ in first]
    for j, (own, given) in enumerate(zip(first, found.template.support, strict=True)):
        named = [(names_in(found.template, each.support | given), each) for each in near[j]]
        here = next((each.twice_log_bayes_factor for names, each in named if names == own), 0.0)
        listed = {own: ComparedTerms(own, 0.0, True)}
        for names, each in named:
            listed.setdefault(names, ComparedTerms(names, each.twice_log_bayes_factor - here, False))
        for above, of_rival in laws:
            if of_rival[:j] == first[:j] and of_rival[j + 1 :] == first[j + 1 :]:
                listed.setdefault(of_rival[j], ComparedTerms(of_rival[j], above, False))
        kept = [each for each in listed.values() if each.difference >= 0]
        compared.append(sorted(kept, key=lambda each: (each.difference, not each.chosen)))
    return compared


def _names(found: LawSearch) -> list[tuple[str, ...]]:
    template = found.template
    pairs = zip(found.state.supports, template.support, strict=True)
    return [names_in(template, own | given) for own, given in pairs]
