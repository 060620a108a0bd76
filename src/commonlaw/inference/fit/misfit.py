"""How far the paths of trials are from solutions of a law, where process noise was fitted."""

from dataclasses import replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference import settings
from commonlaw.inference.fit.covariance import outliers
from commonlaw.inference.fit.fit import Fit
from commonlaw.law import Law, Misfit
from commonlaw.likelihood import NotPositiveError, fit_each


def with_misfit(law: Law, fit: Fit) -> Law:
    """Return the law of a fit with the sizes of what its trials have beyond it."""
    trials, problem = fit.problem.trials, fit.problem
    misfit = Misfit.of(trials, int(outliers(fit).sum()), sum(problem.measured), deviation_of_paths(fit))
    return replace(law, uncertainty=replace(law.uncertainty, misfit=misfit))


def deviation_of_paths(fit: Fit) -> Floats | None:
    """Return the RMS deviation of the estimated paths from the nearest solutions of the law, shape (states,).

    With the path z of a trial, which process noise moves, and the solution x of the law without it that is nearest to
    the measurements in least squares, it is that of z - x at the measurements. It is None without process noise, and
    not finite where solutions are not.
    """
    if not fit.has_process_noise:
        return None
    before = fit.problem
    problem = before.with_errors(before.noise, before.errors.of_measurements, before.noise_reason)
    problem = problem.with_huber_threshold(np.inf)
    starts = [
        replace(estimate, states=tuple(states[:, : model.width] for states in estimate.states))
        for model, estimate in zip(problem.models, fit.estimates, strict=True)
    ]
    held = np.zeros_like(fit.supports)
    try:
        solved = fit_each(problem.models, starts, held, (*settings.MODEL_ERRORS, *settings.FINAL_MODEL_ERRORS))
    except NotPositiveError:
        return np.full(len(before.noise), np.nan)
    squares, counts = np.zeros((2, len(before.noise)))
    for model, path, solution in zip(problem.models, starts, solved, strict=True):
        for mesh, z, x in zip(model.meshes, path.states, solution.states, strict=True):
            seen = mesh.observed & ~mesh.still
            apart = (z - x)[:, : len(squares)]
            squares += np.sum(np.where(seen, apart, 0.0) ** 2, axis=0)
            counts += seen.sum(axis=0)
    return np.sqrt(squares / np.maximum(counts, 1))
