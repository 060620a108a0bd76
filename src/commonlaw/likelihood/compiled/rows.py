"""Linearisations by the kernel."""

import ctypes

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.formulation import LeastSquaresProblem, merge
from commonlaw.kernel import Vagueness, address
from commonlaw.likelihood.collocation import Jacobians
from commonlaw.likelihood.compiled.packing import Packed, contiguous
from commonlaw.likelihood.fitting import Estimate, TrajectoryModel
from commonlaw.likelihood.linearization import HIDDEN, MISSING, RATE, Linearization, joined, orthogonalized
from commonlaw.likelihood.normal_equations import NotPositiveError

_NOT_POSITIVE = 2

_MOST = 20_000
"""Numbers in rows that are in cache: of more of them LAPACK makes triangles sooner, by blocks."""

VAGUENESS = Vagueness(MISSING, RATE, HIDDEN)


def linearize(
    library: ctypes.CDLL, model: TrajectoryModel, packed: Packed, estimate: Estimate, model_error: float, free: Bools
) -> Linearization:
    """Return what `commonlaw.likelihood.linearization.linearize` returns, to rounding and signs of rows."""
    columns = int(free.sum()) + 1
    if not in_one_call(model, columns):
        return joined(whitened(library, model, packed, estimate, model_error, free), columns - 1)
    count, states = len(model.meshes), np.concatenate(estimate.states)
    coefficients = np.repeat(estimate.coefficients[np.newaxis], count, axis=0)
    free = np.ascontiguousarray(free, dtype=np.bool_)
    factors, log_determinants = np.empty((count, columns, columns)), np.empty(count)
    inside = (address(each) for each in (free, states, coefficients))
    check(
        library.commonlaw_linearize(
            *(packed.model, ctypes.addressof(packed.meshes), count, *inside, model_error, VAGUENESS),
            *(address(factors), address(log_determinants)),
        )
    )
    width = model.width + model.latent.width
    rows = [int(np.count_nonzero(mesh.contiguous)) * width for mesh in model.meshes]
    pairs = zip(factors, rows, strict=True)
    merged = merge(LeastSquaresProblem(np.asfortranarray(factor), columns - 1, own) for factor, own in pairs)
    return Linearization(merged, float(log_determinants.sum()))


def in_one_call(model: TrajectoryModel, columns: int) -> bool:
    """Whether rows of so many columns are made and compressed by the kernel: in cache, and of full rank."""
    sizes = [(len(mesh) - 1) * (model.width + model.latent.width) for mesh in model.meshes]
    return max(sizes) * columns <= _MOST and min(sizes) > columns


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
    states, coefficients = contiguous(estimate.states[index]), contiguous(estimate.coefficients)
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
    mesh = model.meshes[index]
    linear = jacobians(library, model, packed, index, estimate, free)
    columns = linear.coefficients.reshape(linear.defects.size, -1)
    target = columns @ estimate.coefficients[free] - linear.defects.ravel()
    if not (np.isfinite(columns).all() and np.isfinite(target).all()):
        raise NotPositiveError
    # Far from the origin terms are nearly alike: rounding in what follows would spoil what they differ in
    basis, mixed = orthogonalized(columns, free)
    rows = np.column_stack([basis, target])
    states, result = contiguous(estimate.states[index]), np.empty(1)
    failed = library.commonlaw_whiten(
        *(packed.model, packed.meshes[index], address(states), model_error, VAGUENESS),
        *(address(linear.start), address(linear.end), address(rows), rows.shape[1], address(result)),
    )
    check(failed)
    whole = np.empty((len(columns), columns.shape[1] + 1), order="F")
    whole[:, :-1], whole[:, -1] = rows[:, :-1] @ mixed, rows[:, -1]
    if not mesh.contiguous.all():
        whole = np.asfortranarray(whole[np.repeat(mesh.contiguous, linear.defects.shape[1])])
    return whole, float(result[0])


def check(failed: int) -> None:
    """Raise what the kernel says went wrong, if anything did."""
    if failed:
        raise NotPositiveError if failed == _NOT_POSITIVE else MemoryError
