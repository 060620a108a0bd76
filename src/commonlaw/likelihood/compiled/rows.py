"""Linearisations by the kernel."""

import ctypes
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Bools, Floats
from commonlaw.formulation import LeastSquaresProblem, merge
from commonlaw.kernel import Vagueness, address
from commonlaw.likelihood.collocation import Jacobians
from commonlaw.likelihood.compiled.packing import Packed, addresses, contiguous
from commonlaw.likelihood.fitting import Estimate, NotPositiveError, TrajectoryModel
from commonlaw.likelihood.linearization import HIDDEN, MISSING, RATE, Linearization, orthogonalized

_NOT_POSITIVE = 2

_MOST = 20_000
"""Numbers in rows that are in cache: of more of them LAPACK makes triangles sooner, by blocks."""

_VAGUENESS = Vagueness(MISSING, RATE, HIDDEN)


def linearize_each(
    library: ctypes.CDLL,
    models: Sequence[TrajectoryModel],
    structures: Sequence[Packed],
    estimates: Sequence[Estimate],
    model_error: float,
    free: Bools,
) -> list[Linearization]:
    """Return what `commonlaw.likelihood.linearization.linearize` returns of each, to rounding and signs of rows."""
    columns = int(free.sum()) + 1
    large = [not in_one_call(model, columns) for model in models]
    if any(large):
        return [
            _linearize_by_parts(library, model, own, estimate, model_error, free)
            if alone
            else linearize_each(library, [model], [own], [estimate], model_error, free)[0]
            for model, own, estimate, alone in zip(models, structures, estimates, large, strict=True)
        ]
    counts = [len(model.meshes) for model in models]
    where, meshes = addresses(structures, counts), np.concatenate([each.words for each in structures])
    states = np.concatenate([values for estimate in estimates for values in estimate.states])
    coefficients = np.repeat([each.coefficients for each in estimates], counts, axis=0)
    factors, log_determinants = triangles(library, where, meshes, free, states, coefficients, model_error)
    cuts = np.cumsum(counts)[:-1]
    parts = zip(models, np.split(factors, cuts), np.split(log_determinants, cuts), strict=True)
    return [Linearization(_merged(model, triangle), float(logs.sum())) for model, triangle, logs in parts]


def _merged(model: TrajectoryModel, factors: Floats) -> LeastSquaresProblem:
    """Return the problem of one object from the factors of its meshes, each (columns + 1) x (columns + 1)."""
    width, terms = model.width + model.latent.width, factors.shape[1] - 1
    rows = [int(np.count_nonzero(mesh.contiguous)) * width for mesh in model.meshes]
    pairs = zip(factors, rows, strict=True)
    return merge(LeastSquaresProblem(np.asfortranarray(factor), terms, count) for factor, count in pairs)


def triangles(
    library: ctypes.CDLL,
    models: NDArray[np.uint64],
    meshes: NDArray[np.uint64],
    free: Bools,
    states: Floats,
    coefficients: Floats,
    model_error: float,
) -> tuple[Floats, Floats]:
    """Return the triangular factor of the rows of each mesh, and the log-determinants, shape (meshes,).

    Models are addresses, one a mesh, meshes as in `Packed`; states have shape (points, D + w), coefficients (meshes,
    equations, terms). Raises `NotPositiveError` if numbers are not finite, or too far apart.
    """
    size = int(free.sum()) + 1
    factors, log_determinants = np.empty((len(meshes), size, size)), np.empty(len(meshes))
    free = np.ascontiguousarray(free, dtype=np.bool_)
    inside = (address(each) for each in (free, states, coefficients))
    failed = library.commonlaw_linearize(
        *(address(models), address(meshes), len(meshes), *inside, model_error, _VAGUENESS),
        *(address(factors), address(log_determinants)),
    )
    _check(failed)
    return factors, log_determinants


def in_one_call(model: TrajectoryModel, columns: int) -> bool:
    """Whether rows of so many columns are made and compressed by the kernel: in cache, and of full rank."""
    sizes = [(len(mesh) - 1) * (model.width + model.latent.width) for mesh in model.meshes]
    return max(sizes) * columns <= _MOST and min(sizes) > columns


def whitened(
    library: ctypes.CDLL, model: TrajectoryModel, packed: Packed, estimate: Estimate, model_error: float, free: Bools
) -> list[tuple[Floats, float]]:
    """Return what `commonlaw.likelihood.linearization.whitened` returns, to rounding."""
    found = []
    for index in range(len(model.meshes)):
        rows, mixed, log_determinant = _whitened(library, model, packed, index, estimate, model_error, free)
        found.append((np.column_stack([rows[:, :-1] @ mixed, rows[:, -1]]), log_determinant))
    return found


def _linearize_by_parts(
    library: ctypes.CDLL, model: TrajectoryModel, packed: Packed, estimate: Estimate, model_error: float, free: Bools
) -> Linearization:
    """Return the linearisation of one object of which LAPACK compresses the rows."""
    problems, total = [], 0.0
    for index in range(len(model.meshes)):
        rows, mixed, log_determinant = _whitened(library, model, packed, index, estimate, model_error, free)
        factor = LeastSquaresProblem.of(rows[:, :-1], rows[:, -1:]).factor
        few = LeastSquaresProblem.of(factor[:, :-1] @ mixed, factor[:, -1:])
        problems.append(LeastSquaresProblem(few.factor, few.terms, len(rows)))
        total += log_determinant
    return Linearization(merge(problems), total)


def jacobians(
    library: ctypes.CDLL, model: TrajectoryModel, packed: Packed, index: int, estimate: Estimate, free: Bools
) -> Jacobians:
    """Return what `commonlaw.likelihood.collocation.jacobians` does of one mesh, to rounding; zero between segments."""
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
) -> tuple[Floats, Floats, float]:
    """Return rows [mixtures of columns | target] of one mesh, what makes columns of these, and the log-determinant."""
    mesh = model.meshes[index]
    linear = jacobians(library, model, packed, index, estimate, free)
    columns = linear.coefficients.reshape(linear.defects.size, -1)
    target = columns @ estimate.coefficients[free] - linear.defects.ravel()
    if not (np.isfinite(columns).all() and np.isfinite(target).all()):
        raise NotPositiveError
    # Far from the origin terms are nearly alike: rounding in what follows would spoil what they differ in
    basis, mixed = orthogonalized(columns, free, model)
    rows = np.column_stack([basis, target])
    states, result = contiguous(estimate.states[index]), np.empty(1)
    failed = library.commonlaw_whiten(
        *(packed.model, packed.meshes[index], address(states), model_error, _VAGUENESS),
        *(address(linear.start), address(linear.end), address(rows), rows.shape[1], address(result)),
    )
    _check(failed)
    if not mesh.contiguous.all():
        rows = rows[np.repeat(mesh.contiguous, linear.defects.shape[1])]
    return rows, mixed, float(result[0])


def _check(failed: int) -> None:
    if failed:
        raise NotPositiveError if failed == _NOT_POSITIVE else MemoryError
