"""Maximum-likelihood estimates of trajectories and coefficients by Gauss-Newton, with states eliminated.

With defects d of a solution (see `collocation`), model-error variances q and residuals r of weights w, the objective

    sum of w r^2 + sum of d^2 / q + sum of p (theta - theta_0)^2

is minimized over states z and coefficients theta. Its normal equations are block tridiagonal in z, which is eliminated
by a banded Cholesky factorization (Schur complement).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.integration import VectorField
from commonlaw.kernel import CONSTANTS
from commonlaw.library import Order, Terms, with_rates
from commonlaw.likelihood.collocation import Jacobians, defects, jacobians
from commonlaw.likelihood.mesh import Mesh
from commonlaw.likelihood.observation_model import NO_PROCESSES, LatentProcesses, LatentSteps, ObservationModel
from commonlaw.runtime.forking import cached_property

_LIFTS = CONSTANTS["LIFTS"]
(_SHORTER,), (_RELATIVE_GAIN,) = CONSTANTS["SHORTER"], CONSTANTS["RELATIVE_GAIN"]


class NotPositiveError(CommonlawError, ArithmeticError):
    """Numbers overflowed, or the information is not positive definite."""

    def __init__(self, code: str = "likelihood-not-computable", /, where: str = "", **parameters: object) -> None:
        super().__init__(code, where, **parameters)


@dataclass(frozen=True, eq=False)
class SchurComplement:
    """The normal equations of one mesh after elimination of the states.

    `information` on the coefficients has shape (parameters, parameters); `gradient` is half that of the objective by
    them, the states following. At fixed coefficients states move by `state_step`, shape (n, D), and
    `state_sensitivity`, shape (n, D, parameters), is their derivative by the coefficients. `factor` is the banded
    factor of the states, in LAPACK's layout.
    """

    information: Floats
    gradient: Floats
    state_step: Floats
    state_sensitivity: Floats
    factor: Floats

    def state_covariances(self) -> tuple[Floats, Floats]:
        """Return the variances of states given the coefficients, shape (n, D), and the covariance of the last state."""
        points, width = self.state_step.shape
        diagonal, following = np.zeros((points, width, width)), np.zeros((points - 1, width, width))
        for i, j in np.ndindex(width, width):
            if j >= i:
                diagonal[:, i, j] = self.factor[2 * width - 1 + i - j, j::width]
            following[:, i, j] = self.factor[width - 1 + i - j, width + j :: width]
        # Backward recursion (Rauch-Tung-Striebel smoother)
        root = np.linalg.inv(diagonal)
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
    """Return the normal equations of one mesh with the states eliminated.

    Precisions of defects have shape (n - 1, D), weights of measurements (n, d), zero where there are none; `observed`,
    shape (d, D), maps states to measurements. The last states may be anchored at zero: precisions and values of shape
    (n, w). Raises `NotPositiveError` if numbers are not finite, or too far apart.
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
    by_coefficients = linear.coefficients
    count = by_coefficients.shape[2]
    scaled = by_coefficients * precision[:, :, np.newaxis]
    border = np.zeros((points, width, count))
    border[:-1] += np.matmul(start, scaled)
    border[1:] += np.matmul(end, scaled)
    flat, flat_scaled = by_coefficients.reshape(weighted.size, count), scaled.reshape(weighted.size, count)
    flat_border = border.reshape(gradient.size, count)
    right = np.column_stack([flat_border, gradient.ravel()])
    if not np.isfinite(right).all():
        raise NotPositiveError
    factor = _factor(bands)
    solved = cho_solve_banded((factor, False), right, check_finite=False)
    information = flat.T @ flat_scaled - flat_border.T @ solved[:, :count]
    gradient_theta = flat.T @ weighted.ravel() - flat_border.T @ solved[:, count]
    if not (np.isfinite(information).all() and np.isfinite(gradient_theta).all()):
        raise NotPositiveError
    return SchurComplement(
        (information + information.T) / 2,
        gradient_theta,
        -solved[:, count].reshape(points, width),
        -solved[:, :count].reshape(points, width, count),
        factor,
    )


def _bands(linear: Jacobians, precision: Floats, diagonal: Floats) -> Floats:
    """Return the upper bands of the states' matrix, in LAPACK's layout, shape (2 D, n D)."""
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


SHORTEST = 1e-4
"""Smallest share of the Gauss-Newton step in the line search."""

GAIN = 1e-3
"""Decrease of the objective, besides the relative one, below which the iteration ends."""


class Prior(NamedTuple):
    """Normal priors of coefficients: means and precisions, both of shape (equations, terms)."""

    mean: Floats
    precision: Floats


@dataclass(frozen=True, eq=False)
class TrajectoryModel:
    """The state-space model of one object's trajectories, with a law that holds up to a model error.

    Terms are over the states z (x of a law of first order, (x, x') of one of second order), inputs and time. The unit
    of the model error in each state, shape (D,), is the noise of measured states, and its equivalent for rates. In
    estimates, values of latent processes follow those of the states: shape (n, D + w). Without a prior, that of the
    coefficients is flat.
    """

    terms: Terms
    meshes: Sequence[Mesh]
    observation: ObservationModel
    unit: Floats
    latent: LatentProcesses = NO_PROCESSES
    prior: "Prior | None" = None

    @property
    def equations(self) -> int:
        """Number of measured states d, one equation each."""
        return len(self.observation.noise)

    @property
    def width(self) -> int:
        """Number of states, D."""
        return len(self.terms.variables.states)

    @property
    def order(self) -> Order:
        """Order of the law, 1 or 2 or that of each equation."""
        return self.terms.variables.order_of(self.equations)

    def field(self, coefficients: Floats, free: Bools | None = None) -> VectorField:
        """Return the vector field of coefficients, shape (equations, terms), of which some are free."""
        return VectorField(self.terms, coefficients, self.order, free=free)

    def precision(self, mesh: Mesh, model_error: float) -> Floats:
        """Return the precision of each defect, shape (n - 1, D + w), for a random walk of a given model error."""
        on = mesh.contiguous[:, np.newaxis]
        q = on / (model_error * self.unit) ** 2 / self.walk(mesh)
        return np.column_stack([q, np.repeat(on, self.latent.chained, axis=1)]) if self.latent.chained else q

    def walk(self, mesh: Mesh) -> Floats:
        """Return the variance of a random walk in each step, of a rate as of its state, shape (n - 1, D)."""
        return np.column_stack([mesh.walk, mesh.walk[:, with_rates(self.order, self.equations)]])

    @cached_property
    def latent_steps(self) -> tuple[LatentSteps | None, ...]:
        """The latent processes along each mesh, None if there are none."""
        return tuple(self.latent.along(mesh) if self.latent.width else None for mesh in self.meshes)

    @property
    def observed(self) -> Floats:
        """The observation matrix H of states and latent processes, shape (d, D + w)."""
        h = np.eye(self.equations, self.width + self.latent.width)
        if self.latent.are_measured:
            h[:, self.width : self.width + self.equations] = np.eye(self.equations)
        return h

    def drift(self, mesh: Mesh) -> Floats:
        """Return the derivatives of drift by its values at first points and slopes, shape (n, D, 2 d)."""
        d, second = self.equations, with_rates(self.order, self.equations)
        basis = np.zeros((len(mesh), self.width, 2 * d))
        basis[:, range(d), range(d)] = 1.0
        basis[:, range(d), range(d, 2 * d)] = mesh.elapsed[:, np.newaxis]
        basis[:, range(d, self.width), d + second] = 1.0
        return basis

    def residuals(self, mesh: Mesh, states: Floats) -> Floats:
        """Return residuals y - H z, shape (n, d), NaN where nothing was measured."""
        return mesh.measured - states @ self.observed.T

    def parts(self, estimate: "Estimate") -> Iterator[tuple[Mesh, Floats, LatentSteps | None]]:
        """Yield each mesh with its states, shape (n, D + w), and the steps of its latent processes."""
        return zip(self.meshes, estimate.states, self.latent_steps, strict=True)

    def with_latent(self, latent: LatentProcesses, estimate: "Estimate") -> tuple["TrajectoryModel", "Estimate"]:
        """Return the model with other latent processes, and an estimate in which they are zero."""
        states = tuple(np.zeros((len(state), self.width + latent.width)) for state in estimate.states)
        for padded, z in zip(states, estimate.states, strict=True):
            padded[:, : self.width] = z[:, : self.width]
        return replace(self, latent=latent), replace(estimate, states=states)


@dataclass(frozen=True, eq=False)
class Estimate:
    """States of each mesh, shape (n, D), and coefficients, shape (equations, terms), of one object.

    `deviance` is minus twice the log-likelihood of the measurements, up to a constant; `objective` adds the squared
    defects and the prior, and is infinite if it is not finite.
    """

    states: tuple[Floats, ...]
    coefficients: Floats
    deviance: float = np.inf
    objective: float = np.inf


def fit(
    model: TrajectoryModel, start: Estimate, support: Bools, model_errors: Sequence[float], steps: int = 12
) -> Estimate:
    """Return the maximum-likelihood estimate with NumPy, see `computing.fit`."""
    estimate = start
    for model_error in model_errors:
        estimate = _evaluated(model, estimate, model_error)
        for _ in range(steps):
            better = _step(model, estimate, support, model_error)
            if better is None:
                break
            gain = estimate.objective - better.objective
            estimate = better
            if gain < GAIN * (1 + _RELATIVE_GAIN * estimate.objective):
                break
    return estimate


def _evaluated(model: TrajectoryModel, estimate: Estimate, model_error: float) -> Estimate:
    """Return the estimate with its deviance and objective for a model error."""
    deviance = objective = 0.0
    field = model.field(estimate.coefficients)
    with np.errstate(all="ignore"):
        for mesh, states, latent in model.parts(estimate):
            deviance += model.observation.deviance(model.residuals(mesh, states), mesh.scale)
            residuals = defects(field, mesh, states, latent)
            objective += float(np.sum(residuals**2 * model.precision(mesh, model_error)))
            if latent is not None:
                objective += float(np.sum(latent.anchors * (states[:, model.width :] - model.latent.mean) ** 2))
    if model.prior is not None:
        objective += float(np.sum(model.prior.precision * (estimate.coefficients - model.prior.mean) ** 2))
    objective += deviance
    return replace(estimate, deviance=deviance, objective=objective if np.isfinite(objective) else np.inf)


def eliminate_states_of_meshes(
    model: TrajectoryModel, estimate: Estimate, support: Bools, model_error: float
) -> list[SchurComplement]:
    """Return the normal equations of each mesh about an estimate with the states eliminated, see `eliminate_states`."""
    parts, field = [], model.field(estimate.coefficients, support)
    with np.errstate(all="ignore"):
        for mesh, states, latent in model.parts(estimate):
            if model.latent.drift is not None:
                parts.append(_eliminate_with_drift(model, field, mesh, states, model_error))
                continue
            residuals = model.residuals(mesh, states)
            weights = model.observation.weights(residuals, mesh.scale)
            linear, precision = jacobians(field, mesh, states, latent), model.precision(mesh, model_error)
            anchored = None if latent is None else (latent.anchors, states[:, model.width :])
            parts.append(eliminate_states(linear, precision, weights, residuals, model.observed, anchored))
    return parts


def _eliminate_with_drift(
    model: TrajectoryModel, field: VectorField, mesh: Mesh, states: Floats, model_error: float
) -> SchurComplement:
    """Return the normal equations of one mesh with states and drift eliminated.

    With the states plus drift, ``s = z + T b`` for the numbers b of a segment, as unknowns, measurements do not depend
    on b, and defects of ``z = s - T b`` have the derivatives ``-A T`` by it, for their derivatives A by the states: b
    are coefficients of a segment, in units of their standard deviations.
    """
    drift, width = model.latent.drift, model.width
    assert drift is not None
    linear = jacobians(field, mesh, states[:, :width])
    size = linear.coefficients.shape[2]
    basis, begins = model.drift(mesh) * drift, np.flatnonzero(mesh.first)
    by_drift = -np.matmul(linear.start, basis[:-1]) - np.matmul(linear.end, basis[1:])
    segment = np.cumsum(mesh.first) - 1
    columns = len(drift) * segment[:, np.newaxis] + np.arange(len(drift))  # Of each point among those of all segments
    wide = np.zeros((len(mesh) - 1, width, size + len(drift) * len(begins)))
    wide[:, :, :size] = linear.coefficients
    np.put_along_axis(wide, size + columns[:-1, np.newaxis], by_drift, axis=2)
    residuals = model.residuals(mesh, states)
    weights = model.observation.weights(residuals, mesh.scale)
    joint = eliminate_states(
        replace(linear, coefficients=wide),
        model.precision(mesh, model_error),
        weights,
        residuals,
        np.eye(model.equations, width),
    )
    information, gradient = joint.information.copy(), joint.gradient.copy()
    information[range(size, len(gradient)), range(size, len(gradient))] += 1
    gradient[size:] += ((states[begins, width:] - model.latent.mean) / drift).ravel()
    right = np.column_stack([information[size:, :size], gradient[size:]])
    solved = -np.linalg.solve(information[size:, size:], right)  # How the drift moves, by coefficients and at these
    moves = np.einsum("nap,pc->nac", joint.state_sensitivity[:, :, size:], solved)
    of_drift = np.einsum("nak,nkc->nac", basis, solved[columns])
    moves[:, :, :size] += joint.state_sensitivity[:, :, :size]
    moves[:, :, size] += joint.state_step
    slopes = drift[model.equations :, np.newaxis] * solved[columns][:, model.equations :]
    moves = np.concatenate([moves - of_drift, of_drift[:, : model.equations], slopes], axis=1)
    information = information[:size, :size] + information[:size, size:] @ solved[:, :size]
    gradient = gradient[:size] + joint.information[:size, size:] @ solved[:, size]
    return SchurComplement(information, gradient, moves[:, :, size], moves[:, :, :size], joint.factor)


def _step(model: TrajectoryModel, estimate: Estimate, support: Bools, model_error: float) -> Estimate | None:
    """Return the estimate after one Gauss-Newton step with backtracking; None if no step decreases the objective."""
    try:
        parts = eliminate_states_of_meshes(model, estimate, support, model_error)
        information = np.sum([part.information for part in parts], axis=0)
        gradient = np.sum([part.gradient for part in parts], axis=0)
        if model.prior is not None:
            precision = model.prior.precision[support]
            information = information + np.diag(precision)
            gradient = gradient + precision * (estimate.coefficients - model.prior.mean)[support]
        # The minimum-norm solution, scaled to a unit diagonal
        scale = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
        with np.errstate(over="ignore"):
            scaled = information / np.outer(scale, scale)
        if not np.isfinite(scaled).all():
            raise NotPositiveError
        delta = least_norm(scaled, (-gradient) / scale) / scale
    except (NotPositiveError, np.linalg.LinAlgError):
        return None
    directions = [part.state_step + part.state_sensitivity @ delta for part in parts]
    fraction = 1.0
    while fraction > SHORTEST:
        coefficients = estimate.coefficients.copy()
        coefficients[support] += fraction * delta
        moved = tuple(z + fraction * direction for z, direction in zip(estimate.states, directions, strict=True))
        candidate = _evaluated(model, Estimate(moved, coefficients), model_error)
        if candidate.objective < estimate.objective:
            return candidate
        fraction *= _SHORTER
    return None


def least_norm(matrix: Floats, right: Floats) -> Floats:
    """Return the minimum-norm solution of a finite symmetric system with unit diagonal."""
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-13)[0])
