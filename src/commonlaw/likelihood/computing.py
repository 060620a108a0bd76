"""Fits and linearisations: by the compiled kernel where there is one and it can, otherwise with NumPy."""

from collections.abc import Callable, Sequence
from ctypes import CDLL
from typing import TypeVar

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.kernel import kernel
from commonlaw.likelihood import fitting, linearization
from commonlaw.likelihood.compiled import fits, rows
from commonlaw.likelihood.compiled.packing import Packed, packed
from commonlaw.likelihood.fitting import Estimate, TrajectoryModel
from commonlaw.likelihood.linearization import Linearization
from commonlaw.parallel import in_parallel

_MANY = 50_000
"""Numbers in the rows of all terms from which threads pay: a linearisation then takes them some milliseconds."""

T = TypeVar("T")


def fit(
    model: TrajectoryModel, start: Estimate, support: Bools, model_errors: Sequence[float], steps: int = 12
) -> Estimate:
    """Return the estimate of largest likelihood, by Gauss-Newton steps, one model error after the other.

    Parameters
    ----------
    model
        Of one object.
    start
        Where to begin.
    support
        The coefficients that are free, shape (equations, terms); the others stay.
    model_errors
        Standard deviations of the model error in each step, relative to the noise, from large to small.
    steps
        At most so many for each model error.
    """
    compiled = _compiled(model)
    if compiled is None:
        return fitting.fit(model, start, support, model_errors, steps)
    library, structures = compiled
    return fits.fit(library, model, structures, start, support, model_errors, steps)


def linearize(
    model: TrajectoryModel, estimate: Estimate, model_error: float, columns: Bools | None = None
) -> Linearization:
    """Return the likelihood about an estimate.

    Parameters
    ----------
    model
        Of one object.
    estimate
        About which the law is linearised.
    model_error
        Standard deviation of the model error in each step, relative to the noise.
    columns
        Which coefficients are columns, shape (equations, terms); the others stay as they are. Default: all.

    Raises
    ------
    NotPositiveError
        If numbers are not finite, or too far apart.
    """
    compiled = _compiled(model)
    if compiled is None:
        return linearization.linearize(model, estimate, model_error, columns)
    free = np.ones(estimate.coefficients.shape, dtype=np.bool_) if columns is None else columns
    library, structures = compiled
    return rows.linearize(library, model, structures, estimate, model_error, free)


def fit_each(
    models: Sequence[TrajectoryModel], starts: Sequence[Estimate], support: Bools, model_errors: Sequence[float]
) -> tuple[Estimate, ...]:
    """Return the estimate of largest likelihood of each of several objects, see `fit`."""
    return tuple(_each(lambda model, start: fit(model, start, support, model_errors), models, starts))


def linearize_each(
    models: Sequence[TrajectoryModel], estimates: Sequence[Estimate], model_error: float
) -> list[Linearization]:
    """Return the likelihood of each of several objects about its estimate, see `linearize`."""
    return _each(lambda model, estimate: linearize(model, estimate, model_error), models, estimates)


def whitened(
    model: TrajectoryModel, estimate: Estimate, model_error: float, columns: Bools | None = None
) -> list[tuple[Floats, float]]:
    """Return the rows of each mesh, see `linearize`, from first to last sample, and its log-determinant.

    The targets are the innovations of the states: what each sample adds to those before it.

    Raises
    ------
    NotPositiveError
        If numbers are not finite, or too far apart.
    """
    compiled = _compiled(model)
    if compiled is None:
        return linearization.whitened(model, estimate, model_error, columns)
    free = np.ones_like(estimate.coefficients, dtype=np.bool_) if columns is None else columns
    library, structures = compiled
    return rows.whitened(library, model, structures, estimate, model_error, free)


def _each(
    function: Callable[[TrajectoryModel, Estimate], T], models: Sequence[TrajectoryModel], estimates: Sequence[Estimate]
) -> list[T]:
    return in_parallel(function, models, estimates, pays=threads_pay(models))


def threads_pay(models: Sequence[TrajectoryModel]) -> bool:
    """Whether the kernel has so much to do with these objects that threads are worth what they cost."""
    points = sum(len(mesh) for model in models for mesh in model.meshes)
    return points * models[0].equations * len(models[0].terms) > _MANY


def _compiled(model: TrajectoryModel) -> tuple[CDLL, Packed] | None:
    """Return the kernel and the structures of a model that it takes; None where NumPy is to be used."""
    library = kernel()
    structures = None if library is None else packed(model)
    return None if library is None or structures is None else (library, structures)
