"""Fits of several objects to one law: the best of several beginnings, and what is told by other objects alone.

An object in whose trials a term does not bend tells no constant inside of it, which would leave for infinity. How the
constants of the others scatter says where it may be.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.inference.fit.annealing import fit_with
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.state import FINAL, NO_ERROR
from commonlaw.likelihood import Estimate, NotPositiveError, Prior, fit_each

_FEWEST = 3
"""Objects from which on scatter between them holds what one of them does not tell."""

_WIDER, _NORMAL, _LEAST_SCATTER = 3.0, 1.4826, 0.1
"""By how much it is taken wider than it is, standard deviations in a median absolute deviation, and the least scatter,
as a share of what is typical."""

_INDIFFERENT = 2.0
"""Twice the log-likelihood that an object's trials may lose by what is typical of others: so little says nothing."""

_SAME = 0.01
"""Twice the log-likelihood by which fits that are the same may differ by rounding."""

_SHORT = (3.0, 0.3, *FINAL)
"""Model errors that lead from measurements to a law in a short way, for most objects as good as the long one."""


def every_way(problem: SearchProblem) -> Sequence[Estimate]:
    """Return solutions of a law by all ways that lead to them."""
    return fit_with(problem, problem.allowed, NO_ERROR).estimates


def short_way(problem: SearchProblem) -> Sequence[Estimate]:
    """Return solutions of a law by a way that may get stuck in single objects."""
    return fit_each(problem.models, problem.starts, problem.allowed, _SHORT)


def best_fits(
    problem: SearchProblem,
    estimates: Sequence[Estimate],
    begun: Sequence[Floats],
    way: Callable[[SearchProblem], Sequence[Estimate]],
) -> list[Estimate]:
    """Return the fit of largest likelihood of each object, from any of some coefficients.

    Parameters
    ----------
    problem
        What was measured, and the terms.
    estimates
        States near the true ones, of each object; other processes beside them begin at zero.
    begun
        Coefficients, each of shape (objects, equations, terms).
    way
        `every_way` or `short_way`.

    Raises
    ------
    NotPositiveError
        If the likelihood cannot be computed from any of them.
    """
    found = []
    for coefficients in begun:
        starts = problem.padded([Estimate(each.states, own) for each, own in zip(estimates, coefficients, strict=True)])
        with suppress(CommonlawError):
            found.append(way(replace(problem, starts=starts)))
    if not found:
        raise NotPositiveError
    return [usual_of_best(own) for own in zip(*found, strict=True)]


def usual_of_best(fits: Sequence[Estimate]) -> Estimate:
    """Return the fit of largest likelihood; of those that are the same the one with fewest numbers below zero.

    And then with small ones: ``A cos(w*t + p)`` is also ``-A cos(w*t + q)`` with q half a turn farther, and rounding
    is not to decide.
    """
    least = min(each.objective for each in fits)
    alike = [each for each in fits if each.objective <= least + _SAME]
    return min(alike, key=lambda each: (int(np.sum(each.coefficients < 0)), float(np.abs(each.coefficients).sum())))


def drawn_together(
    problem: SearchProblem, free: Sequence[Estimate], begun: Sequence[Floats] = ()
) -> tuple[SearchProblem, list[Estimate]]:
    """Return estimates drawn to what is typical where measurements bear it as well as those that are free.

    Parameters
    ----------
    problem
        What was measured, and the terms.
    free
        The fit of each object by itself.
    begun
        Coefficients, each of shape (objects, equations, terms), that say what is typical beside those of these fits.
        The likeliest say it.

    Returns
    -------
    tuple
        The problem, in which objects that are drawn have a prior, and the estimates of all.
    """
    best = list(free)
    if len(free) < _FEWEST or not problem.models[0].terms.constants:
        return problem, best
    own, ranked = np.array([each.coefficients for each in free]), list[tuple[float, Prior, list[Estimate]]]()
    for coefficients in (own, *begun):
        prior = _prior(problem, coefficients)
        with suppress(NotPositiveError):
            both = [own, np.broadcast_to(prior.typical, own.shape)]
            held = best_fits(problem.with_priors([prior] * len(free)), free, both, short_way)
            ranked.append((_value(prior, held), prior, held))
    if not ranked:
        return problem, best
    _, prior, held = min(ranked, key=lambda each: each[0])
    priors = list[Prior | None]([None] * len(free))
    for o, (one, other) in enumerate(zip(held, free, strict=True)):
        if one.deviance < other.deviance + _INDIFFERENT:
            priors[o], best[o] = prior, one
    return problem.with_priors(priors), best


def priors_from(problem: SearchProblem, begun: Floats) -> tuple[Prior | None, ...]:
    """Return what the others say of the coefficients of each object, beside some that are near.

    Nothing for laws without constants, of few objects, or whose solutions cannot be fitted. Coefficients have the shape
    (objects, equations, terms).
    """
    nothing = (None,) * len(begun)
    if len(begun) < _FEWEST or not problem.models[0].terms.constants:
        return nothing
    try:
        free = best_fits(problem, problem.starts, [begun], every_way)
    except NotPositiveError:
        return nothing
    return tuple(each.prior for each in drawn_together(problem, free, [begun])[0].models)


def _value(prior: Prior, held: Sequence[Estimate]) -> float:
    """Return minus twice the log-likelihood of objects and their coefficients, but for a constant."""
    normal = float(np.sum(np.log(prior.precision[prior.precision > 0])))
    return sum(each.objective for each in held) - len(held) * normal


def _prior(problem: SearchProblem, found: Floats) -> Prior:
    """Return how coefficients, shape (objects, equations, terms), scatter over objects, much wider."""
    typical = np.median(found, axis=0)
    scatter = np.maximum(_NORMAL * np.median(np.abs(found - typical), axis=0), _LEAST_SCATTER * np.abs(typical))
    free = problem.allowed & (scatter > 0)
    precision = np.divide(1.0, _WIDER * scatter, out=np.zeros_like(scatter), where=free) ** 2
    return Prior(typical, precision)
