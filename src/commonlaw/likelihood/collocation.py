"""Defects of Hermite-Simpson collocation (Hargraves and Paris 1987) and their Jacobians.

Over a step h from z0 to z1 a solution of z' = f(z) has

    z1 - z0 - h/6 (f0 + 4 fm + f1) = O(h^5),    with fm at zm = (z0 + z1)/2 + h/8 (f0 - f1).

The error is h^5/720 times a fifth derivative for x' = x, and a quarter of that where f depends on time alone. The rule
is implicit, so that stiff laws need no small steps. All steps are evaluated at once.
"""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.integration import LinearizedField, VectorField
from commonlaw.likelihood.mesh import Mesh
from commonlaw.likelihood.observation_model import LatentSteps


@dataclass(frozen=True, eq=False)
class Jacobians:
    """Defects of all steps, shape (n - 1, D), and their derivatives, zero between segments.

    By the states at the `start` and the `end` of the step, shape (n - 1, D, D), and by the field's parameters, (n - 1,
    D, parameters).
    """

    defects: Floats
    start: Floats
    end: Floats
    coefficients: Floats


def defects(field: VectorField, mesh: Mesh, states: Floats, latent: LatentSteps | None = None) -> Floats:
    """Return the defects of all steps, followed by those of latent processes, shape (n - 1, D + w)."""
    z, hidden = _split(field, states, latent)
    forces = _forces(field, hidden, latent)
    derivatives = field.derivatives(np.column_stack([z, mesh.inputs, mesh.times])) + forces
    first, last = derivatives[:-1], derivatives[1:]
    if mesh.held:
        last = field.derivatives(_at_ends(mesh, z)) + forces[1:]
    middle = field.derivatives(_at_middles(mesh, z, first, last)) + (forces[:-1] + forces[1:]) / 2
    law_defects = _defects(mesh, z, first, last, middle)
    return law_defects if latent is None else np.column_stack([law_defects, _latent_defects(hidden, latent)])


def jacobians(field: VectorField, mesh: Mesh, states: Floats, latent: LatentSteps | None = None) -> Jacobians:
    """Return the defects of all steps and their derivatives with respect to states and the field's parameters."""
    z, hidden = _split(field, states, latent)
    forces = _forces(field, hidden, latent)
    at_points = field.linearize(np.column_stack([z, mesh.inputs, mesh.times]))
    first = LinearizedField(*(block[:-1] for block in at_points))
    last = field.linearize(_at_ends(mesh, z)) if mesh.held else LinearizedField(*(block[1:] for block in at_points))
    derivatives = first.derivatives + forces[:-1], last.derivatives + forces[1:]
    middle, mid_by_states, mid_by_own = field.linearize(_at_middles(mesh, z, *derivatives))
    h, one = mesh.steps[:, np.newaxis, np.newaxis], np.eye(field.width)
    on = mesh.contiguous[:, np.newaxis, np.newaxis]
    start = -one - h / 6 * (first.by_states + 4 * np.matmul(mid_by_states, one / 2 + h / 8 * first.by_states))
    end = one - h / 6 * (last.by_states + 4 * np.matmul(mid_by_states, one / 2 - h / 8 * last.by_states))
    shifted = mid_by_own + np.matmul(h / 8 * mid_by_states, first.by_parameters - last.by_parameters)
    by_coefficients = -h / 6 * (first.by_parameters + 4 * shifted + last.by_parameters)
    law_defects = _defects(mesh, z, *derivatives, middle + (forces[:-1] + forces[1:]) / 2)
    law = Jacobians(law_defects, start * on, end * on, by_coefficients)
    if latent is None:
        return law
    shares = np.eye(field.width)[:, field.highest]
    by_forces = -h / 6 * (3 * shares + np.array([[[[1.0]]], [[[-1.0]]]]) * h / 2 * np.matmul(mid_by_states, shares))
    return _with_latent(law, hidden, latent, by_forces * on)


def _split(field: VectorField, states: Floats, latent: LatentSteps | None) -> tuple[Floats, Floats]:
    """Return states, and the latent processes with increments."""
    z, hidden = np.split(states, [field.width], axis=1)
    return z, hidden if latent is None else hidden[:, : latent.start.shape[1]]


def _with_latent(law: Jacobians, hidden: Floats, latent: LatentSteps, by_forces: Floats) -> Jacobians:
    """Return the Jacobians of a law and of latent processes; derivatives by the forces have shape (2, n - 1, D, d)."""
    steps, width, parameters = law.coefficients.shape
    wide, ends = width + hidden.shape[1], []
    for law_matrices, matrices, forces in (
        (law.start, latent.start, by_forces[0]),
        (law.end, latent.end, by_forces[1]),
    ):
        joined = np.zeros((steps, wide, wide))
        joined[:, :width, :width], joined[:, width:, width:] = law_matrices, matrices
        if latent.force is not None:
            joined[:, :width, width + latent.force : width + latent.force + forces.shape[2]] = forces
        ends.append(joined)
    by_coefficients = np.concatenate([law.coefficients, np.zeros((steps, wide - width, parameters))], axis=1)
    all_defects = np.column_stack([law.defects, _latent_defects(hidden, latent)])
    return Jacobians(all_defects, ends[0], ends[1], by_coefficients)


def _latent_defects(hidden: Floats, latent: LatentSteps) -> Floats:
    before, after = hidden[:-1, :, np.newaxis], hidden[1:, :, np.newaxis]
    return np.asarray((np.matmul(latent.start, before) + np.matmul(latent.end, after))[:, :, 0])


def _forces(field: VectorField, hidden: Floats, latent: LatentSteps | None) -> Floats:
    """Return the contribution of random forces to the derivatives of all states, shape (n, D)."""
    forces = np.zeros((len(hidden), field.width))
    if latent is not None and latent.force is not None:
        equations = len(field.coefficients)
        forces[:, field.highest] = hidden[:, latent.force : latent.force + equations]
    return forces


def _at_ends(mesh: Mesh, states: Floats) -> Floats:
    """Return the variables at the ends of steps, with zero-order hold of inputs, shape (n - 1, variables)."""
    return np.column_stack([states[1:], mesh.inputs[:-1], mesh.times[1:]])


def _at_middles(mesh: Mesh, states: Floats, first: Floats, last: Floats) -> Floats:
    """Return the variables at the midpoints of steps, given derivatives at both ends, shape (n - 1, variables)."""
    middles = (states[:-1] + states[1:]) / 2 + mesh.steps[:, np.newaxis] / 8 * (first - last)
    inputs = (mesh.inputs[:-1] + mesh.inputs[1:]) / 2 if mesh.middle is None else mesh.middle
    return np.column_stack([middles, inputs, (mesh.times[:-1] + mesh.times[1:]) / 2])


def _defects(mesh: Mesh, states: Floats, first: Floats, last: Floats, middle: Floats) -> Floats:
    total = first + 4 * middle + last
    return np.where(
        mesh.contiguous[:, np.newaxis], np.diff(states, axis=0) - mesh.steps[:, np.newaxis] / 6 * total, 0.0
    )
