"""Fits of several objects to one law: the best of several beginnings, and what other objects alone determine.

A parameter inside a term is not identifiable from an object in whose trials the term is linear, and would diverge. The
scatter of the parameters of the others limits it.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference import settings
from commonlaw.inference.fit.annealing import fit_with
from commonlaw.inference.fit.fit import NO_ERROR
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.likelihood import Estimate, Prior, fit_each


def full_schedule(problem: SearchProblem) -> Sequence[Estimate]:
    """Return solutions of a law by all ways that lead to them; none if it has none."""
    return fit_with(problem, problem.allowed, NO_ERROR).estimates


def short_schedule(problem: SearchProblem) -> Sequence[Estimate]:
    """Return solutions of a law by a way that may get stuck in single objects."""
    return fit_each(problem.models, problem.starts, problem.allowed, settings.SHORT_SCHEDULE)


def multistart(
    problem: SearchProblem,
    estimates: Sequence[Estimate],
    begun: Sequence[Floats],
    way: Callable[[SearchProblem], Sequence[Estimate]],
) -> list[Estimate]:
    """Return the fit of largest likelihood of each object, from any of some coefficients; none if no fit succeeds.

    States of the estimates are near the true ones; other processes begin at zero. Coefficients to begin with have the
    shape (objects, equations, terms), and the way is `full_schedule` or `short_schedule`.
    """
    fits = list[Sequence[Estimate]]()
    for coefficients in begun:
        starts = problem.padded(
            [Estimate(estimate.states, theta) for estimate, theta in zip(estimates, coefficients, strict=True)]
        )
        fits.append(way(replace(problem, starts=starts)))
    return [best_estimate(candidates) for candidates in zip(*filter(None, fits), strict=True)]


def best_estimate(fits: Sequence[Estimate]) -> Estimate:
    """Return the fit of largest likelihood; of those that are the same the one with fewest numbers below zero.

    And then with small ones: ``A cos(w*t + p)`` is also ``-A cos(w*t + q)`` with q half a turn farther, and rounding
    is not to decide.
    """
    least = min(fit.objective for fit in fits)
    alike = [fit for fit in fits if fit.objective <= least + settings.SAME_DEVIANCE]
    return min(alike, key=lambda fit: (int(np.sum(fit.coefficients < 0)), float(np.abs(fit.coefficients).sum())))


def shrink_to_pooled(
    problem: SearchProblem, free: Sequence[Estimate], begun: Sequence[Floats] = ()
) -> tuple[SearchProblem, list[Estimate]]:
    """Return a problem and estimates drawn to what is typical, where measurements bear it as well as free ones.

    Free is the fit of each object by itself. What is typical say these fits, or coefficients to begin with, each of
    shape (objects, equations, terms), if they are likelier. In the problem, objects that are drawn have a prior.
    """
    best = list(free)
    if len(free) < settings.MIN_OBJECTS or not problem.models[0].terms.parameters:
        return problem, best
    unpooled, ranked = (
        np.array([estimate.coefficients for estimate in free]),
        list[tuple[float, Prior, list[Estimate]]](),
    )
    (width, least), allowed = settings.PRIOR_WIDTH, problem.allowed
    for coefficients in (unpooled, *begun):
        typical = np.median(coefficients, axis=0)
        scatter = 1.4826 * np.median(np.abs(coefficients - typical), axis=0)
        scatter = np.maximum(scatter, least * np.abs(typical))
        scatters = allowed & (scatter > 0)
        precision = np.divide(1.0, width * scatter, out=np.zeros_like(scatter), where=scatters) ** 2
        prior = Prior(typical, precision)
        both = [unpooled, np.broadcast_to(typical, unpooled.shape)]
        held = multistart(problem.with_priors([prior] * len(free)), free, both, short_schedule)
        if held:  # By minus twice the log-likelihood of objects and their coefficients
            normal = float(np.sum(np.log(precision[precision > 0])))
            ranked.append((sum(estimate.objective for estimate in held) - len(held) * normal, prior, held))
    if not ranked:
        return problem, best
    _, prior, held = min(ranked, key=lambda entry: entry[0])
    priors = list[Prior | None]([None] * len(free))
    for o, (one, unpooled_estimate) in enumerate(zip(held, free, strict=True)):
        if one.deviance < unpooled_estimate.deviance + settings.INDIFFERENT:
            priors[o], best[o] = prior, one
    return problem.with_priors(priors), best


def empirical_priors(problem: SearchProblem, begun: Floats) -> tuple[Prior | None, ...]:
    """Return what the others say of the coefficients of each object, besides some that are near.

    Nothing for laws without parameters, of few objects, or whose solutions cannot be fitted. Coefficients have the
    shape (objects, equations, terms).
    """
    nothing = (None,) * len(begun)
    if len(begun) < settings.MIN_OBJECTS or not problem.models[0].terms.parameters:
        return nothing
    free = multistart(problem, problem.starts, [begun], full_schedule)
    return tuple(model.prior for model in shrink_to_pooled(problem, free, [begun])[0].models) if free else nothing
