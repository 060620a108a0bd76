"""Linearisations of several objects in one call of the kernel, at one set of levels of errors after another."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.kernel import MeshStructure, ModelStructure, address
from commonlaw.likelihood.compiled.packing import contiguous, packed
from commonlaw.likelihood.compiled.rows import VAGUENESS, check, in_one_call
from commonlaw.likelihood.fitting import Estimate, TrajectoryModel
from commonlaw.likelihood.latent import LatentProcesses
from commonlaw.likelihood.mesh import Mesh, joined


@dataclass(frozen=True, eq=False)
class Together:
    """Objects of one mesh each, and the estimates about which they are linearised.

    All points of one object stand behind those of another: on the `mesh` of all, and in `states`. The structures of
    their own meshes begin there with the points of these indices, `first`; `kept` are the arrays that they point into.
    """

    model: ModelStructure
    meshes: NDArray[np.void]
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
        meshes, model = self.meshes.copy(), ModelStructure.from_buffer_copy(self.model)
        arrays, std = {}, contiguous(std)
        if latent.width:
            steps = latent.along(self.mesh)
            arrays = {name: contiguous(getattr(steps, own)) for name, own in _LATENT.items()}
            model.latent_std = address(deviations := contiguous(steps.std))
            assert len(deviations) == model.latent
        for name, array in {"std": std, **arrays}.items():
            meshes[name] = address(array) + array.strides[0] * self.first
        size = int(self.free.sum()) + 1
        factors, log_determinants = np.empty((len(meshes), size, size)), np.empty(len(meshes))
        inside = (address(each) for each in (self.free, self.states, self.coefficients))
        check(
            library.commonlaw_linearize(
                *(model, address(meshes), len(meshes), *inside, model_error, VAGUENESS),
                *(address(factors), address(log_determinants)),
            )
        )
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
    meshes = np.concatenate([np.frombuffer(each.meshes, dtype=np.dtype(MeshStructure)) for each in structures])
    return Together(
        structures[0].model,
        meshes,
        mesh,
        np.cumsum(lengths) - lengths,
        np.concatenate([each.states[0] for each in estimates]),
        np.array([each.coefficients for each in estimates]),
        np.ascontiguousarray(free, dtype=np.bool_),
        structures,
    )
