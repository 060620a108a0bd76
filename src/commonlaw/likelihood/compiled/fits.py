"""Fits by the kernel."""

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.kernel import LEAST_NORM, address
from commonlaw.likelihood.compiled.packing import Packed, addresses
from commonlaw.likelihood.fitting import GAIN, SHORTEST, Estimate, TrajectoryModel, least_norm


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
