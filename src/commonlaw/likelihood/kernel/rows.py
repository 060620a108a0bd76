"""Linearisations by the kernel."""

import ctypes

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.likelihood.collocation import Jacobians
from commonlaw.likelihood.fitting import Estimate, TrajectoryModel
from commonlaw.likelihood.kernel.packing import Packed, address
from commonlaw.likelihood.linearization import vague
from commonlaw.likelihood.normal_equations import NotPositiveError

_NOT_POSITIVE = 2


def whitened(
    library: ctypes.CDLL, model: TrajectoryModel, packed: Packed, estimate: Estimate, model_error: float, free: Bools
) -> list[tuple[Floats, float]]:
    """Return what `commonlaw.likelihood.linearization.whitened` returns, to rounding."""
    return [_whitened(library, model, packed, index, estimate, model_error, free) for index in range(len(model.meshes))]


def jacobians(
    library: ctypes.CDLL, model: TrajectoryModel, packed: Packed, index: int, estimate: Estimate, free: Bools
) -> Jacobians:
    """Return what `commonlaw.likelihood.collocation.jacobians` returns of one mesh, to rounding.

    Where steps have no length, between segments, the derivatives by coefficients are zero.
    """
    steps, width = len(model.meshes[index]) - 1, model.width + model.latent.width
    states = np.ascontiguousarray(estimate.states[index], dtype=np.float64)
    coefficients = np.ascontiguousarray(estimate.coefficients, dtype=np.float64)
    free = np.ascontiguousarray(free, dtype=np.bool_)
    shapes = (steps, width), (steps, width, width), (steps, width, width), (steps, width, int(free.sum()))
    found = [np.empty(shape) for shape in shapes]
    inside = (address(each) for each in (free, states, coefficients, *found))
    if library.commonlaw_jacobians(packed.model, packed.meshes[index], *inside):
        raise MemoryError
    return Jacobians(*found)


def _whitened(
    library: ctypes.CDLL,
    model: TrajectoryModel,
    packed: Packed,
    index: int,
    estimate: Estimate,
    model_error: float,
    free: Bools,
) -> tuple[Floats, float]:
    mesh, latent = model.meshes[index], model.latent_steps[index]
    linear = jacobians(library, model, packed, index, estimate, free)
    columns = linear.coefficients.reshape(linear.defects.size, -1)
    target = columns @ estimate.coefficients[free] - linear.defects.ravel()
    if not (np.isfinite(columns).all() and np.isfinite(target).all()):
        raise NotPositiveError
    # Far from the origin terms are nearly alike: rounding in what follows would spoil what they differ in
    basis, mixed = np.linalg.qr(columns)
    rows = np.column_stack([basis, target])
    states, result = np.ascontiguousarray(estimate.states[index], dtype=np.float64), np.empty(1)
    stationary = np.zeros(0) if latent is None else latent.std**2
    assumed = vague(model, mesh, latent), stationary
    inside = (address(each) for each in (*assumed, linear.start, linear.end, rows))
    failed = library.commonlaw_whiten(
        *(packed.model, packed.meshes[index], address(states), model_error), *inside, rows.shape[1], address(result)
    )
    if failed:
        raise NotPositiveError if failed == _NOT_POSITIVE else MemoryError
    whole = np.empty((len(columns), columns.shape[1] + 1), order="F")
    whole[:, :-1], whole[:, -1] = rows[:, :-1] @ mixed, rows[:, -1]
    if not mesh.contiguous.all():
        whole = np.asfortranarray(whole[np.repeat(mesh.contiguous, linear.defects.shape[1])])
    return whole, float(result[0])
