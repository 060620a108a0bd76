"""Fits and linearizations of whole objects by the compiled kernel, equal to those of NumPy up to rounding."""

import ctypes
from collections.abc import Sequence
from ctypes import addressof
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.formulation import LeastSquaresProblem, merge
from commonlaw.kernel import LEAST_NORM, MeshStructure, ModelStructure, ProgramStructure, Vagueness, address
from commonlaw.library import highest_columns, with_rates
from commonlaw.library.program import Program
from commonlaw.likelihood.collocation import Jacobians
from commonlaw.likelihood.fitting import GAIN, SHORTEST, Estimate, NotPositiveError, TrajectoryModel, least_norm
from commonlaw.likelihood.linearization import HIDDEN, MISSING, RATE, Linearization, orthogonalized
from commonlaw.likelihood.mesh import Grid, Mesh, concatenated
from commonlaw.likelihood.observation_model import LatentProcesses, LatentSteps


@dataclass(frozen=True, eq=False)
class Packed:
    """The C structures of a model, those of its meshes also as 8-byte words, and the arrays they point to."""

    model: ModelStructure
    meshes: Any
    words: NDArray[np.uint64]
    kept: tuple[object, ...]


FIELDS = {name: getattr(MeshStructure, name).offset // 8 for name, *_ in MeshStructure._fields_}


def addresses(structures: Sequence[Packed], counts: Sequence[int] | None = None) -> NDArray[np.uint64]:
    """Return the addresses of models, each repeated by its count."""
    pointers = np.array([addressof(structure.model) for structure in structures], dtype=np.uint64)
    return pointers if counts is None else np.repeat(pointers, counts)


_MODELS: "WeakKeyDictionary[TrajectoryModel, Packed]" = WeakKeyDictionary()


def packed(model: TrajectoryModel) -> Packed | None:
    """Return the structures of a model; None if the kernel does not apply."""
    if model in _MODELS:
        return _MODELS[model]
    if (model.order != 1 and model.terms.variables.logarithmic) or model.terms.program.calls:
        return None
    program, noise = model.terms.program, model.observation.noise
    meshes = [_mesh(mesh, noise, steps) for mesh, steps in zip(model.meshes, model.latent_steps, strict=True)]
    unit, logarithmic = contiguous(model.unit), np.zeros(model.width, dtype=np.uint8)
    second, highest = (of(model.order, model.equations).astype(np.int64) for of in (with_rates, highest_columns))
    logarithmic[list(model.terms.variables.logarithmic_columns)] = 1
    inside = np.array(model.terms.parameters, dtype=np.int64)
    prior = (None, None) if model.prior is None else tuple(map(contiguous, model.prior))
    latent = model.latent_steps[0]
    std, mean = contiguous(model.latent.std), contiguous(model.latent.mean)
    if program not in _PROGRAMS:
        counts = (program.variables, len(program.constants), len(program.code), len(program.outputs))
        arrays = (program.constants, program.code, program.outputs)
        _PROGRAMS[program] = ProgramStructure(*counts, *map(address, arrays))
    structure = ModelStructure(
        model.equations,
        len(second),
        model.meshes[0].inputs.shape[1],
        model.latent.width,
        any(mesh.held for mesh in model.meshes),
        model.latent.correlated is not None,
        model.latent.walks,
        model.latent.drift is not None,
        model.observation.rejects,
        -1 if latent is None or latent.force is None else latent.force,
        len(inside),
        float(model.observation.huber_threshold),
        address(unit),
        address(std),
        address(mean),
        address(logarithmic),
        address(inside),
        address(second),
        address(highest),
        *(address(array) if array is not None else 0 for array in prior),
        _PROGRAMS[program],
    )
    kept = (unit, std, mean, logarithmic, inside, second, highest, prior, program, meshes)
    structures = (MeshStructure * len(meshes))(*(structure for structure, _ in meshes))
    words = np.frombuffer(memoryview(structures), np.uint64).reshape(len(meshes), -1)
    _MODELS[model] = Packed(structure, structures, words, kept)
    return _MODELS[model]


_PROGRAMS: "WeakKeyDictionary[Program, ProgramStructure]" = WeakKeyDictionary()


_GRIDS: "WeakKeyDictionary[Grid, tuple[int, ...]]" = WeakKeyDictionary()
"""Addresses of arrays, which are not part of a grid, as they differ between processes."""


def _mesh(mesh: Mesh, noise: Floats, latent: LatentSteps | None) -> tuple[MeshStructure, object]:
    """Return the structure of a mesh, and the arrays it points to."""
    grid = mesh.grid
    if grid not in _GRIDS:
        _GRIDS[grid] = (*map(address, grid.arrays), address(grid.contiguous))
    std = contiguous(np.broadcast_to(noise * mesh.scale, mesh.measured.shape))
    hidden = () if latent is None else tuple(map(contiguous, (latent.start, latent.end, latent.anchors)))
    addresses = tuple(map(address, hidden)) or (0, 0, 0)
    return MeshStructure(len(mesh), mesh.typical_step, *_GRIDS[grid], address(std), *addresses), (grid, std, hidden)


def contiguous(values: Floats) -> Floats:
    return np.ascontiguousarray(values, dtype=np.float64)


_MAX_ROW_NUMBERS = 20_000
"""Numbers in rows up to which the kernel, in cache, is faster than blocked LAPACK."""

_VAGUENESS = Vagueness(MISSING, RATE, HIDDEN)


def linearize_each(
    library: ctypes.CDLL,
    models: Sequence[TrajectoryModel],
    structures: Sequence[Packed],
    estimates: Sequence[Estimate],
    model_error: float,
    free: Bools,
) -> list[Linearization]:
    """Return the linearization of each object as `linearization.linearize` does, up to rounding and signs of rows."""
    columns = int(free.sum()) + 1
    large = [not in_one_call(model, columns) for model in models]
    if any(large):
        return [
            _linearize_by_parts(library, model, structure, estimate, model_error, free)
            if alone
            else linearize_each(library, [model], [structure], [estimate], model_error, free)[0]
            for model, structure, estimate, alone in zip(models, structures, estimates, large, strict=True)
        ]
    counts = [len(model.meshes) for model in models]
    where, meshes = addresses(structures, counts), np.concatenate([structure.words for structure in structures])
    states = np.concatenate([values for estimate in estimates for values in estimate.states])
    coefficients = np.repeat([estimate.coefficients for estimate in estimates], counts, axis=0)
    factors, log_determinants = triangles(library, where, meshes, free, states, coefficients, model_error)
    cuts = np.cumsum(counts)[:-1]
    parts = zip(models, np.split(factors, cuts), np.split(log_determinants, cuts), strict=True)
    linearizations = []
    for model, triangle, logs in parts:
        rows = [np.count_nonzero(mesh.contiguous) * (model.width + model.latent.chained) for mesh in model.meshes]
        pairs = zip(triangle, rows, strict=True)
        problem = merge(LeastSquaresProblem(np.asfortranarray(r), columns - 1, int(count)) for r, count in pairs)
        linearizations.append(Linearization(problem, float(logs.sum())))
    return linearizations


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
    inside = (address(array) for array in (free, states, coefficients))
    code = library.commonlaw_linearize(
        *(address(models), address(meshes), len(meshes), *inside, model_error, _VAGUENESS),
        *(address(factors), address(log_determinants)),
    )
    _check(code)
    return factors, log_determinants


def in_one_call(model: TrajectoryModel, columns: int) -> bool:
    """Return whether the kernel computes and compresses rows of so many columns: in cache, and of full rank."""
    sizes = [(len(mesh) - 1) * (model.width + model.latent.chained) for mesh in model.meshes]
    return max(sizes) * columns <= _MAX_ROW_NUMBERS and min(sizes) > columns


def whitened(
    library: ctypes.CDLL, model: TrajectoryModel, packed: Packed, estimate: Estimate, model_error: float, free: Bools
) -> list[tuple[Floats, float]]:
    """Return the whitened rows of each mesh as `linearization.whitened` does, up to rounding."""
    blocks = []
    for index in range(len(model.meshes)):
        rows, triangle, log_determinant = _whitened(library, model, packed, index, estimate, model_error, free)
        blocks.append((np.column_stack([rows[:, :-1] @ triangle, rows[:, -1]]), log_determinant))
    return blocks


def _linearize_by_parts(
    library: ctypes.CDLL, model: TrajectoryModel, packed: Packed, estimate: Estimate, model_error: float, free: Bools
) -> Linearization:
    """Return the linearization of one object with rows compressed by LAPACK."""
    problems, total = [], 0.0
    for index in range(len(model.meshes)):
        rows, triangle, log_determinant = _whitened(library, model, packed, index, estimate, model_error, free)
        factor = LeastSquaresProblem.of(rows[:, :-1], rows[:, -1:]).factor
        few = LeastSquaresProblem.of(factor[:, :-1] @ triangle, factor[:, -1:])
        problems.append(LeastSquaresProblem(few.factor, few.terms, len(rows)))
        total += log_determinant
    return Linearization(merge(problems), total)


def jacobians(
    library: ctypes.CDLL, model: TrajectoryModel, packed: Packed, index: int, estimate: Estimate, free: Bools
) -> Jacobians:
    """Return the Jacobians of one mesh as `collocation.jacobians` does, up to rounding; zero between segments."""
    steps, width = len(model.meshes[index]) - 1, model.width + model.latent.chained
    states, coefficients = contiguous(estimate.states[index]), contiguous(estimate.coefficients)
    free = np.ascontiguousarray(free, dtype=np.bool_)
    shapes = (steps, width), (steps, width, width), (steps, width, width), (steps, width, int(free.sum()))
    outputs = [np.empty(shape) for shape in shapes]
    inside = (address(array) for array in (free, states, coefficients, *outputs))
    _check(library.commonlaw_jacobians(packed.model, packed.meshes[index], *inside))
    return Jacobians(*outputs)


def sensitivities(
    library: ctypes.CDLL,
    model: TrajectoryModel,
    packed: Packed,
    index: int,
    estimate: Estimate,
    free: Bools,
    wanted: Bools,
) -> Floats:
    """Return the sensitivities of one mesh as `linearization.sensitivities` does, up to rounding."""
    states, coefficients = contiguous(estimate.states[index]), contiguous(estimate.coefficients)
    free, wanted = (np.ascontiguousarray(mask, dtype=np.bool_) for mask in (free, wanted))
    result = np.empty((int(wanted.sum()), model.width, model.width + int(free.sum())))
    inside = (address(array) for array in (free, states, coefficients, wanted, result))
    _check(library.commonlaw_sensitivities(packed.model, packed.meshes[index], *inside))
    return result


def _whitened(
    library: ctypes.CDLL,
    model: TrajectoryModel,
    packed: Packed,
    index: int,
    estimate: Estimate,
    model_error: float,
    free: Bools,
) -> tuple[Floats, Floats, float]:
    """Return rows [Q | target] of one mesh, see `orthogonalized`, the matrix R, and the log-determinant."""
    mesh = model.meshes[index]
    linear = jacobians(library, model, packed, index, estimate, free)
    columns = linear.coefficients.reshape(linear.defects.size, -1)
    target = columns @ estimate.coefficients[free] - linear.defects.ravel()
    if not (np.isfinite(columns).all() and np.isfinite(target).all()):
        raise NotPositiveError
    # Orthogonal columns keep their digits where terms are nearly collinear, far from the origin
    basis, triangle = orthogonalized(columns, free, model)
    of_drift = model.latent.width - model.latent.chained  # Columns of the drift, which the kernel fills
    rows = np.column_stack([np.zeros((len(target), of_drift)), basis, target])
    states, result = contiguous(estimate.states[index]), np.empty(1)
    code = library.commonlaw_whiten(
        *(packed.model, packed.meshes[index], address(states), model_error, _VAGUENESS),
        *(address(linear.start), address(linear.end), address(rows), rows.shape[1], address(result)),
    )
    _check(code)
    rows = rows[:, of_drift:]
    if not mesh.contiguous.all():
        rows = rows[np.repeat(mesh.contiguous, linear.defects.shape[1])]
    return rows, triangle, float(result[0])


def _check(code: int) -> None:
    if code:
        raise NotPositiveError if code == 2 else MemoryError  # As in the kernel


def fit_each(
    library: ctypes.CDLL,
    models: Sequence[TrajectoryModel],
    structures: Sequence[Packed],
    starts: Sequence[Estimate],
    support: Bools,
    model_errors: Sequence[float],
    steps: int,
) -> list[Estimate]:
    """Return the estimate of each object as `fitting.fit` does, up to rounding."""
    if not len(model_errors):
        return list(starts)
    shapes = [(sum(map(len, model.meshes)), model.width + model.latent.width) for model in models]
    states = [np.concatenate(start.states, dtype=np.float64) for start in starts]
    of_law = (models[0].equations, len(models[0].terms))
    if [state.shape for state in states] != shapes or any(start.coefficients.shape != of_law for start in starts):
        raise ValueError("states or coefficients do not have the shapes of the model")
    whole, coefficients = np.concatenate(states), np.array([start.coefficients for start in starts], dtype=np.float64)
    counts = np.array([len(model.meshes) for model in models], dtype=np.int64)
    pointers, meshes = addresses(structures), np.concatenate([structure.words for structure in structures])
    free, errors = np.ascontiguousarray(support, dtype=np.bool_), np.array(model_errors, float)
    reached = np.empty((len(models), 2))
    code = library.commonlaw_fit(
        *(address(pointers), len(models), address(meshes), address(counts)),
        *(address(free), address(errors), len(errors), steps, GAIN, SHORTEST, _LEAST_NORM),
        *(address(whole), address(coefficients), address(reached)),
    )
    _check(code)
    lengths = [len(mesh) for model in models for mesh in model.meshes]
    parts = iter(np.split(whole, np.cumsum(lengths)[:-1]))
    return [
        Estimate(tuple(next(parts) for _ in model.meshes), theta, *of_fit)
        for model, theta, of_fit in zip(models, coefficients, reached.tolist(), strict=True)
    ]


def _least_norm(count: int, matrix: Any, right: Any, solution: Any) -> int:
    """Write the minimum-norm solution of a symmetric system; return whether there is one."""
    as_array = np.ctypeslib.as_array
    try:
        as_array(solution, (count,))[:] = least_norm(as_array(matrix, (count, count)), as_array(right, (count,)))
    except np.linalg.LinAlgError:
        return 0
    return 1


_LEAST_NORM = LEAST_NORM(_least_norm)


@dataclass(frozen=True, eq=False)
class BatchedModel:
    """Objects of one mesh each, concatenated, and the estimates about which they are linearized.

    `first` are the indices of first points, `words` the meshes as in `Packed`, `kept` the arrays they point to.
    """

    model: ModelStructure
    words: NDArray[np.uint64]
    mesh: Mesh
    first: Indices
    states: Floats
    coefficients: Floats
    free: Bools
    kept: Sequence[object]

    def linearize(
        self, library: ctypes.CDLL, std: Floats, latent: LatentProcesses, model_error: float
    ) -> tuple[Floats, float]:
        """Return the factor of each object, and the sum of log-determinants, see `LinearizedObjects`."""
        meshes, model = self.words.copy(), ModelStructure.from_buffer_copy(self.model)
        arrays, std = {}, contiguous(std)
        if latent.width:
            steps = latent.along(self.mesh)
            arrays = {"latent_start": steps.start, "latent_end": steps.end, "anchors": steps.anchors}
            arrays = {name: contiguous(array) for name, array in arrays.items()}
            model.latent_std = address(deviations := contiguous(latent.std))
            model.latent_mean = address(mean := contiguous(latent.mean))
            model.walks = latent.walks
            assert len(deviations) == len(mean) == model.latent
        for name, array in {"std": std, **arrays}.items():
            meshes[:, FIELDS[name]] = address(array) + array.strides[0] * self.first
        pointers = np.full(len(meshes), ctypes.addressof(model), dtype=np.uint64)
        inside = (self.free, self.states, self.coefficients)
        factors, log_determinants = triangles(library, pointers, meshes, *inside, model_error)
        return factors, float(log_determinants.sum())


def batched(models: Sequence[TrajectoryModel], estimates: Sequence[Estimate], free: Bools) -> BatchedModel | None:
    """Return objects that are linearized in one call; None if the kernel does not apply."""
    structures = [structure for model in models if (structure := packed(model)) is not None]
    if len(structures) < len(models) or not all(
        len(model.meshes) == 1 and in_one_call(model, int(free.sum()) + 1) for model in models
    ):
        return None
    mesh = concatenated([model.meshes[0] for model in models])
    lengths = np.array([len(model.meshes[0]) for model in models])
    return BatchedModel(
        structures[0].model,
        np.concatenate([structure.words for structure in structures]),
        mesh,
        np.cumsum(lengths) - lengths,
        np.concatenate([estimate.states[0] for estimate in estimates]),
        np.array([estimate.coefficients for estimate in estimates]),
        np.ascontiguousarray(free, dtype=np.bool_),
        structures,
    )
