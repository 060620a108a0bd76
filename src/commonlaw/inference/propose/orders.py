"""The evidence for laws of different orders, from the same measurements."""

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference import settings
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.score.score import Score
from commonlaw.inference.search.pool import Pool
from commonlaw.library import with_rates
from commonlaw.likelihood import variance_of_rates


def score_of_order(fit: Fit) -> Score:
    """Return minus twice the log-evidence of a law, which compares with that of a law of another order.

    The evidence of a search is the density of all that was measured after the start of each segment, with any start
    being as likely: so of a law of first order. Rates at starts of states of second order are to be found besides.
    While one order is sought their distribution is one that says next to nothing, and narrows as meshes get coarser.
    Here it is the normal distribution about zero as wide as rates are in all trials (root mean square of smoothed
    rates). What the linearised likelihood promises away from the estimates counts as not there: of an order that does
    not suit, fits may get stuck in stiff laws.
    """
    problem, states = fit.problem, len(fit.problem.noise)
    score = fit.score.plus("Laplace correction", fit.predicted_decrease)
    if not len(with_rates(problem.order, states)):
        return score
    rates = np.concatenate([each[:, states:] for own in problem.smoothed for each in own])
    variances, price = np.nanmean(rates**2, axis=0), 0.0
    for model, estimate in zip(problem.models, fit.estimates, strict=True):
        for mesh, found, _ in model.parts(estimate):
            starts = found[mesh.first, states : model.width]
            price += float(np.sum(starts**2 / variances + np.log(variances / variance_of_rates(model, mesh))))
    return score.plus("initial conditions", price)


def may_be_of_lower_order(pool: Pool) -> bool:
    """Return whether a law of second order is what one of first order implies: x' = f(x) has x'' = f'(x) x'.

    Then each term has a rate as a factor, and nothing moves that is at rest. Or x'' = K (f(x) - x') with any K: then
    coefficients are within their errors.
    """
    if not pool.is_determined:
        return True
    terms, supports = pool.best.problem.terms, pool.best.supports
    states = len(supports)
    second = with_rates(pool.best.problem.order, states)
    rates = {*range(states, states + len(second))}
    chosen = np.flatnonzero((supports[second] & terms.is_factor).any(axis=0))
    return len(chosen) > 0 and all(terms.terms[k].columns() & rates for k in chosen)


def may_be_of_first_order(problem: SearchProblem) -> bool:
    """Return whether rates may be a function of the states and inputs: no object has two rates at the same state.

    An oscillator, which passes a state in both directions, or balls that are thrown from one place at two speeds, are
    of higher order. Smoothed states of all trials are compared, and of one trial at other times.
    """
    states = len(problem.noise)
    for name, curves in zip(problem.trials.objects, problem.smoothed, strict=True):
        rows = list[Floats]()
        for k, (trial, smooth) in enumerate(zip(problem.trials.of_object(name), curves, strict=True)):
            path, own = smooth[:, :states], np.linspace(2 * k, 2 * k + 1, len(smooth))
            if len(path) > 1:
                rows.append(np.column_stack([own, path, trial.inputs, np.gradient(path, trial.times, axis=0)]))
        if rows and _has_two_rates(np.concatenate(rows), states):
            return False
    return True


def _has_two_rates(rows: Floats, states: int) -> bool:
    """Whether rows of times (as shares of trials), states, inputs and rates have a state and input with two rates."""
    from scipy.spatial import cKDTree

    same_state, other_time, other_rate, by_noise = settings.TWO_RATES
    few = rows[np.isfinite(rows).all(axis=1)][:: -(-len(rows) // settings.MAX_PAIRS)]
    scaled = few[:, 1:] / np.maximum(np.ptp(few[:, 1:], axis=0), np.finfo(float).tiny)
    first, second = cKDTree(scaled[:, :-states]).query_pairs(same_state, output_type="ndarray").T
    others = np.abs(few[first, 0] - few[second, 0]) > other_time
    apart = np.abs(scaled[first[others], -states:] - scaled[second[others], -states:]).max(axis=1)
    return len(apart) > 0 and bool((apart > other_rate).mean() > by_noise)
