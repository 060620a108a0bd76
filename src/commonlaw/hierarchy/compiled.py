"""What coefficients cost by their scatter over objects, by the compiled kernel."""

import ctypes

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.kernel import address

_NO_MEMORY = 1


def marginal_deviance(
    library: ctypes.CDLL, estimates: Floats, information: Floats, scale: Floats, grid: Floats, sweeps: int
) -> float:
    """Return what `commonlaw.hierarchy.marginal_deviance` returns, to rounding.

    Parameters
    ----------
    library
        The kernel.
    estimates, information
        As in `RandomEffects`.
    scale
        What variances of each coefficient are relative to, shape (k,); each is chosen again `sweeps` times.
    grid
        The relative variances that are tried.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the objects' information together is singular.
    """
    arrays = [np.ascontiguousarray(each, dtype=np.float64) for each in (estimates, information, scale, grid)]
    addresses, result = [address(each) for each in arrays], np.empty(1)
    failed = library.commonlaw_marginal_deviance(
        *estimates.shape, *addresses[:3], len(grid), addresses[3], sweeps, address(result)
    )
    if failed:
        raise MemoryError if failed == _NO_MEMORY else np.linalg.LinAlgError("Singular matrix")
    return float(result[0])
