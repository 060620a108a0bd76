"""Fits and linearizations by the compiled kernel, or with NumPy where it does not apply."""

from collections.abc import Sequence
from ctypes import CDLL
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.kernel import kernel
from commonlaw.likelihood import compiled, fitting, linearization
from commonlaw.likelihood.compiled import BatchedModel, Packed, batched, packed
from commonlaw.likelihood.fitting import Estimate, TrajectoryModel
from commonlaw.likelihood.linearization import Linearization
from commonlaw.likelihood.observation_model import LatentProcesses
from commonlaw.runtime.checkpoint import checkpointed
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.parallel import in_parallel
from commonlaw.runtime.time_limit import check


def fit(
    model: TrajectoryModel, start: Estimate, support: Bools, model_errors: Sequence[float], steps: int = 12
) -> Estimate:
    """Return the maximum-likelihood estimate by Gauss-Newton steps, with continuation in the model error.

    Free coefficients are those of `support`, shape (equations, terms). Model errors are standard deviations in each
    step, relative to the noise, from large to small; each has at most `steps` iterations.
    """
    return fit_each([model], [start], support, model_errors, steps)[0]


def linearize(
    model: TrajectoryModel, estimate: Estimate, model_error: float, columns: Bools | None = None
) -> Linearization:
    """Return the likelihood, linearized about an estimate, at a model error relative to the noise.

    Columns are the coefficients in `columns`, shape (equations, terms), by default all. Raises `NotPositiveError` if
    numbers are not finite, or too far apart.
    """
    return linearize_each([model], [estimate], model_error, columns)[0]


@checkpointed
def fit_each(
    models: Sequence[TrajectoryModel],
    starts: Sequence[Estimate],
    support: Bools,
    model_errors: Sequence[float],
    steps: int = 12,
) -> tuple[Estimate, ...]:
    """Return the estimate of largest likelihood of each of several objects, see `fit`."""
    check()
    if len(models) > 1 and threads_are_worthwhile(models):
        return tuple(in_parallel(lambda model, start: fit(model, start, support, model_errors, steps), models, starts))
    prepared = _compiled(models)
    if prepared is not None:
        return tuple(compiled.fit_each(prepared[0], models, prepared[1], starts, support, model_errors, steps))
    pairs = zip(models, starts, strict=True)
    return tuple(fitting.fit(model, start, support, model_errors, steps) for model, start in pairs)


def linearize_each(
    models: Sequence[TrajectoryModel],
    estimates: Sequence[Estimate],
    model_error: float,
    columns: Bools | None = None,
) -> list[Linearization]:
    """Return the linearized likelihood of each of several objects, see `linearize`."""
    check()
    if len(models) > 1 and threads_are_worthwhile(models):
        return in_parallel(lambda model, estimate: linearize(model, estimate, model_error, columns), models, estimates)
    prepared = _compiled(models)
    if prepared is not None:
        free = _free(estimates[0], columns)
        return compiled.linearize_each(prepared[0], models, prepared[1], estimates, model_error, free)
    pairs = zip(models, estimates, strict=True)
    return [linearization.linearize(model, estimate, model_error, columns) for model, estimate in pairs]


def whitened(
    model: TrajectoryModel, estimate: Estimate, model_error: float, columns: Bools | None = None
) -> list[tuple[Floats, float]]:
    """Return the whitened rows of each mesh, see `linearize`, and its log-determinant.

    Rows are in the order of time; their targets are the innovations of the states.
    """
    prepared = _compiled([model])
    if prepared is None:
        return linearization.whitened(model, estimate, model_error, columns)
    library, (structures,) = prepared
    return compiled.whitened(library, model, structures, estimate, model_error, _free(estimate, columns))


def sensitivities(model: TrajectoryModel, index: int, estimate: Estimate, free: Bools, wanted: Bools) -> Floats:
    """Return how states at the wanted points of one mesh change, shape (points, D, D + p).

    The first columns are the derivatives by the state at the first point of their segment, the others by the p free
    coefficients, those of solutions of the law without any force.
    """
    prepared, steps = _compiled([model]), model.latent_steps[index]
    if prepared is None or (steps is not None and steps.force is not None):
        mesh, states = model.meshes[index], estimate.states[index]
        return linearization.sensitivities(model, mesh, states, estimate.coefficients, free, wanted)
    return compiled.sensitivities(prepared[0], model, prepared[1][0], index, estimate, free, wanted)


def threads_are_worthwhile(models: Sequence[TrajectoryModel]) -> bool:
    """Return whether one linearization of these objects takes milliseconds, so that threads pay off."""
    points = sum(len(mesh) for model in models for mesh in model.meshes)
    return points * models[0].equations * len(models[0].terms) > 50_000


def _free(estimate: Estimate, columns: Bools | None) -> Bools:
    return np.ones(estimate.coefficients.shape, dtype=np.bool_) if columns is None else columns


def _compiled(models: Sequence[TrajectoryModel]) -> tuple[CDLL, list[Packed]] | None:
    """Return the kernel and the structures of models; None if it does not apply."""
    library = kernel()
    if library is None:
        return None
    structures = [structure for model in models if (structure := packed(model)) is not None]
    return (library, structures) if len(structures) == len(models) else None


@dataclass(frozen=True, eq=False)
class LinearizedObjects:
    """Several objects with the estimates about which they are linearized, and columns as in `linearize`."""

    models: Sequence[TrajectoryModel]
    estimates: Sequence[Estimate]
    columns: Bools

    def linearize(self, std: Floats, latent: LatentProcesses, model_error: float) -> tuple[Floats, float]:
        """Return triangular factors at levels of errors, (objects, columns + 1, columns + 1), and the log-determinant.

        The standard deviations of white noise have shape (points, d), over all meshes; the model error is relative to
        the models' units. Raises `NotPositiveError` if numbers are not finite, or too far apart.
        """
        check()
        library = kernel()
        if library is not None and self._batch is not None:
            return self._batch.linearize(library, std, latent, model_error)
        cuts = np.cumsum([sum(map(len, model.meshes)) for model in self.models])[:-1]
        linear = list[Linearization]()
        for model, stds, estimate in zip(self.models, np.split(std, cuts), self.estimates, strict=True):
            parts = np.split(stds, np.cumsum([len(mesh) for mesh in model.meshes])[:-1])
            pairs = zip(model.meshes, parts, strict=True)
            meshes = [mesh.with_scale(sigma / model.observation.noise) for mesh, sigma in pairs]
            changed = replace(model, meshes=meshes, latent=latent)
            linear.append(linearize(changed, estimate, model_error, self.columns))
        return np.array([row.problem.factor for row in linear]), sum(row.log_determinant for row in linear)

    @cached_property
    def _batch(self) -> BatchedModel | None:
        return batched(self.models, self.estimates, self.columns)
