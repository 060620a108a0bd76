"""The compiled kernel: what is computed most often, in C where it was built; its callers have the same in NumPy."""

from commonlaw.kernel.library import (
    LEAST_NORM,
    VARIABLE,
    MeasuredStructure,
    MeshStructure,
    ModelStructure,
    ProgramStructure,
    Vagueness,
    address,
    kernel,
)

__all__ = [
    "LEAST_NORM",
    "VARIABLE",
    "MeasuredStructure",
    "MeshStructure",
    "ModelStructure",
    "ProgramStructure",
    "Vagueness",
    "address",
    "kernel",
]
