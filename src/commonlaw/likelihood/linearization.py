"""The likelihood, linearized about a fit, as a least-squares problem of the coefficients.

With Jacobians A of defects by states and B by coefficients, and covariances R of measurements and Q of model errors,
defects at measured states are normal with covariance ``A R A' + Q``. Their rows, whitened by a banded Cholesky
factorization, are a regression on the columns of B (generalized least squares).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.formulation import LeastSquaresProblem, column_scales
from commonlaw.library import with_rates
from commonlaw.likelihood.collocation import Jacobians, jacobians
from commonlaw.likelihood.fitting import Estimate, NotPositiveError, TrajectoryModel
from commonlaw.likelihood.mesh import Mesh
from commonlaw.likelihood.observation_model import LatentSteps


def sensitivities(
    model: TrajectoryModel, mesh: Mesh, states: Floats, coefficients: Floats, free: Bools, wanted: Bools
) -> Floats:
    """Return the sensitivities of states at the wanted points with NumPy, see `computing.sensitivities`."""
    width, size, on = model.width, int(free.sum()), mesh.contiguous
    linear = jacobians(model.field(coefficients, free), mesh, states[:, :width])
    sources = np.zeros((len(mesh), width, width + size))
    sources[mesh.first] = np.eye(width, width + size)
    solved = np.linalg.solve(linear.end[on], np.concatenate([linear.start[on], -linear.coefficients[on]], axis=2))
    sources[1:][on, :, width:] = solved[:, :, width:]
    return propagated(mesh, solved[:, :, :width], sources)[wanted]


def propagated(mesh: Mesh, steps: Floats, sources: Floats) -> Floats:
    """Return x of ``x_n = s_n - A x_(n - 1)`` within segments, and ``x_n = s_n`` where they begin, by a banded system.

    Sources and x have shape (n, D, m), and A of all steps within segments (steps, D, D).
    """
    from scipy.linalg import lapack

    points, width, columns = sources.shape
    bands = np.zeros((2 * width, points * width))
    for i, j in np.ndindex(width, width):  # Of the states after a step by those before it
        bands[width + i - j, j:-width:width][mesh.contiguous] = steps[:, i, j]
    solved = lapack.dtbtrs(bands, sources.reshape(-1, columns), uplo="L", diag="U")[0]
    return np.asarray(solved).reshape(sources.shape)


MISSING = 100.0
"""Standard deviation of an unmeasured state, in units of the noise: vague, and small enough for elimination without
rounding errors."""

HIDDEN = 1000.0
"""The same for latent processes, and for states under autocorrelated errors, in units of their standard deviation."""

RATE = 3.0
"""The same for a rate, in units of the noise per sampling step: vague compared with differences of states."""


@dataclass(frozen=True, eq=False)
class Linearization:
    """The likelihood of one object's trajectories, linearized about an estimate.

    Columns of the problem are all terms of the first equation, then of the second, ...; residuals have unit variance.
    Minus twice the log-likelihood is, up to a constant, the sum of squared residuals plus `log_determinant`, that of
    the covariance of defects less twice that of the Jacobian of defects by the states at the ends of steps.
    """

    problem: LeastSquaresProblem
    log_determinant: float


def linearize(
    model: TrajectoryModel, estimate: Estimate, model_error: float, columns: Bools | None = None
) -> Linearization:
    """Return the linearized likelihood with NumPy, see `computing.linearize`."""
    count = estimate.coefficients.size if columns is None else int(columns.sum())
    parts = whitened(model, estimate, model_error, columns)
    rows = LeastSquaresProblem.of_blocks((block for block, _ in parts), count, count + 1)
    return Linearization(rows, sum(log_determinant for _, log_determinant in parts))


def whitened(
    model: TrajectoryModel, estimate: Estimate, model_error: float, columns: Bools | None = None
) -> list[tuple[Floats, float]]:
    """Return the rows of each mesh with NumPy, see `computing.whitened`."""
    free = np.ones_like(estimate.coefficients, dtype=bool) if columns is None else columns
    return [_whitened(model, part, estimate.coefficients, free, model_error) for part in model.parts(estimate)]


def whitened_with_initial_states(
    model: TrajectoryModel, estimate: Estimate, model_error: float, columns: Bools
) -> tuple[list[Floats], float]:
    """Return the rows of each segment, [initial state | library | target], and the log-determinant of all.

    Rows are those of the measurements at the first point, and those of `whitened` given the initial state.
    """
    blocks, total = list[Floats](), 0.0
    for part in model.parts(estimate):
        rows, log_determinant = _whitened(model, part, estimate.coefficients, columns, model_error, from_starts=True)
        mesh, states, _ = part
        first = np.flatnonzero(mesh.first)
        residuals = model.residuals(mesh, states)[first]
        precision = np.sqrt(
            model.observation.weights(residuals, np.broadcast_to(mesh.scale, mesh.measured.shape)[first])
        )
        at_start = np.zeros((len(first), model.equations, rows.shape[1]))
        diagonal = range(model.equations)
        at_start[:, diagonal, diagonal] = precision
        at_start[:, :, -1] = precision * np.where(mesh.observed[first], residuals, 0.0)
        steps = np.diff(first, append=len(mesh)) - 1
        of_each = np.split(rows, np.cumsum(steps)[:-1] * model.width)
        blocks += [np.vstack(pair) for pair in zip(at_start, of_each, strict=True)]
        total += log_determinant
    return blocks, total


def _whitened(
    model: TrajectoryModel,
    part: tuple[Mesh, Floats, LatentSteps | None],
    coefficients: Floats,
    free: Bools,
    model_error: float,
    from_starts: bool = False,
) -> tuple[Floats, float]:
    """Return whitened rows [library of all equations | target] of one mesh, and the log-determinant.

    With `from_starts`, columns of the initial state come first, and measurements there are omitted.
    """
    from scipy.linalg import lapack

    mesh, states, latent = part
    with np.errstate(all="ignore"):
        linear = jacobians(model.field(coefficients, free), mesh, states, latent)
    covariances, offsets, unmeasured = _measured(model, mesh, states, latent, from_starts)
    drift = np.empty((*linear.defects.shape, 0))
    if model.latent.drift is not None:  # Of states plus drift, see `fitting`
        basis, (errors, slopes) = model.drift(mesh), np.split(states[:, model.width :], 2, axis=1)
        offsets += np.column_stack([errors, slopes[:, with_rates(model.order, model.equations)]])
        drift = -np.matmul(linear.start, basis[:-1]) - np.matmul(linear.end, basis[1:])
        drift *= model.latent.drift
    defects = linear.defects + np.matmul(linear.start, offsets[:-1, :, np.newaxis])[:, :, 0]
    defects += np.matmul(linear.end, offsets[1:, :, np.newaxis])[:, :, 0]
    library = linear.coefficients.reshape(defects.size, -1)
    target = library @ coefficients[free] - defects.ravel()
    if not np.isfinite(library).all():
        raise NotPositiveError
    # Orthogonal columns keep their digits where terms are nearly collinear, far from the origin
    basis, triangle = orthogonalized(library, free, model)
    starts = linear.start * mesh.first[:-1, np.newaxis, np.newaxis] if from_starts else np.empty((*defects.shape, 0))
    rows = np.column_stack([drift.reshape(defects.size, -1), starts.reshape(defects.size, -1), basis, target])
    allowed = (model_error * model.unit) ** 2 * model.walk(mesh)
    allowed = np.column_stack([allowed, np.ones((len(allowed), model.latent.chained))])
    bands = _covariance(linear, covariances, allowed, mesh)
    if not (np.isfinite(bands).all() and np.isfinite(rows).all()):
        raise NotPositiveError
    factor, failed = lapack.dpbtrf(bands, lower=1)
    if failed:
        raise NotPositiveError
    white, _ = lapack.dtbtrs(factor, rows, uplo="L")
    means = np.zeros(0) if model.latent.drift is None else model.latent.mean / model.latent.drift
    white, of_drift = _without_drift(white, means, np.repeat(mesh.first[:-1], defects.shape[1]))
    before = starts.shape[2]
    white = np.column_stack([white[:, :before], white[:, before:-1] @ triangle, white[:, -1]])
    # From the density of defects to that of the states at the end of each step
    turned = np.linalg.slogdet(linear.end[mesh.contiguous])[1]
    log_determinant = 2 * float(np.sum(np.log(factor[0])) - np.sum(turned)) - unmeasured + of_drift
    return np.asfortranarray(white[np.repeat(mesh.contiguous, linear.defects.shape[1])]), log_determinant


def _without_drift(rows: Floats, means: Floats, begins: Bools) -> tuple[Floats, float]:
    """Return the rows of a mesh without their first columns, and the log-determinant of the covariance by these.

    They are the numbers of a drift of each segment, of unit variance and of given means, shape (q,), in rows of unit
    covariance. Rotations in the order of rows leave their innovations (recursive least squares; Gentleman 1973).
    """
    count = len(means)
    if not count:
        return rows, 0.0
    rotated, total = rows.copy(), 0.0
    for first, last in pairwise([*np.flatnonzero(begins & ~np.append(False, begins[:-1])), len(rows)]):
        factor = np.eye(count, rows.shape[1])
        factor[:, -1] = means
        for row in rotated[first:last]:
            for k in range(count):
                size = np.hypot(factor[k, k], row[k])
                c, s = factor[k, k] / size, row[k] / size
                factor[k], row[:] = c * factor[k] + s * row, c * row - s * factor[k]
        total += 2 * float(np.log(np.diagonal(factor)).sum())
    return rotated[:, count:], total


def orthogonalized(library: Floats, free: Bools, model: TrajectoryModel) -> tuple[Floats, Floats]:
    """Return a basis Q and a matrix R with ``library = Q R``, by QR factorization of the columns of each equation.

    Rows of the library are defects. In units of the noise, columns of different equations are nearly orthogonal.
    """
    counts, units = free.sum(axis=1), np.append(model.unit, np.ones(model.latent.chained))
    units = np.where(units > 0, units, 1.0)
    units = np.tile(units, len(library) // len(units))[:, np.newaxis]
    library = library / units
    if len(library) < counts.max(initial=0):
        basis, triangle = np.linalg.qr(library)
        return units * basis, triangle
    basis, triangle, ends = np.empty(library.shape), np.zeros((library.shape[1],) * 2), np.cumsum(counts)
    for columns in map(slice, ends - counts, ends):
        basis[:, columns], triangle[columns, columns] = _orthogonal(library[:, columns])
    return units * basis, triangle


def _orthogonal(columns: Floats) -> tuple[Floats, Floats]:
    """Return the QR factorization, by Cholesky factorization where its condition number is below 1e6."""
    from scipy.linalg import blas, lapack

    norms = column_scales(columns)
    with np.errstate(over="ignore", invalid="ignore"):  # Squares that overflow, whose factorization fails
        factor, failed = lapack.dpotrf(columns.T @ columns / np.outer(norms, norms))
    if failed or not lapack.dtrcon(factor)[0] > 1e-6:
        return np.linalg.qr(columns)
    factor = np.asarray(factor * norms)
    return blas.dtrsm(1.0, factor, np.asfortranarray(columns.T), trans_a=1).T, factor


def _measured(
    model: TrajectoryModel, mesh: Mesh, states: Floats, latent: LatentSteps | None, from_starts: bool
) -> tuple[Floats, Floats, float]:
    """Return the covariances of states given measurements, (n, D + w, D + w), offsets (n, D + w), and a constant.

    Unmeasured states have vague variances. The constant is the sum of their logarithms at the ends of steps, which is
    not part of the likelihood; at first points it is that of their ratios to the prior variances of initial states,
    which are in units of all errors. Initial states are known with `from_starts`.
    """
    equations, width = model.equations, model.width
    residuals = model.residuals(mesh, states)
    weights = model.observation.weights(residuals, mesh.scale)
    seen, everywhere = weights > 0, np.ones((len(mesh), 1))
    variances = everywhere * vague(model, mesh, latent)
    offsets = np.zeros((len(mesh), width))
    offsets[:, :equations] = np.where(mesh.observed, residuals, 0.0)
    if latent is not None and model.latent.chained:
        hidden = states[:, width:]
        offsets = np.column_stack([offsets, -hidden])
        if model.latent.correlated is not None:
            offsets[:, :equations] += np.where(mesh.observed, hidden[:, :equations], 0.0)
        with np.errstate(divide="ignore"):
            variances[:, width:] = np.where(latent.anchors > 0, 1 / latent.anchors, variances[:, width:])
    unknown = np.ones(variances.shape, dtype=bool)
    unknown[:, :equations] = ~seen
    ends = np.append(False, mesh.contiguous)
    unmeasured = float(np.sum(np.log(variances[ends]), where=unknown[ends]))
    if not from_starts:
        ratios = variances[:, : model.width] / prior_variances(model, mesh)
        unmeasured += float(np.sum(np.log(ratios[~ends]), where=unknown[~ends, : model.width]))
    with np.errstate(divide="ignore"):
        variances[:, :equations] = np.where(seen, 1 / weights, variances[:, :equations])
    covariances = np.zeros((*variances.shape, variances.shape[1]))
    diagonal = range(variances.shape[1])
    covariances[:, diagonal, diagonal] = variances
    if model.latent.correlated is not None:  # Error and state are negatively correlated given the measurement
        for j, error in zip(range(equations), range(width, width + equations), strict=True):
            shared = np.where(seen[:, j], variances[:, error], 0.0)
            covariances[:, j, j] += shared
            covariances[:, j, error] = covariances[:, error, j] = -shared
    if from_starts:
        covariances[mesh.first] = offsets[mesh.first] = 0.0
    return covariances, offsets, unmeasured


def vague(model: TrajectoryModel, mesh: Mesh, latent: LatentSteps | None) -> Floats:
    """Return the vague variances of unmeasured states and latent processes, shape (D + w,).

    Those of states are in units of all errors, plus those of autocorrelated ones, which are latent processes.
    """
    variances = prior_variances(model, mesh)
    if model.latent.correlated is not None:
        errors = (HIDDEN * model.latent.error_std(len(mesh) * mesh.typical_step)) ** 2
        of_rates = errors[with_rates(model.order, model.equations)] / mesh.typical_step**2
        variances = variances + np.concatenate([errors, of_rates])
    return (
        variances
        if latent is None or not model.latent.chained
        else np.concatenate([variances, (HIDDEN * latent.std) ** 2])
    )


def prior_variances(model: TrajectoryModel, mesh: Mesh) -> Floats:
    """Return the prior variances of unmeasured initial states and rates, in units of all errors, shape (D,)."""
    noise = _typical_noise(model, mesh)
    rates = RATE * noise[with_rates(model.order, model.equations)] / mesh.typical_step
    return np.append(MISSING * noise, rates) ** 2


def _typical_noise(model: TrajectoryModel, mesh: Mesh) -> Floats:
    """Return the root mean square error of the measurements of each state, white and autocorrelated, shape (d,)."""
    scale = np.sqrt(np.mean(np.broadcast_to(mesh.scale, mesh.measured.shape) ** 2, axis=0))
    return np.asarray(np.hypot(model.observation.noise * scale, model.latent.error_std(mesh.typical_step)))


def _covariance(linear: Jacobians, covariances: Floats, allowed: Floats, mesh: Mesh) -> Floats:
    """Return the covariance A R A' + Q of the defects by lower bands, in LAPACK's layout, shape (2 D, steps D)."""
    steps, width = linear.defects.shape
    start = np.matmul(linear.start, covariances[:-1])
    end = np.matmul(linear.end, covariances[1:])
    diagonal = np.matmul(start, linear.start.transpose(0, 2, 1)) + np.matmul(end, linear.end.transpose(0, 2, 1))
    diagonal[:, range(width), range(width)] += np.where(mesh.contiguous[:, np.newaxis], allowed, 1.0)
    off_diagonal = np.matmul(linear.start[1:], end[:-1].transpose(0, 2, 1))
    bands = np.zeros((2 * width, steps * width))
    for i, j in np.ndindex(width, width):
        if i >= j:
            bands[i - j, j::width] = diagonal[:, i, j]
        bands[width + i - j, j : (steps - 1) * width : width] = off_diagonal[:, i, j]
    return bands


HETEROGENEITY_LEVEL = 0.01
"""P-value, times the number of objects that are tested (Bonferroni), below which trials differ."""


def heterogeneity_p_value(factors: Sequence[Floats], measurements: int, least_variance: float = 0.0) -> float:
    """Return the p-value of the F test for rows ``[columns | target]`` of each trial; one if it cannot be made.

    Initial states are eliminated from the rows, and from the number of measurements; columns have unit noise, or at
    least a variance of as much.
    """
    from scipy.special import fdtrc

    common = factors[0].shape[1] - 1
    rss_common, rss = _rss(np.concatenate(factors)), sum(_rss(factor) for factor in factors)
    separate = sum(np.linalg.matrix_rank(factor[:, :-1]) for factor in factors)
    additional, nu = separate - common, measurements - separate
    variance = max(rss / nu, least_variance) if nu > 0 else 0.0
    if additional <= 0 or not common or not variance:
        return 1.0
    return float(fdtrc(additional, nu, max(rss_common - rss, 0.0) / additional / variance))


def _rss(factor: Floats) -> float:
    columns, target = factor[:, :-1], factor[:, -1]
    scaled = columns / column_scales(columns)
    theta = np.linalg.lstsq(scaled, target, rcond=1e-10)[0]
    return float(np.sum((target - scaled @ theta) ** 2))
