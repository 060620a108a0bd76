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
from commonlaw.likelihood.collocation import Slopes
from commonlaw.likelihood.fitting import Estimate, Problem
from commonlaw.likelihood.mesh import Mesh
from commonlaw.likelihood.normal_equations import NotPositiveError

_MISSING = 100.0
"""Noise of a state that was not measured, relative to that of one that was. It says next to nothing, and is small
enough to be eliminated without rounding."""

_RATE = 3.0
"""Noise of a rate per sampling step, relative to that of a state: much larger than what neighbouring states say of
it."""


@dataclass(frozen=True, eq=False)
class Expansion:
    """The likelihood of one object's trajectories about an estimate.

    Parameters
    ----------
    problem
        Its columns are all terms of the first equation, then of the second, and so on; one target; residuals have unit
        variance.
    volume
        Logarithm of the determinant of the covariance that was removed, less twice that of the change from states to
        defects: added to the squared residuals, it makes twice the negative log-likelihood of the states at the ends
        of all steps, so that tolerances and estimates can be compared.
    """

    problem: LeastSquaresProblem
    volume: float


def expand(problem: Problem, estimate: Estimate, tolerance: float) -> Expansion:
    """Return the likelihood about an estimate.

    Parameters
    ----------
    problem
        The object.
    estimate
        About which the law is linearised.
    tolerance
        Of the law, relative to the noise.

    Raises
    ------
    NotPositiveError
        If numbers are not finite, or too far apart.
    """
    columns = estimate.coefficients.size
    parts = whitened(problem, estimate, tolerance)
    rows = LeastSquaresProblem.of_blocks((own for own, _ in parts), columns, columns + 1)
    return Expansion(rows, sum(volume for _, volume in parts))


def whitened(problem: Problem, estimate: Estimate, tolerance: float) -> list[tuple[Floats, float]]:
    """Return the rows of each mesh, see `expand`, from first to last sample, and its volume.

    The targets are the innovations of the states: what each sample adds to those before it.

    Raises
    ------
    NotPositiveError
        If numbers are not finite, or too far apart.
    """
    pairs = zip(problem.meshes, estimate.states, strict=True)
    return [_whitened(problem, mesh, states, estimate.coefficients, tolerance) for mesh, states in pairs]


def _whitened(
    problem: Problem, mesh: Mesh, states: Floats, coefficients: Floats, tolerance: float
) -> tuple[Floats, float]:
    """Return rows [library of all equations | target] of unit covariance, and the log-determinant of theirs before."""
    from scipy.linalg import lapack

    with np.errstate(all="ignore"):
        slopes = problem.dynamics.slopes(mesh, states, coefficients, np.ones_like(coefficients, dtype=bool))
    variances, offsets = _measured(problem, mesh, states)
    defects = slopes.defects + np.matmul(slopes.before, offsets[:-1, :, np.newaxis])[:, :, 0]
    defects += np.matmul(slopes.after, offsets[1:, :, np.newaxis])[:, :, 0]
    library = slopes.parameters.reshape(-1, coefficients.size)
    rows = np.column_stack([library, library @ coefficients.ravel() - defects.ravel()])
    bands = _covariance(slopes, variances, (tolerance * problem.unit) ** 2 * mesh.shares[:, np.newaxis], mesh)
    if not (np.isfinite(bands).all() and np.isfinite(rows).all()):
        raise NotPositiveError
    factor, failed = lapack.dpbtrf(bands, lower=1)
    if failed:
        raise NotPositiveError
    white, _ = lapack.dtbtrs(factor, rows, uplo="L")
    # From the density of defects to that of the states at the end of each step
    turned = np.linalg.slogdet(slopes.after[mesh.linked])[1]
    volume = 2 * float(np.sum(np.log(factor[0])) - np.sum(turned))
    return np.asfortranarray(white[np.repeat(mesh.linked, problem.dynamics.width)]), volume


def _measured(problem: Problem, mesh: Mesh, states: Floats) -> tuple[Floats, Floats]:
    """Return the variance of every state at every point, and where its centre is from the estimate, shape (n, D)."""
    equations, width = problem.dynamics.equations, problem.dynamics.width
    gaps = problem.gaps(mesh, states)
    weights = problem.measurement.weights(gaps)
    noise = problem.measurement.noise
    missing = np.tile((_MISSING * noise) ** 2, (len(mesh), 1))
    variances = np.empty((len(mesh), width))
    with np.errstate(divide="ignore"):
        variances[:, :equations] = np.where(weights > 0, 1 / weights, missing)
    # The rates of a law of second order, which nobody measured
    variances[:, equations:] = (_RATE * noise[: width - equations] / np.median(mesh.steps[mesh.linked])) ** 2
    offsets = np.zeros((len(mesh), width))
    offsets[:, :equations] = np.where(mesh.seen, gaps, 0.0)
    return variances, offsets


def _covariance(slopes: Slopes, variances: Floats, allowed: Floats, mesh: Mesh) -> Floats:
    """Return the covariance of the defects by its lower bands, in LAPACK's layout, shape (2 D, steps D)."""
    steps, width = slopes.defects.shape
    before = slopes.before * variances[:-1, np.newaxis]
    after = slopes.after * variances[1:, np.newaxis]
    diagonal = np.matmul(before, slopes.before.transpose(0, 2, 1)) + np.matmul(after, slopes.after.transpose(0, 2, 1))
    diagonal[:, range(width), range(width)] += np.where(mesh.linked[:, np.newaxis], allowed, 1.0)
    beside = np.matmul(slopes.before[1:], after[:-1].transpose(0, 2, 1))
    bands = np.zeros((2 * width, steps * width))
    for i in range(width):
        for j in range(width):
            if i >= j:
                bands[i - j, j::width] = diagonal[:, i, j]
            bands[width + i - j, j : (steps - 1) * width : width] = beside[:, i, j]
    return bands
