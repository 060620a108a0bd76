"""Whether coefficients change from trial to trial of an object by more than errors of measurement."""

from contextlib import suppress
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation import column_scales
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.state import SearchState
from commonlaw.likelihood import Estimate, fit, linearize
from commonlaw.outcomes import Outcome, note
from commonlaw.spacing import evenly_spaced
from commonlaw.wording import shown

_OBJECTS = 30
"""Objects whose trials are compared at most, evenly spread."""

_RARE = 0.01
"""Probability of differences as large among all objects, if there are none, below which they are told."""

_MODEL_ERRORS = (0.3, 0.03, 0.003, 0.0003)
"""At which the states of a trial are fitted with coefficients that stay, relative to the noise."""


def differing_trials(problem: SearchProblem, state: SearchState) -> tuple[Outcome, ...]:
    """Return a word on the objects whose trials ask for different coefficients, by an F test of each object.

    What the likelihood, linearised about the law, leaves with coefficients common to an object's trials is compared
    with what it leaves with those of each trial alone.
    """
    names = [name for name in problem.trials.objects if len(problem.trials.of_object(name)) > 1]
    names = [names[i] for i in evenly_spaced(len(names), _OBJECTS)] if names else []
    found = []
    for name in names:
        with suppress(CommonlawError):
            if _probability(problem, state, name) < _RARE / len(names):
                found.append(name)
    if not found:
        return ()
    return (note("trials-differ", objects=shown(found)),)


def _probability(problem: SearchProblem, state: SearchState, name: str) -> float:
    """Return how probable differences as large are between trials of an object that do not differ."""
    from scipy.special import fdtrc

    index = problem.trials.objects.index(name)
    factors, left = _factors(problem, state, index)
    size = factors[0].shape[1] - 1
    alone = sum(_rest(each) for each in factors)
    together = _rest(np.concatenate(factors))
    free = sum(np.linalg.matrix_rank(each[:, :-1]) for each in factors)
    more = free - size
    within = left - free
    if more <= 0 or within <= 0 or not size:
        return 1.0
    variance = max(alone / within, problem.least_variance)
    return float(fdtrc(more, within, max(together - alone, 0.0) / more / variance))


def _factors(problem: SearchProblem, state: SearchState, index: int) -> tuple[list[Floats], int]:
    """Return the triangular factor of each trial's problem, and the measurements beside initial states of all."""
    group = problem.trials.of_object(problem.trials.objects[index])
    alone = [replace(trial, object=f"{i}", name="1") for i, trial in enumerate(group)]
    known = np.repeat(problem.known[index : index + 1], len(group), axis=0)
    estimate = state.estimates[index]
    part = problem.of_trials(alone, known, np.array([estimate.coefficients] * len(group)))
    own: Bools = (estimate.coefficients != 0) & np.isnan(problem.known[index])
    none, last = np.zeros_like(own), state.fitted_model_error
    errors = [each for each in _MODEL_ERRORS if each > last] + [last]
    found = []
    for model, start in zip(part.models, part.starts, strict=True):
        fitted = fit(model, Estimate(start.states, estimate.coefficients), none, errors)
        found.append(linearize(model, fitted, last, own).problem.factor)
    return found, sum(part.measured) - part.models[0].width * len(group)


def _rest(factor: Floats) -> float:
    """Return the sum of squares that least squares leave of the last column."""
    columns, target = factor[:, :-1], factor[:, -1]
    scaled = columns / column_scales(columns)
    solved = np.linalg.lstsq(scaled, target, rcond=1e-10)[0]
    return float(np.sum((target - scaled @ solved) ** 2))
