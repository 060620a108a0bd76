"""One Gauss-Newton step for all states and coefficients of an object together.

The normal equations are block tridiagonal in the states, one block for each point, with a border for the coefficients.
The states are eliminated by a banded Cholesky factorisation, in time proportional to the number of points; what is
left is the information on the coefficients (a Schur complement).
"""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.likelihood.collocation import Jacobians

_LIFTS = (0.0, 1e-13, 1e-11, 1e-9, 1e-7)
"""By which share of itself the diagonal is lifted until the factorisation succeeds despite rounding."""


class NotPositiveError(CommonlawError, ArithmeticError):
    """Numbers overflowed, or were too far apart for the factorisation."""

    def __init__(self, code: str = "likelihood-not-computable", /, where: str = "", **parameters: object) -> None:
        super().__init__(code, where, **parameters)


@dataclass(frozen=True, eq=False)
class SchurComplement:
    """The normal equations of one mesh after the states were eliminated.

    The `information` is on the coefficients, shape (parameters, parameters); the `gradient` is half that of twice the
    negative log-likelihood by them, with the states following. Where the coefficients stay, the states move by
    `state_step`, shape (n, D); their derivative as they follow the coefficients is `state_sensitivity`, shape
    (n, D, parameters). The `factor` is the banded one of the states' matrix, upper, in LAPACK's layout.
    """

    information: Floats
    gradient: Floats
    state_step: Floats
    state_sensitivity: Floats
    factor: Floats

    def state_covariances(self) -> tuple[Floats, Floats]:
        """Return the variance of every state where the coefficients stay, shape (n, D), and the last's covariance."""
        points, width = self.state_step.shape
        own, following = np.zeros((points, width, width)), np.zeros((points - 1, width, width))
        for i, j in np.ndindex(width, width):
            if j >= i:
                own[:, i, j] = self.factor[2 * width - 1 + i - j, j::width]
            following[:, i, j] = self.factor[width - 1 + i - j, width + j :: width]
        # Given the next state, a state is normal about what follows from that
        root = np.linalg.inv(own)
        follow, covariances = np.matmul(root[:-1], following), np.matmul(root, root.transpose(0, 2, 1))
        for k in range(points - 2, -1, -1):
            covariances[k] += follow[k] @ covariances[k + 1] @ follow[k].T
        return np.diagonal(covariances, axis1=1, axis2=2), covariances[-1]


def eliminate_states(
    linear: Jacobians,
    precision: Floats,
    weights: Floats,
    residuals: Floats,
    observed: Floats,
    anchored: tuple[Floats, Floats] | None = None,
) -> SchurComplement:
    """Return the normal equations of one mesh without the states.

    The precision of each defect has shape (n - 1, D), that of each measurement, its weight, shape (n, d); residuals are
    measured less sought values, shape (n, d), anything where the weight is zero. What is measured of the states has
    shape (d, D). The last states may be anchored at zero: with precisions, and values so far, both of shape (n, w).

    Raises
    ------
    NotPositiveError
        If numbers are not finite, or too far apart.
    """
    from scipy.linalg import cho_solve_banded

    points, width = len(weights), linear.defects.shape[1]
    start, end = linear.start.transpose(0, 2, 1), linear.end.transpose(0, 2, 1)
    weighted = linear.defects * precision
    blocks = np.matmul(observed.T * weights[:, np.newaxis], observed)
    gradient = np.where(weights > 0, -residuals * weights, 0.0) @ observed
    if anchored is not None:
        anchors, values = anchored
        inner = range(width - anchors.shape[1], width)
        blocks[:, inner, inner] += anchors
        gradient[:, inner] += anchors * values
    bands = _bands(linear, precision, blocks)
    gradient[:-1] += np.matmul(start, weighted[:, :, np.newaxis])[:, :, 0]
    gradient[1:] += np.matmul(end, weighted[:, :, np.newaxis])[:, :, 0]
    own = linear.coefficients
    count = own.shape[2]
    scaled = own * precision[:, :, np.newaxis]
    border = np.zeros((points, width, count))
    border[:-1] += np.matmul(start, scaled)
    border[1:] += np.matmul(end, scaled)
    flat, flat_scaled = own.reshape(weighted.size, count), scaled.reshape(weighted.size, count)
    flat_border = border.reshape(gradient.size, count)
    right = np.column_stack([flat_border, gradient.ravel()])
    if not np.isfinite(right).all():
        raise NotPositiveError
    factor = _factor(bands)
    solved = cho_solve_banded((factor, False), right, check_finite=False)
    information = flat.T @ flat_scaled - flat_border.T @ solved[:, :count]
    left = flat.T @ weighted.ravel() - flat_border.T @ solved[:, count]
    if not (np.isfinite(information).all() and np.isfinite(left).all()):
        raise NotPositiveError
    return SchurComplement(
        (information + information.T) / 2,
        left,
        -solved[:, count].reshape(points, width),
        -solved[:, :count].reshape(points, width, count),
        factor,
    )


def _bands(linear: Jacobians, precision: Floats, diagonal: Floats) -> Floats:
    """Return the matrix of the states by its upper bands, in LAPACK's layout, shape (2 D, n D).

    To the blocks on its diagonal, shape (n, D, D), what the defects say is added.
    """
    points, width = diagonal.shape[:2]
    start = linear.start.transpose(0, 2, 1) * precision[:, np.newaxis]
    end = linear.end.transpose(0, 2, 1) * precision[:, np.newaxis]
    diagonal[:-1] += np.matmul(start, linear.start)
    diagonal[1:] += np.matmul(end, linear.end)
    off_diagonal = np.matmul(start, linear.end)
    bands = np.zeros((2 * width, points * width))
    for i, j in np.ndindex(width, width):
        if j >= i:
            bands[2 * width - 1 + i - j, j::width] = diagonal[:, i, j]
        bands[width - 1 + i - j, width + j :: width] = off_diagonal[:, i, j]
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
