"""Meshes fine enough for what the states do between samples."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from commonlaw.inference import settings
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.likelihood import Estimate, fit_each


def on_finer_mesh(fit: Fit, model_errors: Sequence[float]) -> Fit | None:
    """Return the fit on a finer mesh; None if that changes nothing, or if there is none."""
    problem = fit.problem
    if problem.points >= settings.MAX_MESH_POINTS[1]:
        return None
    finer = problem.finer()
    estimates = fit_each(finer.models, finer.starts_with(fit.estimates), fit.supports, model_errors)
    least = min(1.0, fit.evidence.noise_variance(fit.supports))
    if _change(problem, fit.estimates, finer, estimates) + _moved(fit, estimates) < settings.MAX_MESH_CHANGE * least:
        return None
    others = tuple(
        replace(each, problem=finer, estimates=finer.starts_with(each.estimates)) for each in fit.alternatives
    )
    return replace(fit, problem=finer, estimates=estimates, alternatives=others)


def until_resolved(fit: Fit, refit: Callable[[Fit], Fit]) -> Fit:
    """Refit on finer meshes until these do not matter, for laws that move fast between samples.

    A law with a model error needs none.
    """
    while fit.is_usable and not fit.has_model_error:
        finer = on_finer_mesh(fit, settings.FINAL_MODEL_ERRORS)
        if finer is None or not (finer := refit(finer)).is_usable:
            break
        fit = finer
    return fit


def _change(
    problem: SearchProblem, coarse: Sequence[Estimate], finer: SearchProblem, fine: Sequence[Estimate]
) -> float:
    """Return the sum of squared differences between measured states on two meshes, relative to the noise."""
    total, stride = 0.0, finer.points // problem.points
    for model, one, other in zip(problem.models, coarse, fine, strict=True):
        for mesh, states, finest in zip(model.meshes, one.states, other.states, strict=True):
            change = (finest[mesh.indices_on(stride)] - states)[:, : len(problem.noise)] / problem.std_of(mesh)
            total += float(np.sum(change[mesh.observed] ** 2))
    return total


def _moved(fit: Fit, fine: Sequence[Estimate]) -> float:
    """Return the sum of squared changes of coefficients on a finer mesh, relative to how surely they are known."""
    total = 0.0
    for own, known, one, other in zip(fit.evidence.problems, fit.problem.known, fit.estimates, fine, strict=True):
        free = fit.supports & np.isnan(known)
        change = own.factor[:, np.flatnonzero(free)] @ (other.coefficients - one.coefficients)[free]
        total += float(np.sum(change**2))
    return total
