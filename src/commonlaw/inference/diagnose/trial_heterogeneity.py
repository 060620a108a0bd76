"""Between-trial heterogeneity: F tests of coefficients that differ between the trials of an object.

With the likelihood linearized about the law, R_1 the residual sum of squares with coefficients common to the trials of
an object, R_2 with those of each trial, and degrees of freedom nu_1 and nu_2 of these,

    F = (R_1 - R_2) / (nu_1 - nu_2) / (R_2 / nu_2).
"""

from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats, evenly_spaced
from commonlaw.errors import CommonlawError
from commonlaw.formulation import column_scales
from commonlaw.inference import settings
from commonlaw.inference.fit.fit import Fit
from commonlaw.likelihood import Estimate, fit as fitted_states, linearize
from commonlaw.outcomes import Outcome, note
from commonlaw.text import shown


def differing_trials(fit: Fit) -> tuple[Outcome, ...]:
    """Return a note on the objects with heterogeneous trials, by F tests with Bonferroni correction."""
    trials = fit.problem.trials
    names = [name for name in trials.objects if len(trials.of_object(name)) > 1]
    names = [names[i] for i in evenly_spaced(len(names), settings.MAX_CHECKED_OBJECTS)] if names else []
    differing = [name for name in names if _p_value(fit, name) < settings.MIN_PROBABILITY / len(names)]
    return (note("trials-differ", objects=shown(differing)),) if differing else ()


def _p_value(fit: Fit, name: str) -> float:
    """Return the p-value of the F test of an object; one if its single trials cannot be fitted."""
    from scipy.special import fdtrc

    try:
        factors, n = _factors(fit, fit.problem.trials.objects.index(name))
    except CommonlawError:
        return 1.0
    common = factors[0].shape[1] - 1
    rss_common, rss = _rss(np.concatenate(factors)), sum(_rss(factor) for factor in factors)
    separate = sum(np.linalg.matrix_rank(factor[:, :-1]) for factor in factors)
    additional, nu = separate - common, n - separate
    if additional <= 0 or nu <= 0 or not common:
        return 1.0
    variance = max(rss / nu, fit.problem.least_variance)
    return float(fdtrc(additional, nu, max(rss_common - rss, 0.0) / additional / variance))


def _factors(fit: Fit, index: int) -> tuple[list[Floats], int]:
    """Return the triangular factor of each trial's problem, and the measurements less initial states of all trials."""
    problem = fit.problem
    group = problem.trials.of_object(problem.trials.objects[index])
    alone = [replace(trial, object=f"{i}", name="1") for i, trial in enumerate(group)]
    known = np.repeat(problem.known[index : index + 1], len(group), axis=0)
    estimate = fit.estimates[index]
    part = problem.of_trials(alone, known, np.array([estimate.coefficients] * len(group)))
    free: Bools = (estimate.coefficients != 0) & np.isnan(problem.known[index])
    none, last = np.zeros_like(free), fit.fitted_model_error
    errors = [error for error in settings.SHORT_SCHEDULE[1:] if error > last] + [last]
    factors = []
    for model, start in zip(part.models, part.starts, strict=True):
        fitted = fitted_states(model, Estimate(start.states, estimate.coefficients), none, errors)
        factors.append(linearize(model, fitted, last, free).problem.factor)
    return factors, sum(part.measured) - part.models[0].width * len(group)


def _rss(factor: Floats) -> float:
    """Return the residual sum of squares of the last column."""
    columns, target = factor[:, :-1], factor[:, -1]
    scaled = columns / column_scales(columns)
    theta = np.linalg.lstsq(scaled, target, rcond=1e-10)[0]
    return float(np.sum((target - scaled @ theta) ** 2))
