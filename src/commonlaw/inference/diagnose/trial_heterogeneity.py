"""Whether coefficients change from trial to trial of an object by more than errors of measurement."""

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
    """Return a word on the objects whose trials ask for different coefficients, by an F test of each object.

    What the likelihood, linearised about the law, leaves with coefficients common to an object's trials is compared
    with what it leaves with those of each trial alone.
    """
    trials = fit.problem.trials
    names = [name for name in trials.objects if len(trials.of_object(name)) > 1]
    names = [names[i] for i in evenly_spaced(len(names), settings.MAX_CHECKED_OBJECTS)] if names else []
    differing = [name for name in names if _probability(fit, name) < settings.MIN_PROBABILITY / len(names)]
    return (note("trials-differ", objects=shown(differing)),) if differing else ()


def _probability(fit: Fit, name: str) -> float:
    """Return how probable differences as large are between trials of an object that do not differ.

    One, where trials alone cannot be fitted.
    """
    from scipy.special import fdtrc

    try:
        factors, n = _factors(fit, fit.problem.trials.objects.index(name))
    except CommonlawError:
        return 1.0
    size = factors[0].shape[1] - 1
    alone = sum(_rest(factor) for factor in factors)
    together = _rest(np.concatenate(factors))
    free = sum(np.linalg.matrix_rank(factor[:, :-1]) for factor in factors)
    more = free - size
    within = n - free
    if more <= 0 or within <= 0 or not size:
        return 1.0
    variance = max(alone / within, fit.problem.least_variance)
    return float(fdtrc(more, within, max(together - alone, 0.0) / more / variance))


def _factors(fit: Fit, index: int) -> tuple[list[Floats], int]:
    """Return the triangular factor of each trial's problem, and the measurements and initial states of all."""
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


def _rest(factor: Floats) -> float:
    """Return the sum of squares that least squares leave of the last column."""
    columns, target = factor[:, :-1], factor[:, -1]
    scaled = columns / column_scales(columns)
    solved = np.linalg.lstsq(scaled, target, rcond=1e-10)[0]
    return float(np.sum((target - scaled @ solved) ** 2))
