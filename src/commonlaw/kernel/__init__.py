"""The compiled kernel: what is computed most often, in C where it was built; its callers have the same in NumPy."""

from commonlaw.kernel.library import (
    CONSTANTS,
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
    "CONSTANTS",
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
