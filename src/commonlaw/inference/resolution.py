"""Meshes fine enough for what the states do between samples."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference.objects import Objects
from commonlaw.inference.search import Found
from commonlaw.likelihood import Estimate, fit
from commonlaw.trials import Trials

FINEST = 4
"""Points for each sampling step; laws that need more are not resolved by their samples."""

_RESOLVED = 1.0
"""What a finer mesh may change in twice the log-likelihood; a term is worth many times that."""


def on_finer_mesh(
    trials: Trials, objects: Objects, found: Found, tolerances: Sequence[float]
) -> tuple[Objects, tuple[Estimate, ...]] | None:
    """Return the objects on a finer mesh, and what was found fitted to them; None if that changes nothing.

    Or if there is no finer mesh.
    """
    if objects.points >= FINEST:
        return None
    finer = objects.finer(trials)
    estimates = tuple(
        fit(model, replace(start, coefficients=own.coefficients), found.supports, tolerances)
        for model, start, own in zip(finer.models, finer.starts, found.estimates, strict=True)
    )
    return None if _change(objects, found.estimates, finer, estimates) < _RESOLVED else (finer, estimates)


def _change(objects: Objects, coarse: Sequence[Estimate], finer: Objects, fine: Sequence[Estimate]) -> float:
    """Return the sum of squared differences between measured states on two meshes, relative to the noise."""
    total, stride = 0.0, finer.points // objects.points
    for model, one, other in zip(objects.models, coarse, fine, strict=True):
        for mesh, states, finest in zip(model.meshes, one.states, other.states, strict=True):
            gap = (_at_samples(finest, mesh.contiguous, stride) - states)[:, : len(objects.noise)] / objects.noise
            total += float(np.sum(gap[mesh.observed] ** 2))
    return total


def _at_samples(states: Floats, linked: Bools, stride: int) -> Floats:
    """Return the rows of a finer mesh at the points of a coarser one, whose links are given."""
    indices = np.concatenate([[0], np.cumsum(np.where(linked, stride, 1))])
    rows: Floats = states[indices]
    return rows
