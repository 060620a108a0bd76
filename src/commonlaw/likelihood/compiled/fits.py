"""Fits of objects by the kernel, one by one or several together."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.kernel import LEAST_NORM, ModelStructure, address
from commonlaw.likelihood.compiled.packing import FIELDS, Packed, addresses, contiguous, packed
from commonlaw.likelihood.compiled.rows import in_one_call, triangles
from commonlaw.likelihood.fitting import GAIN, SHORTEST, Estimate, TrajectoryModel, least_norm
from commonlaw.likelihood.mesh import Mesh, joined
from commonlaw.likelihood.observation_model import LatentProcesses


def fit_each(
    library: ctypes.CDLL,
    models: Sequence[TrajectoryModel],
    structures: Sequence[Packed],
    starts: Sequence[Estimate],
    support: Bools,
    model_errors: Sequence[float],
    steps: int,
) -> list[Estimate]:
    """Return what `commonlaw.likelihood.fitting.fit` returns of each object, to rounding."""
    if not len(model_errors):
        return list(starts)
    shapes = [(sum(map(len, model.meshes)), model.width + model.latent.width) for model in models]
    states = [np.concatenate(start.states, dtype=np.float64) for start in starts]
    of_law = (models[0].equations, len(models[0].terms))
    if [each.shape for each in states] != shapes or any(start.coefficients.shape != of_law for start in starts):
        raise ValueError("states or coefficients do not have the shapes of the model")
    whole, coefficients = np.concatenate(states), np.array([start.coefficients for start in starts], dtype=np.float64)
    counts = np.array([len(model.meshes) for model in models], dtype=np.int64)
    own, meshes = addresses(structures), np.concatenate([each.words for each in structures])
    free, errors = np.ascontiguousarray(support, dtype=np.bool_), np.array(model_errors, float)
    reached = np.empty((len(models), 2))
    failed = library.commonlaw_fit(
        *(address(own), len(models), address(meshes), address(counts)),
        *(address(free), address(errors), len(errors), steps, GAIN, SHORTEST, _LEAST_NORM),
        *(address(whole), address(coefficients), address(reached)),
    )
    if failed:
        raise MemoryError
    lengths = [len(mesh) for model in models for mesh in model.meshes]
    parts = iter(np.split(whole, np.cumsum(lengths)[:-1]))
    return [
        Estimate(tuple(next(parts) for _ in model.meshes), found, *of_fit)
        for model, found, of_fit in zip(models, coefficients, reached.tolist(), strict=True)
    ]


def _least_norm(count: int, matrix: Any, right: Any, solution: Any) -> int:
    """Fill the solution of least norm of a symmetric system; return whether there is one."""
    as_array = np.ctypeslib.as_array
    try:
        as_array(solution, (count,))[:] = least_norm(as_array(matrix, (count, count)), as_array(right, (count,)))
    except np.linalg.LinAlgError:
        return 0
    return 1


_LEAST_NORM = LEAST_NORM(_least_norm)


@dataclass(frozen=True, eq=False)
class Together:
    """Objects of one mesh each, one behind the other, and the estimates about which they are linearized.

    `first` are the indices of first points, `words` the meshes as in `Packed`, `kept` what they point into.
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
        """Return the factor of each object's rows, and the sum of log-determinants, see `AboutEstimates`."""
        meshes, model = self.words.copy(), ModelStructure.from_buffer_copy(self.model)
        arrays, std = {}, contiguous(std)
        if latent.width:
            steps = latent.along(self.mesh)
            arrays = {name: contiguous(getattr(steps, own)) for name, own in _LATENT.items()}
            model.latent_std = address(deviations := contiguous(steps.std))
            assert len(deviations) == model.latent
        for name, array in {"std": std, **arrays}.items():
            meshes[:, FIELDS[name]] = address(array) + array.strides[0] * self.first
        own = np.full(len(meshes), ctypes.addressof(model), dtype=np.uint64)
        inside = (self.free, self.states, self.coefficients)
        factors, log_determinants = triangles(library, own, meshes, *inside, model_error)
        return factors, float(log_determinants.sum())


_LATENT = {"latent_start": "start", "latent_end": "end", "anchors": "anchors"}


def together(models: Sequence[TrajectoryModel], estimates: Sequence[Estimate], free: Bools) -> Together | None:
    """Return objects that are linearised together; None if they have what is better done one by one."""
    structures = [each for model in models if (each := packed(model)) is not None]
    if len(structures) < len(models) or not all(
        len(model.meshes) == 1 and in_one_call(model, int(free.sum()) + 1) for model in models
    ):
        return None
    mesh = joined([model.meshes[0] for model in models])
    lengths = np.array([len(model.meshes[0]) for model in models])
    return Together(
        structures[0].model,
        np.concatenate([each.words for each in structures]),
        mesh,
        np.cumsum(lengths) - lengths,
        np.concatenate([each.states[0] for each in estimates]),
        np.array([each.coefficients for each in estimates]),
        np.ascontiguousarray(free, dtype=np.bool_),
        structures,
    )
