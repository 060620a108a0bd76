"""Forecasts by laws that err: where they start, and how far the law's own error carries them."""

from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.integration import Inputs, Trajectory
from commonlaw.law import Law
from commonlaw.law.law import object_index
from commonlaw.law.parameters import vector_field
from commonlaw.library import with_rates
from commonlaw.likelihood import (
    HUBER_THRESHOLD,
    Estimate,
    LatentProcesses,
    NotPositiveError,
    ObservationModel,
    TrajectoryModel,
    fit,
    interpolate,
    jacobians,
    meshes,
    without_states,
)
from commonlaw.trials import Trial
from commonlaw.trials.trial import with_typical

MESH_POINTS = 4
"""Points for each sampling step: the finest mesh on which laws are sought, as few samples cost little."""

MODEL_ERRORS = (1.0, 0.3, 0.1, 0.03, 0.003, 0.0003)
"""Of a law without a random walk, relative to the noise. At the first one states may stray from the law as far as
measurements do, so that a curve through these is a good guess; at the last they are a solution of it, with what forces
add: what is tolerated adds up, over all steps of a thousand samples, to a fiftieth of the noise."""


@dataclass(frozen=True, eq=False)
class FilteredStart:
    """The states at the k first samples of a trial, given these and the law.

    `states` and their standard deviations at fixed coefficients have shape (k, D); the forecast starts at the last, of
    `covariance` (D, D) and `sensitivity` (D, parameters): its derivative by the coefficients.
    """

    times: Floats
    states: Floats
    std: Floats
    covariance: Floats
    sensitivity: Floats

    @property
    def initial(self) -> Floats:
        """The state at the last of the samples, shape (D,)."""
        return np.asarray(self.states[-1])

    @property
    def begins(self) -> float:
        """When the forecast starts."""
        return float(self.times[-1])

    @property
    def known_until(self) -> float:
        """The time of the last sample that tells the start."""
        return self.begins

    def followed_by(self, trajectory: Trajectory, times: Floats) -> Trajectory:
        """Return a trajectory from this start, with the states at the times before it in front."""
        return replace(trajectory, times=times, states=self._before(self.states, times, trajectory.states))

    def std_followed_by(self, std: Floats, times: Floats) -> Floats:
        """Return standard deviations of a forecast from this start, with those before it in front."""
        return self._before(self.std, times, std)

    def _before(self, values: Floats, times: Floats, after: Floats) -> Floats:
        earlier = times[: len(times) - len(after)]
        return np.concatenate([np.column_stack([np.interp(earlier, self.times, own) for own in values.T]), after])

    def propagated(self, trajectory: Trajectory) -> tuple[Trajectory, Floats]:
        """Return a trajectory from this start whose derivatives follow the coefficients, and its covariance, (D, D)."""
        assert trajectory.sensitivities is not None
        by_own, by_start = np.split(trajectory.sensitivities, [-self.states.shape[1]], axis=2)
        with np.errstate(all="ignore"):  # Chaos makes derivatives as large as one likes
            carried = np.concatenate([by_own + by_start @ self.sensitivity, by_start], axis=2)
        return replace(trajectory, sensitivities=carried), self.covariance


def unit_of_errors(law: Law, noise: Floats, trial: Trial) -> Floats:
    """Return the unit of the model error, shape (width,): that of a rate moves the state by its noise."""
    second = with_rates(law.order, len(law.schema.states))
    return np.concatenate([noise, noise[second] / (trial.times[-1] - trial.times[0])])


def filtered_start(law: Law, trial: Trial, inputs: Inputs, guess: Floats, noise: Floats) -> FilteredStart | None:
    """Return the states at the samples of a trial under a law with errors, at fixed coefficients.

    The guess has shape (k, D); None if the likelihood cannot be computed.
    """
    errors, own = law.uncertainty.error_model, law.coefficients[object_index(law, trial.object)]
    (mesh,) = meshes([trial], MESH_POINTS, len(trial))
    (states,) = interpolate([guess], MESH_POINTS, len(trial))
    if errors.walk is None:
        unit = unit_of_errors(law, noise, trial)
    else:
        unit = errors.walk * np.sqrt(np.median(mesh.steps))
    mesh, found = mesh.with_inputs(inputs), Estimate((states,), own)
    model_errors = MODEL_ERRORS if errors.walk is None else (1.0,)
    for _ in range(errors.rounds):
        white = errors.white_std(found.states[0][:, : len(noise)], with_typical(mesh.noise, noise)) * mesh.averaging
        mesh = replace(mesh, scale=white / noise)
        model = TrajectoryModel(law.terms, (mesh,), ObservationModel(noise, HUBER_THRESHOLD), unit)
        model, start = model.with_latent(errors.latent, replace(found, states=(found.states[0][:, : len(unit)],)))
        found = fit(model, start, np.zeros(own.shape, dtype=np.bool_), model_errors)
    try:
        (reduced,) = without_states(model, found, law.support, model_errors[-1])
        variances, last = reduced.state_covariances()
    except NotPositiveError:
        return None
    if not np.isfinite(found.objective):
        return None
    inner = slice(0, model.width)
    return FilteredStart(
        trial.times,
        found.states[0][::MESH_POINTS, inner],
        np.sqrt(variances[::MESH_POINTS, inner]),
        last[inner, inner],
        reduced.state_sensitivity[-1, inner],
    )


def model_error_std(law: Law, trial: Trial, inputs: Inputs, states: Floats) -> Floats:
    """Return the standard deviation that process noise adds to a forecast from a trial's first sample, shape (n, D).

    By the linearized law; infinite from where that has no derivatives, and NaN after a divergence.
    """
    errors = law.uncertainty.error_model
    (mesh,) = meshes([trial], MESH_POINTS, len(trial))
    mesh = mesh.with_inputs(inputs)
    (between,) = interpolate([np.nan_to_num(states)], MESH_POINTS, len(trial))
    latent = LatentProcesses(force=errors.force, force_time=errors.force_time)
    steps = latent.along(mesh) if latent.width else None
    width = states.shape[1]
    field = vector_field(law, trial.object)
    with np.errstate(all="ignore"):
        linear = jacobians(field, mesh, np.pad(between, ((0, 0), (0, latent.width))), steps)
        finite = np.asarray(np.isfinite(linear.end).all(axis=(1, 2)) & np.isfinite(linear.start).all(axis=(1, 2)))
        start, end = (np.where(finite[:, np.newaxis, np.newaxis], each, 0.0) for each in (linear.start, linear.end))
        back = np.linalg.pinv(end)
        carried = -np.matmul(back, start)
        added = np.ones((len(mesh.steps), width + latent.width))
        walk = np.zeros(width) if errors.walk is None else errors.walk
        added[:, :width] = walk**2 * mesh.steps[:, np.newaxis]
        covariances = np.matmul(back * added[:, np.newaxis], back.transpose(0, 2, 1))
        own = np.zeros((width + latent.width,) * 2)
        if steps is not None:
            own[range(width, len(own)), range(width, len(own))] = steps.std**2
        variances = [np.diag(own)[:width]]
        for transition, more in zip(carried, covariances, strict=True):
            own = transition @ own @ transition.T + more
            variances.append(np.diag(own)[:width])
        followed = np.logical_and.accumulate(np.append(True, finite))[:, np.newaxis]
        std = np.sqrt(np.where(followed, variances, np.inf))[::MESH_POINTS]
        return np.where(np.isnan(states), np.nan, std)
