"""How far states on a mesh are from a solution of a law, step by step, and how that depends on everything.

Hermite-Simpson collocation (Hargraves and Paris 1987): over a step h from z0 to z1 a solution of z' = f(z) has

    z1 - z0 - h/6 (f0 + 4 fm + f1) = O(h^5),    with fm at zm = (z0 + z1)/2 + h/8 (f0 - f1).

The error is h^5/720 times a fifth derivative for x' = x, and a quarter of that where f depends on time alone. The rule
is implicit, so that stiff laws need no small steps. All steps are worked on at once.
"""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.integration import VectorField
from commonlaw.likelihood.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Jacobians:
    """Defects of all steps, shape (n - 1, D), and their derivatives, zero between segments.

    These are with respect to the states at the `start` and at the `end` of the step, shape (n - 1, D, D), and to the
    field's parameters, the `coefficients`, shape (n - 1, D, parameters).
    """

    defects: Floats
    start: Floats
    end: Floats
    coefficients: Floats


def defects(field: VectorField, mesh: Mesh, states: Floats) -> Floats:
    """Return the defects of all steps, shape (n - 1, D); states are z = x, or z = (x, x'), of shape (n, D)."""
    derivatives = field.derivatives(_at_points(mesh, states))
    return _defects(mesh, states, derivatives, field.derivatives(_at_middles(mesh, states, derivatives)))


def jacobians(field: VectorField, mesh: Mesh, states: Floats) -> Jacobians:
    """Return the defects of all steps and their derivatives with respect to states and the field's parameters."""
    derivatives, by_states, by_own = field.linearize(_at_points(mesh, states))
    middle, mid_by_states, mid_by_own = field.linearize(_at_middles(mesh, states, derivatives))
    h, one = mesh.steps[:, np.newaxis, np.newaxis], np.eye(field.width)
    on = mesh.contiguous[:, np.newaxis, np.newaxis]
    start = -one - h / 6 * (by_states[:-1] + 4 * np.matmul(mid_by_states, one / 2 + h / 8 * by_states[:-1]))
    end = one - h / 6 * (by_states[1:] + 4 * np.matmul(mid_by_states, one / 2 - h / 8 * by_states[1:]))
    shifted = mid_by_own + np.matmul(h / 8 * mid_by_states, by_own[:-1] - by_own[1:])
    by_coefficients = -h / 6 * (by_own[:-1] + 4 * shifted + by_own[1:])
    return Jacobians(_defects(mesh, states, derivatives, middle), start * on, end * on, by_coefficients)


def _at_points(mesh: Mesh, states: Floats) -> Floats:
    """Return the values of the variables at the points, shape (n, variables)."""
    return np.column_stack([states, mesh.inputs, mesh.times])


def _at_middles(mesh: Mesh, states: Floats, derivatives: Floats) -> Floats:
    """Return the values of the variables in the middle of the steps, shape (n - 1, variables)."""
    middles = (states[:-1] + states[1:]) / 2 + mesh.steps[:, np.newaxis] / 8 * (derivatives[:-1] - derivatives[1:])
    inputs, times = mesh.inputs, mesh.times
    return np.column_stack([middles, (inputs[:-1] + inputs[1:]) / 2, (times[:-1] + times[1:]) / 2])


def _defects(mesh: Mesh, states: Floats, derivatives: Floats, middle: Floats) -> Floats:
    total = derivatives[:-1] + 4 * middle + derivatives[1:]
    return np.where(
        mesh.contiguous[:, np.newaxis], np.diff(states, axis=0) - mesh.steps[:, np.newaxis] / 6 * total, 0.0
    )
