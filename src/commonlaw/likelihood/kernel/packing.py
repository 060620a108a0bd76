"""Models and meshes as the kernel takes them: contiguous arrays and their addresses, made once for each."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Floats
from commonlaw.library.program import Program
from commonlaw.likelihood.fitting import TrajectoryModel
from commonlaw.likelihood.kernel.library import MeshStructure, ModelStructure, ProgramStructure
from commonlaw.likelihood.latent import LatentSteps
from commonlaw.likelihood.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Packed:
    """A model's structures; `kept` are the arrays that they point into."""

    model: ModelStructure
    meshes: Any
    kept: tuple[object, ...]


_MODELS: "WeakKeyDictionary[TrajectoryModel, Packed | None]" = WeakKeyDictionary()


def packed(model: TrajectoryModel) -> Packed | None:
    """Return the structures of a model, None if it has what the kernel does not do."""
    if model not in _MODELS:
        program = model.terms.program
        logarithmic = bool(model.terms.variables.logarithmic)
        suits = model.order == 1 or (model.order == 2 and not logarithmic)
        _MODELS[model] = _packed(model, program) if program is not None and suits else None
    return _MODELS[model]


def address(array: NDArray[Any]) -> int:
    """Return where an array's numbers begin."""
    return int(array.__array_interface__["data"][0])


def _packed(model: TrajectoryModel, program: Program) -> Packed:
    meshes = [
        _mesh(mesh, model.observation.noise, steps)
        for mesh, steps in zip(model.meshes, model.latent_steps, strict=True)
    ]
    unit, logarithmic = _floats(model.unit), np.zeros(model.width, dtype=np.uint8)
    logarithmic[list(model.terms.variables.columns(model.terms.variables.logarithmic))] = 1
    force = next((each.force for each in model.latent_steps if each is not None), None)
    structure = ModelStructure(
        model.equations,
        model.order,
        model.meshes[0].inputs.shape[1],
        model.latent.width,
        any(each.held for each in model.meshes),
        model.latent.correlated is not None,
        -1 if force is None else force,
        float(model.observation.huber_threshold),
        address(unit),
        address(logarithmic),
        _program(program),
    )
    return Packed(
        structure, (MeshStructure * len(meshes))(*(own for own, _ in meshes)), (unit, logarithmic, program, meshes)
    )


def _program(program: Program) -> ProgramStructure:
    counts = (program.variables, len(program.constants), len(program.code), len(program.outputs))
    return ProgramStructure(*counts, address(program.constants), address(program.code), address(program.outputs))


def _mesh(mesh: Mesh, noise: Floats, latent: LatentSteps | None) -> tuple[MeshStructure, Sequence[NDArray[Any]]]:
    """Return the structure of a mesh, and the arrays that it points into."""
    middle = (mesh.inputs[:-1] + mesh.inputs[1:]) / 2 if mesh.middle is None else mesh.middle
    nothing = np.zeros(0)
    hidden = (nothing,) * 3 if latent is None else (latent.start, latent.end, latent.anchors)
    arrays = [
        mesh.times,
        (mesh.times[:-1] + mesh.times[1:]) / 2,
        mesh.steps,
        mesh.relative_steps,
        mesh.measured,
        np.broadcast_to(noise * mesh.scale, mesh.measured.shape),
        mesh.inputs,
        middle,
        *hidden,
    ]
    kept: list[NDArray[Any]] = [_floats(each) for each in arrays]
    kept.append(np.ascontiguousarray(mesh.contiguous, dtype=np.uint8))
    return MeshStructure(len(mesh), *(address(each) for each in kept)), kept


def _floats(values: Floats) -> Floats:
    return np.ascontiguousarray(values, dtype=np.float64)
