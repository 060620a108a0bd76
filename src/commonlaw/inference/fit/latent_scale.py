"""The scale of a state that was never measured on an object, which its trials do not tell: other objects do.

Twice the state and half of the coefficient before it in the equations of measured states leave these as they are. So
the coefficients before it there are held at the mean of the objects on which it was measured.
"""

from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference import settings
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.latent_initialization import begun
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.likelihood import fit as fitted_states


def held_like_others(problem: SearchProblem, index: int) -> Bools:
    """Return which coefficients of an object are held like those of others, shape (equations, terms)."""
    measured = problem.measured_states[index]
    terms = problem.models[index].terms
    of_unmeasured = np.array([any(c in term.columns() for c in np.flatnonzero(~measured)) for term in terms.terms])
    is_known = any(own.all() for own in problem.measured_states)
    return np.asarray(measured[:, np.newaxis] & of_unmeasured & is_known)


def scatter_of_others(fit: Fit) -> Floats:
    """Return the variances of the coefficients of objects with all states, shape (equations, terms).

    Of a single object nothing tells how objects differ: then it is as if by as much as the coefficient.
    """
    whole = _of_whole(fit)
    return np.asarray(np.var(whole, axis=0, ddof=1) * (1 + 1 / len(whole)) if len(whole) > 1 else whole[0] ** 2)


def like_others(fit: Fit) -> Fit:
    """Return the fit with objects fitted again of which some coefficients are held."""
    whole, problem = _of_whole(fit), fit.problem
    if len(whole) in (0, len(problem.models)):
        return fit
    errors = (*(each for each in settings.MODEL_ERRORS if each > fit.fitted_model_error), fit.fitted_model_error)
    estimates = list(fit.estimates)
    for o, (model, start) in enumerate(zip(problem.models, problem.starts, strict=True)):
        if not problem.measured_states[o].all():
            free = fit.supports & ~held_like_others(problem, o)
            found = fitted_states(model, begun(model, start, whole), free, errors)
            if found.deviance < settings.MAX_DEVIANCE_RATIO * estimates[o].deviance:
                estimates[o] = found
    return replace(fit, estimates=tuple(estimates))


def _of_whole(fit: Fit) -> list[Floats]:
    pairs = zip(fit.estimates, fit.problem.measured_states, strict=True)
    return [each.coefficients for each, own in pairs if own.all()]
