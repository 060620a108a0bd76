"""The evidence for laws of different orders, from the same measurements."""

import numpy as np

from commonlaw.inference.law_search import LawSearch
from commonlaw.inference.search_problem import SearchProblem
from commonlaw.inference.search_state import SearchState, promised
from commonlaw.library import with_rates
from commonlaw.likelihood import variance_of_rates

_TURNED, _EXACT = 4.0, 1e-3
"""How far a state that has turned moves back: in standard deviations of its noise, and as a share of its range."""


def evidence_of_order(problem: SearchProblem, state: SearchState) -> float:
    """Return minus twice the log-evidence of a law, which compares with that of a law of another order.

    The evidence of a search is the density of all that was measured after the start of each segment, with any start
    being as likely: so of a law of first order. Rates at starts of states of second order are to be found besides.
    While one order is sought their distribution is one that says next to nothing, and narrows as meshes get coarser.
    Here it is the normal distribution about zero as wide as rates are in all trials (root mean square of smoothed
    rates). What the linearised likelihood promises away from the estimates counts as not there: of an order that does
    not suit, fits may get stuck in stiff laws.
    """
    value, states = state.value + promised(problem, state), len(problem.noise)
    if not len(with_rates(problem.models[0].order, states)):
        return value
    rates = np.concatenate([each[:, states:] for own in problem.smoothed for each in own])
    variances = np.nanmean(rates**2, axis=0)
    for model, estimate in zip(problem.models, state.estimates, strict=True):
        for mesh, found, _ in model.parts(estimate):
            starts = found[mesh.first, states : model.width]
            value += float(np.sum(starts**2 / variances + np.log(variances / variance_of_rates(model, mesh))))
    return value


def may_be_of_lower_order(found: LawSearch) -> bool:
    """Return whether a law of second order is what one of first order implies: x' = f(x) has x'' = f'(x) x'.

    Then each term has a rate as a factor, and nothing moves that is at rest. Or x'' = K (f(x) - x') with any K: then
    coefficients are within their errors.
    """
    if not found.is_determined:
        return True
    terms, order, supports = found.template.terms, found.template.order, found.state.supports
    states = len(supports)
    second = with_rates(order, states)
    rates = {*range(states, states + len(second))}
    chosen = np.flatnonzero((supports[second] & terms.is_factor).any(axis=0))
    return len(chosen) > 0 and all(terms.terms[k].columns() & rates for k in chosen)


def may_be_of_first_order(found: LawSearch) -> bool:
    """Return whether rates may be a function of the states, by what was measured.

    A single state without inputs does not turn back then.
    """
    problem = found.problem
    if len(problem.noise) > 1 or problem.trials.schema.inputs:
        return True
    least = _TURNED * problem.noise[0]
    for path in (each[:, 0] for own in problem.smoothed for each in own):
        risen = np.max(path - np.minimum.accumulate(path))
        fallen = np.max(np.maximum.accumulate(path) - path)
        if min(risen, fallen) > max(least, _EXACT * np.ptp(path)):
            return False
    return True
