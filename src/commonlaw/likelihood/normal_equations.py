"""One Gauss-Newton step for all states and coefficients of an object together.

The normal equations are block tridiagonal in the states, one block for each point, with a border for the coefficients.
The states are eliminated by a banded Cholesky factorisation, in time proportional to the number of points; what is
left is the information on the coefficients (a Schur complement).
"""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.likelihood.collocation import Slopes

_LIFTS = (0.0, 1e-13, 1e-11, 1e-9, 1e-7)
"""By which share of itself the diagonal is lifted until the factorisation succeeds despite rounding."""


class NotPositiveError(ArithmeticError):
    """Numbers overflowed, or were too far apart for the factorisation."""


@dataclass(frozen=True, eq=False)
class Reduced:
    """The normal equations of one mesh after the states were eliminated.

    Parameters
    ----------
    information
        Of the coefficients, shape (parameters, parameters).
    gradient
        Half the gradient of twice the negative log-likelihood by the coefficients, with the states following, shape
        (parameters,).
    shift
        Step of the states where the coefficients stay, shape (n, D).
    follow
        How the states follow the coefficients, shape (n, D, parameters).
    """

    information: Floats
    gradient: Floats
    shift: Floats
    follow: Floats


def reduce(slopes: Slopes, stiffness: Floats, weights: Floats, gaps: Floats) -> Reduced:
    """Return the normal equations of one mesh without the states.

    Parameters
    ----------
    slopes
        Defects and their derivatives.
    stiffness
        What each squared defect counts, shape (n - 1, D).
    weights
        What each squared gap counts, shape (n, d).
    gaps
        Measured less sought states, shape (n, d); anything where the weight is zero.

    Raises
    ------
    NotPositiveError
        If numbers are not finite, or too far apart.
    """
    from scipy.linalg import cho_solve_banded

    points, width = len(weights), slopes.defects.shape[1]
    before, after = slopes.before.transpose(0, 2, 1), slopes.after.transpose(0, 2, 1)
    pulled = slopes.defects * stiffness
    bands = _bands(slopes, stiffness, weights)
    gradient = np.zeros((points, width))
    gradient[:, : weights.shape[1]] = np.where(weights > 0, -gaps * weights, 0.0)
    gradient[:-1] += np.matmul(before, pulled[:, :, np.newaxis])[:, :, 0]
    gradient[1:] += np.matmul(after, pulled[:, :, np.newaxis])[:, :, 0]
    own = slopes.parameters
    count = own.shape[2]
    scaled = own * stiffness[:, :, np.newaxis]
    border = np.zeros((points, width, count))
    border[:-1] += np.matmul(before, scaled)
    border[1:] += np.matmul(after, scaled)
    flat, flat_scaled = own.reshape(pulled.size, count), scaled.reshape(pulled.size, count)
    beside = border.reshape(gradient.size, count)
    right = np.column_stack([beside, gradient.ravel()])
    if not np.isfinite(right).all():
        raise NotPositiveError
    solved = cho_solve_banded((_factor(bands), False), right, check_finite=False)
    information = flat.T @ flat_scaled - beside.T @ solved[:, :count]
    left = flat.T @ pulled.ravel() - beside.T @ solved[:, count]
    if not (np.isfinite(information).all() and np.isfinite(left).all()):
        raise NotPositiveError
    return Reduced(
        (information + information.T) / 2,
        left,
        -solved[:, count].reshape(points, width),
        -solved[:, :count].reshape(points, width, count),
    )


def _bands(slopes: Slopes, stiffness: Floats, weights: Floats) -> Floats:
    """Return the matrix of the states by its upper bands, in LAPACK's layout, shape (2 D, n D)."""
    points, width = len(weights), stiffness.shape[1]
    before = slopes.before.transpose(0, 2, 1) * stiffness[:, np.newaxis]
    after = slopes.after.transpose(0, 2, 1) * stiffness[:, np.newaxis]
    diagonal = np.zeros((points, width, width))
    measured = range(weights.shape[1])
    diagonal[:, measured, measured] = weights
    diagonal[:-1] += np.matmul(before, slopes.before)
    diagonal[1:] += np.matmul(after, slopes.after)
    beside = np.matmul(before, slopes.after)
    bands = np.zeros((2 * width, points * width))
    for i in range(width):
        for j in range(width):
            if j >= i:
                bands[2 * width - 1 + i - j, j::width] = diagonal[:, i, j]
            bands[width - 1 + i - j, width + j :: width] = beside[:, i, j]
    return bands


def _factor(bands: Floats) -> Floats:
    from scipy.linalg import cholesky_banded

    if np.isfinite(bands).all():
        for lift in _LIFTS:
            lifted = bands.copy()
            lifted[-1] *= 1 + lift
            try:
                return np.asarray(cholesky_banded(lifted, check_finite=False))
            except np.linalg.LinAlgError:
                continue
    raise NotPositiveError
