"""The compiled kernel: what is computed most often, in C where it was built; its callers have the same in NumPy."""

import ctypes
import os
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from commonlaw.errors import CommonlawError

VARIABLE = "COMMONLAW_KERNEL"
"""Environment variable: ``numpy`` or ``compiled`` chooses; otherwise the kernel is used where there is one."""

CONSTANTS: Mapping[str, tuple[float, ...]] = {
    name: tuple(map(float, values.split(",")))
    for name, values in re.findall(
        r"^#define (\w+) ([-\d.e, ]+)$", (Path(__file__).parent / "constants.h").read_text("utf-8"), re.MULTILINE
    )
}
"""The numbers of ``constants.h``, by which the kernel and NumPy compute the same."""

_FILES = ("kernel.so", "kernel.dll")

LEAST_NORM = ctypes.CFUNCTYPE(
    ctypes.c_int, ctypes.c_int64, *[ctypes.POINTER(ctypes.c_double)] * 3
)  # p, matrix, right-hand side, solution
_NUMBER, _ADDRESS = ctypes.c_int64, ctypes.c_void_p


class ProgramStructure(ctypes.Structure):
    """A `Program`."""

    _fields_ = (
        *((name, _NUMBER) for name in ("variables", "constants", "operations", "terms")),
        *((name, _ADDRESS) for name in ("values", "code", "outputs")),
    )


class ModelStructure(ctypes.Structure):
    """What is the same for all meshes of an object."""

    _fields_ = (
        *(
            (name, _NUMBER)
            for name in (
                *("equations", "rates", "inputs", "latent", "held", "correlated", "walks", "drift"),
                *("rejects", "force", "inside"),
            )
        ),
        ("huber_threshold", ctypes.c_double),
        *((name, _ADDRESS) for name in ("unit", "latent_std", "latent_mean", "logarithmic")),
        *((name, _ADDRESS) for name in ("inside_term", "second", "highest")),
        *((name, _ADDRESS) for name in ("typical", "precision")),
        ("program", ProgramStructure),
    )


class MeshStructure(ctypes.Structure):
    """One mesh."""

    _fields_ = (
        ("points", _NUMBER),
        ("typical_step", ctypes.c_double),
        *((name, _ADDRESS) for name in ("times", "middle_times", "steps", "walk")),
        *((name, _ADDRESS) for name in ("measured", "inputs", "middle_inputs", "contiguous", "std")),
        *((name, _ADDRESS) for name in ("latent_start", "latent_end", "anchors")),
    )


class Vagueness(ctypes.Structure):
    """Standard deviations of what was not measured: of states, rates and latent processes, in their units."""

    _fields_ = (("missing", ctypes.c_double), ("rate", ctypes.c_double), ("hidden", ctypes.c_double))


class MeasuredStructure(ctypes.Structure):
    """How surely measurements tell the scale of all noise, see `commonlaw.inference.score.evidence.Measured`."""

    _fields_ = tuple((name, ctypes.c_double) for name in ("count", "freedom", "prior", "outliers", "least"))


_STRUCTURES = (ProgramStructure, ModelStructure, MeshStructure, MeasuredStructure)


def kernel() -> ctypes.CDLL | None:
    """Return the kernel, None where NumPy is to be used.

    Raises
    ------
    CommonlawError
        If the environment demands a kernel and there is none, or something else than ``numpy`` or ``compiled``.
    """
    chosen = os.environ.get(VARIABLE, "")
    if chosen == "numpy":
        return None
    if chosen not in ("", "compiled"):
        raise CommonlawError("kernel-unknown", variable=VARIABLE, chosen=chosen)
    result = _loaded()
    if result is None and chosen:
        raise CommonlawError("kernel-missing", variable=VARIABLE, chosen=chosen)
    return result


def address(array: NDArray[Any]) -> int:
    """Return where a contiguous array's numbers begin."""
    return int(array.__array_interface__["data"][0])


@cache
def _loaded() -> ctypes.CDLL | None:
    """Return the library next to this file, if there is one that has the same structures."""
    folder = Path(__file__).parent
    for path in (folder / name for name in _FILES):
        if not path.exists():
            continue
        try:
            library = ctypes.CDLL(str(path))
            sizes = (ctypes.c_int64 * len(_STRUCTURES))()
            library.commonlaw_sizes(sizes)
        except (OSError, AttributeError):  # Made for another platform, or by another version
            continue
        if list(sizes) == [ctypes.sizeof(structure) for structure in _STRUCTURES]:
            library.commonlaw_sources.restype = ctypes.c_char_p
            return _declared(library)
    return None


def _declared(library: ctypes.CDLL) -> ctypes.CDLL:
    """Return the library with the types of its functions' arguments."""
    number, address, real = _NUMBER, _ADDRESS, ctypes.c_double
    library.commonlaw_fit.argtypes = (
        *(address, number, address, address),  # models, how many, meshes, how many of each
        *(address, address, number, number, real, real, LEAST_NORM),  # free, errors, levels, steps, gain, shortest
        *(address, address, address),  # states, coefficients, deviance and objective
    )
    library.commonlaw_jacobians.argtypes = (
        *(ctypes.POINTER(ModelStructure), ctypes.POINTER(MeshStructure)),
        *(address, address, address),  # free, states, coefficients
        *(address, address, address, address),  # defects, start, end, coefficients
    )
    library.commonlaw_sensitivities.argtypes = (
        *(ctypes.POINTER(ModelStructure), ctypes.POINTER(MeshStructure)),
        *(address, address, address),  # free, states, coefficients
        *(address, address),  # wanted, sensitivities
    )
    library.commonlaw_whiten.argtypes = (
        *(ctypes.POINTER(ModelStructure), ctypes.POINTER(MeshStructure), address, real),  # states, model error
        *(Vagueness, address, address),  # what was not measured; start, end
        *(address, number, address),  # rows, columns, log-determinant
    )
    library.commonlaw_linearize.argtypes = (
        *(address, address, number),  # models, meshes, how many
        *(address, address, address, real, Vagueness),  # free, states, coefficients of each, model error
        *(address, address),  # factors, log-determinants
    )
    library.commonlaw_evidence.argtypes = (
        *(number, number, address, number, address, number),  # objects, terms, factors, the support's, common ones
        *(MeasuredStructure, real, real),  # measured, needed, worst condition
        *(number, address, number, address),  # relative variances, sweeps, result
    )
    library.commonlaw_shoot.argtypes = (
        *(ctypes.POINTER(ProgramStructure), number, number, number, address),  # states, inputs, parameters
        *(number, address),  # times
        *(number, number, number, address, address, address, address),  # pieces, powers, inputs; these, columns, delays
        *(real, address, number, address, address),  # relative, absolute, steps, states, derivatives
    )
    library.commonlaw_shoot.restype = number
    return library
