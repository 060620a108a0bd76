"""Linearisations of several objects in one call of the kernel, at one set of levels of errors after another."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.kernel import ModelStructure, address
from commonlaw.likelihood.compiled.packing import FIELDS, contiguous, packed
from commonlaw.likelihood.compiled.rows import in_one_call, triangles
from commonlaw.likelihood.fitting import Estimate, TrajectoryModel
from commonlaw.likelihood.latent import LatentProcesses
from commonlaw.likelihood.mesh import Mesh, joined


@dataclass(frozen=True, eq=False)
class Together:
    """Objects of one mesh each, and the estimates about which they are linearised.

    All points of one object stand behind those of another: on the `mesh` of all, and in `states`. Those of these
    indices are the `first` of their own meshes, which `words` tell as in `Packed`; `kept` is what these point into.
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
