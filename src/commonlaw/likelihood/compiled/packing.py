"""Models and meshes as the kernel takes them: contiguous arrays and their addresses, made once for each."""

from collections.abc import Sequence
from ctypes import addressof
from dataclasses import dataclass
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Floats
from commonlaw.kernel import MeshStructure, ModelStructure, ProgramStructure, address
from commonlaw.library import highest_columns, with_rates
from commonlaw.library.program import Program
from commonlaw.likelihood.fitting import TrajectoryModel
from commonlaw.likelihood.mesh import Grid, Mesh
from commonlaw.likelihood.observation_model import LatentSteps


@dataclass(frozen=True, eq=False)
class Packed:
    """A model's structures, and the arrays that they point into; meshes also as 8-byte words, shape (meshes,
    `FIELDS`).
    """

    model: ModelStructure
    meshes: Any
    words: NDArray[np.uint64]
    kept: tuple[object, ...]


FIELDS = {name: getattr(MeshStructure, name).offset // 8 for name, *_ in MeshStructure._fields_}


def addresses(structures: Sequence[Packed], counts: Sequence[int] | None = None) -> NDArray[np.uint64]:
    """Return where models are, each as often as counts say."""
    found = np.array([addressof(each.model) for each in structures], dtype=np.uint64)
    return found if counts is None else np.repeat(found, counts)


_MODELS: "WeakKeyDictionary[TrajectoryModel, Packed | None]" = WeakKeyDictionary()


def packed(model: TrajectoryModel) -> Packed | None:
    """Return the structures of a model, None if it has what the kernel does not do."""
    if model not in _MODELS:
        suits = model.order == 1 or not model.terms.variables.logarithmic
        _MODELS[model] = _packed(model) if suits else None
    return _MODELS[model]


def _packed(model: TrajectoryModel) -> Packed:
    program = model.terms.program
    noise = model.observation.noise
    meshes = [_mesh(mesh, noise, steps) for mesh, steps in zip(model.meshes, model.latent_steps, strict=True)]
    unit, logarithmic = contiguous(model.unit), np.zeros(model.width, dtype=np.uint8)
    second, highest = (of(model.order, model.equations).astype(np.int64) for of in (with_rates, highest_columns))
    logarithmic[list(model.terms.variables.logarithmic_columns)] = 1
    inside = np.array(model.terms.constants, dtype=np.int64)
    prior = (None, None) if model.prior is None else tuple(map(contiguous, model.prior))
    latent = model.latent_steps[0]
    std = np.zeros(0) if latent is None else contiguous(latent.std)
    structure = ModelStructure(
        model.equations,
        len(second),
        model.meshes[0].inputs.shape[1],
        model.latent.width,
        any(each.held for each in model.meshes),
        model.latent.correlated is not None,
        -1 if latent is None or latent.force is None else latent.force,
        len(inside),
        float(model.observation.huber_threshold),
        address(unit),
        address(std),
        address(logarithmic),
        address(inside),
        address(second),
        address(highest),
        *(address(each) if each is not None else 0 for each in prior),
        _program(program),
    )
    kept = (unit, std, logarithmic, inside, second, highest, prior, program, meshes)
    structures = (MeshStructure * len(meshes))(*(own for own, _ in meshes))
    return Packed(
        structure, structures, np.frombuffer(memoryview(structures), np.uint64).reshape(len(meshes), -1), kept
    )


_PROGRAMS: "WeakKeyDictionary[Program, ProgramStructure]" = WeakKeyDictionary()


def _program(program: Program) -> ProgramStructure:
    if program not in _PROGRAMS:
        counts = (program.variables, len(program.constants), len(program.code), len(program.outputs))
        arrays = (program.constants, program.code, program.outputs)
        _PROGRAMS[program] = ProgramStructure(*counts, *map(address, arrays))
    return _PROGRAMS[program]


_GRIDS: "WeakKeyDictionary[Grid, tuple[int, ...]]" = WeakKeyDictionary()
"""Addresses of arrays; those that a grid would carry itself would be wrong in another process."""


def _mesh(mesh: Mesh, noise: Floats, latent: LatentSteps | None) -> tuple[MeshStructure, object]:
    """Return the structure of a mesh, and what it points into."""
    grid = mesh.grid
    if grid not in _GRIDS:
        _GRIDS[grid] = (*map(address, grid.arrays), address(grid.contiguous))
    std = contiguous(np.broadcast_to(noise * mesh.scale, mesh.measured.shape))
    hidden = () if latent is None else tuple(map(contiguous, (latent.start, latent.end, latent.anchors)))
    addresses = tuple(map(address, hidden)) or (0, 0, 0)
    return MeshStructure(len(mesh), mesh.typical_step, *_GRIDS[grid], address(std), *addresses), (grid, std, hidden)


def contiguous(values: Floats) -> Floats:
    return np.ascontiguousarray(values, dtype=np.float64)
