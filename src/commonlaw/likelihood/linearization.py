"""The likelihood of trajectories as regression rows, linearised about an estimate: what solvers choose terms by.

To first order in the noise the defects of a law, evaluated on measured states, are Gaussian with a covariance that
links neighbouring steps. Rows that are freed of it (whitened) obey ordinary least squares: their sum of squared
residuals is twice the negative log-likelihood, with the states eliminated (generalised least squares; Bortz, Messenger
and Dukic 2023 do the same in the weak form, where this takes every test function).
"""

from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.formulation import LeastSquaresProblem
from commonlaw.likelihood.collocation import Jacobians, jacobians
from commonlaw.likelihood.fitting import Estimate, TrajectoryModel
from commonlaw.likelihood.mesh import Mesh
from commonlaw.likelihood.normal_equations import NotPositiveError

_MISSING = 100.0
"""Noise of a state that was not measured, relative to that of one that was. It says next to nothing, and is small
enough to be eliminated without rounding."""

_RATE = 3.0
"""Noise of a rate per sampling step, relative to that of a state: much larger than what neighbouring states say of
it."""


@dataclass(frozen=True, eq=False)
class Linearization:
    """The likelihood of one object's trajectories about an estimate.

    Columns of the problem are all terms of the first equation, then of the second, and so on; it has one target, and
    residuals of unit variance. The logarithm of the determinant of the covariance that was removed, less twice that of
    the change from states to defects, added to the squared residuals, makes twice the negative log-likelihood of the
    states at the ends of all steps, so that model errors and estimates can be compared.
    """

    problem: LeastSquaresProblem
    log_determinant: float


def linearize(model: TrajectoryModel, estimate: Estimate, model_error: float) -> Linearization:
    """Return the likelihood about an estimate.

    Parameters
    ----------
    model
        Of one object.
    estimate
        About which the law is linearised.
    model_error
        Standard deviation of the model error in each step, relative to the noise.

    Raises
    ------
    NotPositiveError
        If numbers are not finite, or too far apart.
    """
    columns = estimate.coefficients.size
    parts = whitened(model, estimate, model_error)
    rows = LeastSquaresProblem.of_blocks((own for own, _ in parts), columns, columns + 1)
    return Linearization(rows, sum(log_determinant for _, log_determinant in parts))


def whitened(model: TrajectoryModel, estimate: Estimate, model_error: float) -> list[tuple[Floats, float]]:
    """Return the rows of each mesh, see `linearize`, from first to last sample, and its log-determinant.

    The targets are the innovations of the states: what each sample adds to those before it.

    Raises
    ------
    NotPositiveError
        If numbers are not finite, or too far apart.
    """
    pairs = zip(model.meshes, estimate.states, strict=True)
    return [_whitened(model, mesh, states, estimate.coefficients, model_error) for mesh, states in pairs]


def _whitened(
    model: TrajectoryModel, mesh: Mesh, states: Floats, coefficients: Floats, model_error: float
) -> tuple[Floats, float]:
    """Return rows [library of all equations | target] of unit covariance, and the log-determinant of theirs before."""
    from scipy.linalg import lapack

    with np.errstate(all="ignore"):
        linear = jacobians(model.field(coefficients, np.ones_like(coefficients, dtype=bool)), mesh, states)
    variances, offsets = _measured(model, mesh, states)
    defects = linear.defects + np.matmul(linear.start, offsets[:-1, :, np.newaxis])[:, :, 0]
    defects += np.matmul(linear.end, offsets[1:, :, np.newaxis])[:, :, 0]
    library = linear.coefficients.reshape(-1, coefficients.size)
    rows = np.column_stack([library, library @ coefficients.ravel() - defects.ravel()])
    allowed = (model_error * model.unit) ** 2 * mesh.relative_steps[:, np.newaxis]
    bands = _covariance(linear, variances, allowed, mesh)
    if not (np.isfinite(bands).all() and np.isfinite(rows).all()):
        raise NotPositiveError
    factor, failed = lapack.dpbtrf(bands, lower=1)
    if failed:
        raise NotPositiveError
    white, _ = lapack.dtbtrs(factor, rows, uplo="L")
    # From the density of defects to that of the states at the end of each step
    turned = np.linalg.slogdet(linear.end[mesh.contiguous])[1]
    log_determinant = 2 * float(np.sum(np.log(factor[0])) - np.sum(turned))
    return np.asfortranarray(white[np.repeat(mesh.contiguous, model.width)]), log_determinant


def _measured(model: TrajectoryModel, mesh: Mesh, states: Floats) -> tuple[Floats, Floats]:
    """Return the variance of every state at every point, and where its centre is from the estimate, shape (n, D)."""
    equations, width = model.equations, model.width
    residuals = model.residuals(mesh, states)
    weights = model.observation.weights(residuals)
    noise = model.observation.noise
    missing = np.tile((_MISSING * noise) ** 2, (len(mesh), 1))
    variances = np.empty((len(mesh), width))
    with np.errstate(divide="ignore"):
        variances[:, :equations] = np.where(weights > 0, 1 / weights, missing)
    # The rates of a law of second order, which nobody measured
    variances[:, equations:] = (_RATE * noise[: width - equations] / np.median(mesh.steps[mesh.contiguous])) ** 2
    offsets = np.zeros((len(mesh), width))
    offsets[:, :equations] = np.where(mesh.observed, residuals, 0.0)
    return variances, offsets


def _covariance(linear: Jacobians, variances: Floats, allowed: Floats, mesh: Mesh) -> Floats:
    """Return the covariance of the defects by its lower bands, in LAPACK's layout, shape (2 D, steps D)."""
    steps, width = linear.defects.shape
    start = linear.start * variances[:-1, np.newaxis]
    end = linear.end * variances[1:, np.newaxis]
    diagonal = np.matmul(start, linear.start.transpose(0, 2, 1)) + np.matmul(end, linear.end.transpose(0, 2, 1))
    diagonal[:, range(width), range(width)] += np.where(mesh.contiguous[:, np.newaxis], allowed, 1.0)
    beside = np.matmul(linear.start[1:], end[:-1].transpose(0, 2, 1))
    bands = np.zeros((2 * width, steps * width))
    for i, j in np.ndindex(width, width):
        if i >= j:
            bands[i - j, j::width] = diagonal[:, i, j]
        bands[width + i - j, j : (steps - 1) * width : width] = beside[:, i, j]
    return bands
