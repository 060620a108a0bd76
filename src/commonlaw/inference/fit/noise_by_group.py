"""Residuals of each object, or each trial, of a fit by collocation, by which its noise is estimated."""

from collections.abc import Sequence

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference.data.noise import noise_floor
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.likelihood import Estimate, NoiseByGroup, by_group, omitted_by_group
from commonlaw.runtime.fit_options import ErrorKind


def noise_by_group(
    problem: SearchProblem, estimates: Sequence[Estimate], used: Floats, kind: ErrorKind
) -> NoiseByGroup:
    """Return the residuals of each group of a kind of noise, in the order of objects and their trials.

    Of each object initial states and coefficients used up some measurements, shape (objects, d), of its groups in
    proportion to their measurements. Residuals are standardized by what white noise is besides that of the group, and
    those that are outliers by its own median size, too, are left out.
    """
    groups = by_group(kind).groups(problem.in_order)
    count, measured = int(groups.max()) + 1, ~problem.trials.schema.is_latent
    squares, freedom, counts = np.zeros((3, count, len(problem.noise)))
    members = [[trial for trial, g in zip(problem.in_order, groups, strict=True) if g == k] for k in range(count)]
    floors = np.array([noise_floor(problem.trials.with_trials(group)) for group in members])
    for o, (model, estimate, of_point) in enumerate(
        zip(problem.models, estimates, problem.trial_of_points, strict=True)
    ):
        sizes = np.concatenate(
            [
                np.where(mesh.still, np.nan, model.residuals(mesh, states) / problem.std_of(mesh))
                for mesh, states in zip(model.meshes, estimate.states, strict=True)
            ]
        )
        own_groups = groups[of_point]
        parts = [(k, sizes[own_groups == k]) for k in np.unique(own_groups).tolist()]
        kept = {k: np.isfinite(part) & ~omitted_by_group(part, model.observation.huber_threshold) for k, part in parts}
        total = np.maximum(sum(inside.sum(axis=0) for inside in kept.values()), 1)
        for k, part in parts:
            noise = problem.errors.noise_of_trial(members[k][0], problem.noise)
            squares[k] = np.where(kept[k], part**2, 0.0).sum(axis=0) * noise**2
            freedom[k] = kept[k].sum(axis=0) * (1 - used[o] / total)
    for k, (_, of_trial) in zip(groups, problem.replication, strict=True):
        squares[k] += of_trial.squares
        freedom[k] += of_trial.freedom
        counts[k] += of_trial.counts
    return NoiseByGroup(squares, np.where(measured, freedom, 0.0), counts, floors)


def approximately_used(problem: SearchProblem, estimates: Sequence[Estimate]) -> Floats:
    """Return how many measurements of each state the initial states and coefficients of each object use up."""
    rows = list[Floats]()
    for model, estimate, known in zip(problem.models, estimates, problem.known, strict=True):
        segments = np.sum([(mesh.moving > 0).sum(axis=0) for mesh in model.meshes], axis=0)
        free = (estimate.coefficients != 0) & np.isnan(known)
        rows.append(np.array(model.order) * segments + free.sum(axis=1))
    return np.array(rows)
