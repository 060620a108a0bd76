"""Residuals of each object of a fit by collocation, by which its noise is estimated."""

from collections.abc import Sequence

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference.data.noise import noise_floor
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.likelihood import Estimate, NoiseByObject, omitted_by_object


def noise_by_object(problem: SearchProblem, estimates: Sequence[Estimate], used: Floats) -> NoiseByObject:
    """Return the residuals of each object, of which initial states and coefficients used up some measurements.

    These have the shape (objects, d). Residuals are standardized by what white noise is besides the noise of the
    object, and those that are outliers by their own median size, too, are left out.
    """
    squares, freedom, counts = np.zeros((3, *used.shape))
    floors = np.array([noise_floor(problem.trials.select(object=name)) for name in problem.trials.objects])
    measured = ~problem.trials.schema.is_latent
    for o, (name, model, estimate) in enumerate(zip(problem.trials.objects, problem.models, estimates, strict=True)):
        parts = zip(model.meshes, estimate.states, strict=True)
        sizes = np.concatenate(
            [
                np.where(mesh.still, np.nan, model.residuals(mesh, states) / problem.std_of(mesh))
                for mesh, states in parts
            ]
        )
        kept = np.isfinite(sizes) & ~omitted_by_object(sizes, model.observation.huber_threshold)
        of_object, noise = problem.replication[name], problem.errors.noise_of(name, problem.noise)
        squares[o] = np.where(kept, sizes**2, 0.0).sum(axis=0) * noise**2 + of_object.squares
        freedom[o] = np.where(measured, kept.sum(axis=0) + of_object.freedom - used[o], 0.0)
        counts[o] = of_object.counts
    return NoiseByObject(squares, freedom, counts, floors)


def approximately_used(problem: SearchProblem, estimates: Sequence[Estimate]) -> Floats:
    """Return how many measurements of each state the initial states and coefficients of each object use up."""
    rows = list[Floats]()
    for model, estimate, known in zip(problem.models, estimates, problem.known, strict=True):
        segments = np.sum([(mesh.moving > 0).sum(axis=0) for mesh in model.meshes], axis=0)
        free = (estimate.coefficients != 0) & np.isnan(known)
        rows.append(np.array(model.order) * segments + free.sum(axis=1))
    return np.array(rows)
