"""Multi-start fits of nonlinear parameters, and shrinkage of objects toward the pooled parameters.

A nonlinear parameter is not practically identifiable from an object in whose trials its term is linear, and diverges. A
normal prior with the between-object scatter, from the medians of all objects (empirical Bayes), bounds it.
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
    """Return the estimates without model error by `fit_with`; none if they fail."""
    return fit_with(problem, problem.allowed, NO_ERROR).estimates


def short_schedule(problem: SearchProblem) -> Sequence[Estimate]:
    """Return the estimates without model error by one short continuation, which may fail in single objects."""
    return fit_each(problem.models, problem.starts, problem.allowed, settings.SHORT_SCHEDULE)


def multistart(
    problem: SearchProblem, initial: Sequence[Floats], fitting: Callable[[SearchProblem], Sequence[Estimate]]
) -> list[Estimate]:
    """Return the best fit of each object from several initial coefficients; none if no fit succeeds.

    Initial states are those of the problem, new latent processes are zero. Initial coefficients have shape (objects,
    equations, terms); `fitting` is `full_schedule` or `short_schedule`.
    """
    fits = list[Sequence[Estimate]]()
    for coefficients in initial:
        pairs = zip(problem.starts, coefficients, strict=True)
        starts = problem.padded([Estimate(start.states, theta) for start, theta in pairs])
        fits.append(fitting(replace(problem, starts=starts)))
    return [best_estimate(candidates) for candidates in zip(*filter(None, fits), strict=True)]


def best_estimate(fits: Sequence[Estimate]) -> Estimate:
    """Return the fit of largest likelihood; of equal ones that with the fewest negative, then smallest coefficients.

    This makes ``A cos(w*t + p) = -A cos(w*t + p + pi)`` unique.
    """
    least = min(fit.objective for fit in fits)
    equal = [fit for fit in fits if fit.objective <= least + settings.SAME_DEVIANCE]
    return min(equal, key=lambda fit: (int(np.sum(fit.coefficients < 0)), float(np.abs(fit.coefficients).sum())))


def shrink_to_pooled(
    problem: SearchProblem, separate: Sequence[Estimate], initial: Sequence[Floats] = ()
) -> tuple[SearchProblem, list[Estimate]]:
    """Return the problem with priors, and estimates, of objects that shrinkage toward pooled parameters fits as well.

    Priors are normal about medians over objects, with `PRIOR_WIDTH` times their median absolute deviations, of the
    unpooled estimates or of initial coefficients, each of shape (objects, equations, terms), whichever has the larger
    joint likelihood. Objects whose deviance increases by `INDIFFERENT` or more stay unpooled.
    """
    best = list(separate)
    if len(separate) < settings.MIN_OBJECTS or not problem.models[0].terms.parameters:
        return problem, best
    unpooled = np.array([estimate.coefficients for estimate in separate])
    ranked = list[tuple[float, Prior, list[Estimate]]]()
    (width, least), allowed = settings.PRIOR_WIDTH, problem.allowed
    for coefficients in (unpooled, *initial):
        median = np.median(coefficients, axis=0)
        sigma = 1.4826 * np.median(np.abs(coefficients - median), axis=0)
        sigma = np.maximum(sigma, least * np.abs(median))
        precision = np.divide(1.0, width * sigma, out=np.zeros_like(sigma), where=allowed & (sigma > 0)) ** 2
        prior = Prior(median, precision)
        both = [unpooled, np.broadcast_to(median, unpooled.shape)]
        shrinking = replace(problem.with_priors([prior] * len(separate)), starts=tuple(separate))
        shrunken = multistart(shrinking, both, short_schedule)
        if shrunken:  # Minus twice the joint log-likelihood of measurements and coefficients
            normal = float(np.sum(np.log(precision[precision > 0])))
            objective = sum(estimate.objective for estimate in shrunken) - len(shrunken) * normal
            ranked.append((objective, prior, shrunken))
    if not ranked:
        return problem, best
    _, prior, shrunken = min(ranked, key=lambda entry: entry[0])
    priors = list[Prior | None]([None] * len(separate))
    for o, (pooled, free) in enumerate(zip(shrunken, separate, strict=True)):
        if pooled.deviance < free.deviance + settings.INDIFFERENT:
            priors[o], best[o] = prior, pooled
    return problem.with_priors(priors), best


def empirical_priors(problem: SearchProblem, initial: Floats) -> tuple[Prior | None, ...]:
    """Return the empirical prior of each object's coefficients, from fits that start at initial ones.

    None for laws without nonlinear parameters, fewer than `MIN_OBJECTS` objects, or failed fits. Coefficients have
    shape (objects, equations, terms).
    """
    nothing = (None,) * len(initial)
    if len(initial) < settings.MIN_OBJECTS or not problem.models[0].terms.parameters:
        return nothing
    separate = multistart(problem, [initial], full_schedule)
    return tuple(m.prior for m in shrink_to_pooled(problem, separate, [initial])[0].models) if separate else nothing
