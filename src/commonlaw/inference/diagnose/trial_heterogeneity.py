"""Between-trial heterogeneity of the coefficients of a law, see `commonlaw.likelihood.linearization`."""

from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats, evenly_spaced
from commonlaw.errors import CommonlawError
from commonlaw.inference import settings
from commonlaw.inference.fit.fit import Fit
from commonlaw.likelihood import Estimate, fit as fitted_states, linearize
from commonlaw.likelihood.linearization import HETEROGENEITY_LEVEL, heterogeneity_p_value
from commonlaw.outcomes import Outcome, note
from commonlaw.text import shown


def differing_trials(fit: Fit) -> tuple[Outcome, ...]:
    """Return a note on the objects with heterogeneous trials, by F tests with Bonferroni correction."""
    trials = fit.problem.trials
    names = [name for name in trials.objects if len(trials.of_object(name)) > 1]
    names = [names[i] for i in evenly_spaced(len(names), settings.MAX_CHECKED_OBJECTS)] if names else []
    differing = [name for name in names if _p_value(fit, name) < HETEROGENEITY_LEVEL / len(names)]
    return (note("trials-differ", objects=shown(differing)),) if differing else ()


def _p_value(fit: Fit, name: str) -> float:
    """Return the p-value of the F test of an object; one if its single trials cannot be fitted."""
    try:
        factors, n = _factors(fit, fit.problem.trials.objects.index(name))
    except CommonlawError:
        return 1.0
    return heterogeneity_p_value(factors, n, fit.problem.least_variance)


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
