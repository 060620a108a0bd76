"""Fits by the kernel."""

import ctypes
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.kernel import LEAST_NORM, address
from commonlaw.likelihood.compiled.packing import Packed
from commonlaw.likelihood.fitting import GAIN, SHORTEST, Estimate, TrajectoryModel, least_norm


def fit(
    library: ctypes.CDLL,
    model: TrajectoryModel,
    packed: Packed,
    start: Estimate,
    support: Bools,
    model_errors: Sequence[float],
    steps: int,
) -> Estimate:
    """Return what `commonlaw.likelihood.fitting.fit` returns, to rounding."""
    if not len(model_errors):
        return start
    lengths = [len(each) for each in model.meshes]
    width = model.width + model.latent.width
    states = np.array(start.states[0], dtype=np.float64) if len(lengths) == 1 else np.concatenate(start.states)
    if states.shape != (sum(lengths), width) or start.coefficients.shape != (model.equations, len(model.terms)):
        raise ValueError("states or coefficients do not have the shapes of the model")
    coefficients = np.array(start.coefficients, dtype=np.float64, order="C")
    free, errors, reached = np.ascontiguousarray(support, dtype=np.bool_), np.array(model_errors, float), np.empty(2)
    failed = library.commonlaw_fit(
        *(packed.model, packed.meshes, len(lengths)),
        *(address(free), address(errors), len(errors), steps, GAIN, SHORTEST, _LEAST_NORM),
        *(address(states), address(coefficients), address(reached)),
    )
    if failed:
        raise MemoryError
    parts = (states,) if len(lengths) == 1 else tuple(np.split(states, np.cumsum(lengths)[:-1]))
    return replace(
        start, states=parts, coefficients=coefficients, deviance=float(reached[0]), objective=float(reached[1])
    )


def _least_norm(count: int, matrix: Any, right: Any, solution: Any) -> int:
    """Fill the solution of least norm of a symmetric system; return whether there is one."""
    as_array = np.ctypeslib.as_array
    try:
        as_array(solution, (count,))[:] = least_norm(as_array(matrix, (count, count)), as_array(right, (count,)))
    except np.linalg.LinAlgError:
        return 0
    return 1


_LEAST_NORM = LEAST_NORM(_least_norm)
