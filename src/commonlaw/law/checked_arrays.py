"""The arrays of a law: read-only copies of the shape that it asks for."""

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError

_ASYMMETRY = 1e-6
"""Relative to the standard errors of both coefficients: more than rounding leaves of a symmetric matrix."""


def checked(
    values: ArrayLike, what: str, axes: str, shape: tuple[int, ...], low: float = -np.inf, high: float = np.inf
) -> Floats:
    """Return a read-only copy of an array of this shape, refusing values that are not between `low` and `high`."""
    array = np.array(values, dtype=np.float64)
    if array.shape != shape:
        raise CommonlawError("law-array-shape", array=what, shape=array.shape, axes=axes, expected=shape)
    if not np.all(np.isfinite(array)):
        raise CommonlawError("law-array-not-finite", array=what)
    if not np.all((low <= array) & (array <= high)):
        wrong = array[(array < low) | (array > high)][0]
        raise CommonlawError("law-array-range", array=what, value=wrong, low=low, high=high)
    array.flags.writeable = False
    return array


def checked_covariance(values: ArrayLike, objects: tuple[str, ...], parameters: int) -> Floats:
    """Return a read-only copy of the covariances of all objects' coefficients, symmetric to the last digit."""
    shape = (len(objects), parameters, parameters)
    matrices = checked(values, "covariance", "objects, coefficients in the law, the same", shape)
    variances = np.diagonal(matrices, axis1=1, axis2=2)
    negative = np.any(variances < 0, axis=1)
    if negative.any():
        name = objects[int(np.argmax(negative))]
        raise CommonlawError("law-variance-negative", name=name)
    errors, turned = np.sqrt(variances), matrices.transpose(0, 2, 1)
    uneven = np.abs(matrices - turned) > _ASYMMETRY * errors[:, :, np.newaxis] * errors[:, np.newaxis]
    if uneven.any():
        name = objects[int(np.argmax(uneven.any(axis=(1, 2))))]
        raise CommonlawError("law-covariance-asymmetric", name=name)
    symmetric = matrices / 2 + turned / 2  # The sum of the largest numbers is infinite
    symmetric.flags.writeable = False
    return symmetric
