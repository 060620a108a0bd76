"""Where the forecast of a trial starts, by its samples and the law, and how far the law's own error carries it."""

from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Floats, Indices
from commonlaw.differentiation import AbstractDifferentiator, ForwardDifference, RobustSpline, noise_level
from commonlaw.errors import CommonlawError
from commonlaw.integration import Inputs, Trajectory
from commonlaw.law import Law
from commonlaw.law.law import object_index
from commonlaw.law.parameters import rate_names, vector_field
from commonlaw.library import order_of_each, with_rates
from commonlaw.likelihood import (
    ErrorModel,
    Estimate,
    LatentProcesses,
    NotPositiveError,
    ObservationModel,
    TrajectoryModel,
    eliminate_states_of_meshes,
    fit,
    interpolate,
    jacobians,
    meshes,
)
from commonlaw.likelihood.levels import Deviations
from commonlaw.trials import Trial, Trials
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

    `states` and their standard deviations at fixed coefficients have shape (k, D), and their derivatives by the
    coefficients, `sensitivities`, (k, D, parameters); the forecast starts at the last, of `covariance` (D, D).
    """

    times: Floats
    states: Floats
    std: Floats
    covariance: Floats
    sensitivities: Floats

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
        """The time of the last sample that the initial state is estimated from."""
        return self.begins

    def followed_by(self, trajectory: Trajectory, times: Floats) -> Trajectory:
        """Return a trajectory from this start, with the states at the times before it in front."""
        return replace(trajectory, times=times, states=self._before(self.states, times, trajectory.states))

    def std_followed_by(self, std: Floats, times: Floats, covariance: Floats) -> Floats:
        """Return standard deviations of a forecast from this start, with those before it in front.

        These follow from the covariance of the coefficients, too, shape (parameters, parameters).
        """
        by_coefficients = np.einsum("kdp,pq,kdq->kd", self.sensitivities, covariance, self.sensitivities)
        return self._before(np.sqrt(self.std**2 + np.maximum(by_coefficients, 0.0)), times, std)

    def _before(self, values: Floats, times: Floats, after: Floats) -> Floats:
        earlier = times[: len(times) - len(after)]
        return np.concatenate([np.column_stack([np.interp(earlier, self.times, column) for column in values.T]), after])

    def propagated(self, trajectory: Trajectory) -> tuple[Trajectory, Floats]:
        """Return a trajectory from this start whose derivatives follow the coefficients, and its covariance, (D, D)."""
        return _following(trajectory, self.sensitivities[-1]), self.covariance


def _following(trajectory: Trajectory, sensitivity: Floats) -> Trajectory:
    """Return a trajectory whose start has these derivatives by the coefficients, shape (D, parameters)."""
    assert trajectory.sensitivities is not None
    by_own, by_start = np.split(trajectory.sensitivities, [-len(sensitivity)], axis=2)
    with np.errstate(all="ignore"):  # Chaos makes derivatives as large as one likes
        carried = np.concatenate([by_own + by_start @ sensitivity, by_start], axis=2)
    return replace(trajectory, sensitivities=carried)


def model_error_std(law: Law, trial: Trial, inputs: Inputs, states: Floats) -> Floats:
    """Return the standard deviation that process noise adds to a forecast from a trial's first sample, shape (n, D).

    So do inputs that jump between two samples: a time that is uniform over the interval of length h moves the states
    after it by their change of rates, times h / sqrt(12). By the linearized law; infinite from where that has no
    derivatives, and NaN after a divergence.
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
        start, end = (np.where(finite[:, np.newaxis, np.newaxis], slopes, 0.0) for slopes in (linear.start, linear.end))
        back = np.linalg.pinv(end)
        carried = -np.matmul(back, start)
        added = np.ones((len(mesh.steps), width + latent.width))
        of_object = errors.walk_of(trial.object, with_rates(law.order, len(law.schema.states)))
        walk = np.zeros(width) if of_object is None else of_object
        added[:, :width] = walk**2 * mesh.steps[:, np.newaxis]
        covariances = np.matmul(back * added[:, np.newaxis], back.transpose(0, 2, 1))
        for at, length in inputs.jumps_within:
            if (k := int(mesh.times.searchsorted(at)) - 1) >= 0 and k < len(covariances):
                both = np.array([inputs.at(np.array([time]))[0] for time in (np.nextafter(at, -np.inf), at)])
                before, after = field.derivatives(np.column_stack([between[[k, k]], both, [at, at]]))
                covariances[k, :width, :width] += np.outer(after - before, after - before) * length**2 / 12
        covariance = np.zeros((width + latent.width,) * 2)
        if steps is not None:
            covariance[range(width, len(covariance)), range(width, len(covariance))] = steps.std**2
        variances = [np.diag(covariance)[:width]]
        for transition, more in zip(carried, covariances, strict=True):
            covariance = transition @ covariance @ transition.T + more
            variances.append(np.diag(covariance)[:width])
        followed = np.logical_and.accumulate(np.append(True, finite))[:, np.newaxis]
        return np.where(np.isnan(states), np.nan, np.sqrt(np.where(followed, variances, np.inf))[::MESH_POINTS])


MIN_SAMPLES = 5
"""Measured values of each state that the first guess takes if it is a smoothing spline; else it is straight lines."""


class _AtFirstSample:
    """A start at the first sample of a forecast, whose trajectory lacks nothing."""

    def followed_by(self, trajectory: Trajectory, _: Floats) -> Trajectory:
        return trajectory

    def std_followed_by(self, std: Floats, *_: Floats) -> Floats:
        return std


@dataclass(frozen=True, eq=False)
class MeasuredStart(_AtFirstSample):
    """The first of some samples as measured, with rates that a law's differentiation estimates from all of them.

    The seed is that of the noise from which the errors of rates follow.
    """

    law: Law
    samples: Trial
    seed: int

    @property
    def begins(self) -> float:
        """When the forecast starts."""
        return float(self.samples.times[0])

    @property
    def known_until(self) -> float:
        """The time of the last sample that the initial state is estimated from."""
        return self.begins

    @property
    def initial(self) -> Floats:
        """The first measured states, and the estimated rates of those of second order, shape (width,)."""
        law, trial = self.law, self.samples
        missing = np.isnan(trial.states)
        if missing[0].any():
            state = law.schema.states[int(np.argmax(missing[0]))]
            whole = np.flatnonzero(~missing.any(axis=1))
            remedy = f"start the trial at sample {whole[0] + 1}, which has every state, or " if len(whole) else ""
            raise CommonlawError("initial-value-missing", where=trial.label, state=state, remedy=remedy)
        second = with_rates(law.order, len(law.schema.states))
        rates = [self._first_rates(trial.states)[second]] if len(second) else []
        return np.concatenate([trial.states[0], *rates])

    def propagated(self, trajectory: Trajectory) -> tuple[Trajectory, Floats]:
        """Return a trajectory from this start, and the start's covariance by the noise of samples, (width, width).

        Rates are estimated again with noise added, with draws that are exactly white: exact for linear differentiators,
        up to a quarter too large for medians.
        """
        law, trial = self.law, self.samples
        assert law.uncertainty.noise is not None
        error_model = law.uncertainty.error_model
        white = trial.std(error_model.noise_of_trial(trial, law.uncertainty.noise))
        noise = error_model.measurement_std(trial.states, white, trial.elapsed)
        second, states = with_rates(law.order, len(law.schema.states)), noise.shape[1]
        covariance = np.diag(np.append(noise[0] ** 2, np.zeros(len(second))))
        method = _differentiation(law, trial)
        if method is None or not len(second):
            covariance[range(states, len(covariance)), range(states, len(covariance))] = np.nan
            return trajectory, covariance
        samples, draws = _samples(method, len(trial)), 200
        white = np.random.default_rng(self.seed).standard_normal((draws, samples))
        if samples < draws:  # Centred and uncorrelated
            white = np.sqrt(draws) * np.linalg.qr(np.column_stack([np.ones(draws), white]))[0][:, 1:]
        for k, j in enumerate(second):
            errors = noise[:samples, j : j + 1] * white.T
            noisy = np.repeat(trial.states[:, j : j + 1], draws, axis=1)
            noisy[:samples] += errors
            indices = np.ix_((j, states + k), (j, states + k))
            covariance[indices] = np.cov(errors[0], self._first_rates(noisy), bias=True)
        return trajectory, covariance

    def _first_rates(self, states: Floats) -> Floats:
        """Return the estimated rates of states at the first sample, from shape (n, d) to (d,); zero if unknown."""
        method = _differentiation(self.law, self.samples)
        rates = None if method is None else method.differentiate(self.samples.times, states, 1).derivatives[0][0]
        return np.zeros(states.shape[1]) if rates is None else rates


@dataclass(frozen=True, eq=False)
class FittedInitialState(_AtFirstSample):
    """The maximum-likelihood initial state, shape (width,), given the first samples of a trial."""

    initial: Floats
    trial: Trial
    noise: Floats
    errors: ErrorModel
    huber_threshold: float

    @property
    def begins(self) -> float:
        """When the forecast starts."""
        return float(self.trial.times[0])

    @property
    def known_until(self) -> float:
        """The time of the last sample that it was fitted to."""
        return float(self.trial.times[-1])

    def propagated(self, trajectory: Trajectory) -> tuple[Trajectory, Floats]:
        """Return a trajectory from this start with derivatives that let the start follow the coefficients.

        With it the covariance of the start by the noise alone, shape (width, width): the inverse of the information in
        the samples, NaN if the trajectory, which must have sensitivities, ends before these determine it.
        """
        assert trajectory.sensitivities is not None
        width, states = len(self.initial), self.trial.states.shape[1]
        samples = np.searchsorted(trajectory.times, self.trial.times)
        values, slopes = trajectory.states[samples, :states], trajectory.sensitivities[samples, :states]
        deviations = Deviations(self.trial, values, slopes, values, np.zeros(values.shape, dtype=np.bool_))
        deviations = deviations.reweighted(self.noise, self.errors, self.huber_threshold)
        _, rows, *_ = deviations.whitened(self.noise, self.errors)
        assert rows is not None
        rows = rows[deviations.seen & np.isfinite(rows).all(axis=2)]
        # With Q R = rows of the start, the information is R' R
        basis, factor = np.linalg.qr(rows[:, -width:])
        try:
            root = np.linalg.inv(factor)
        except np.linalg.LinAlgError:
            return trajectory, np.full((width, width), np.nan)
        return _following(trajectory, -root @ (basis.T @ rows[:, :-width])), root @ root.T


Start = MeasuredStart | FittedInitialState | FilteredStart
"""Where the forecast of a trial starts, and what came before."""


def fit_initial_state(law: Law, trial: Trial, inputs: Inputs, count: int) -> Start:
    """Return the maximum-likelihood start, given the law and a trial's first `count` samples, or all.

    States at these are fitted as in `commonlaw.likelihood`, from a smooth curve to a solution of the law; the start is
    the first of them. States may be missing, in the first sample too.
    """
    if law.order == 0:
        raise CommonlawError("discrete-start")
    if law.uncertainty.noise is None or not can_fit_initial_state(law):
        lacks = "has no noise estimate" if law.uncertainty.noise is None else "has zero noise for a state"
        raise CommonlawError("initial-values-without-noise", lacking=lacks)
    errors, threshold = law.uncertainty.error_model, law.uncertainty.huber_threshold
    pooled, noise = law.uncertainty.noise, errors.noise_of_trial(trial, law.uncertainty.noise)
    measured = np.isfinite(trial.states).any(axis=0)
    # States that were never measured where others were follow from the law
    unmeasured = [law.schema.states[j] for j in np.flatnonzero(~measured)] if measured.any() else []
    trial = trial.cut(count)
    if trial.absent.any():  # A species that is absent is exactly zero, with next to no noise
        trial = replace(trial, noise=np.where(trial.absent, 1e-4 * noise, trial.noise))
    orders = order_of_each(law.order, len(law.schema.states))
    for name, column, order in zip(law.schema.states, trial.states.T, orders, strict=True):
        count = int(np.isfinite(column).sum())
        if count < order and name not in unmeasured:
            raise CommonlawError(
                "initial-values-too-few", where=trial.label, name=name, measured=count, samples=len(trial), least=order
            )
    # An unmeasured state begins in the middle of its range in the training data
    states, visited = trial.states.copy(), law.provenance.domain.visited
    for name in unmeasured:
        states[:, law.schema.states.index(name)] = np.mean(visited.get(name, (0.0, 0.0)))
    second = with_rates(law.order, len(law.schema.states))
    guess = _curve(trial.times, states, second)
    coefficients = law.coefficients[object_index(law, trial.object)]
    (mesh,) = meshes([trial], MESH_POINTS, len(trial))
    # A model error of this size in a rate moves the state by its noise
    unit = np.concatenate([noise, noise[second] / (trial.times[-1] - trial.times[0])])
    model_errors: tuple[float, ...] = MODEL_ERRORS
    walk = errors.walk_of(trial.object, second)
    if walk is not None:
        unit, model_errors = walk * np.sqrt(np.median(mesh.steps)), (1.0,)
    mesh = mesh.with_inputs(inputs)
    estimate = Estimate(tuple(interpolate([guess], MESH_POINTS, len(trial))), coefficients)
    for _ in range(errors.rounds):
        white = errors.white_std(estimate.states[0][:, : len(noise)], with_typical(mesh.noise, noise)) * mesh.averaging
        mesh = replace(mesh, scale=white / noise)
        model = TrajectoryModel(law.terms, (mesh,), ObservationModel(noise, threshold), unit)
        model, begun = model.with_latent(errors.latent, replace(estimate, states=(estimate.states[0][:, : len(unit)],)))
        estimate = fit(model, begun, np.zeros(coefficients.shape, dtype=np.bool_), model_errors)
    if not np.isfinite(estimate.objective):
        raise CommonlawError("initial-value-not-fitted", trial.label, samples=len(trial))
    if not errors.of_law:
        start = estimate.states[0][0, : model.width]
        # At rest, with no scale of its own
        start = np.where(np.abs(start) < np.finfo(float).eps * unit, 0.0, start)
        return FittedInitialState(start, trial, pooled, errors, threshold)
    try:
        (reduced,) = eliminate_states_of_meshes(model, estimate, law.support, model_errors[-1])
        variances, last = reduced.state_covariances()
    except NotPositiveError:
        raise CommonlawError("initial-value-not-fitted", trial.label, samples=len(trial)) from None
    inner = slice(0, model.width)
    return FilteredStart(
        trial.times,
        estimate.states[0][::MESH_POINTS, inner],
        np.sqrt(variances[::MESH_POINTS, inner]),
        last[inner, inner],
        reduced.state_sensitivity[::MESH_POINTS, inner],
    )


def can_fit_initial_state(law: Law) -> bool:
    """Whether the law has noise for every state, so that a start can be fitted to samples."""
    return law.order != 0 and law.uncertainty.noise is not None and bool(law.uncertainty.noise.all())


def with_weights(law: Law, trials: Trials) -> Law:
    """Return a law with noise for every state, so that starts can be fitted.

    Unknown or zero noise is the difference-based estimate, at least the size of rounding errors.
    """
    known = np.zeros(len(law.schema.states)) if law.uncertainty.noise is None else law.uncertainty.noise
    if law.order == 0 or known.all():
        return law
    largest = np.fmax.reduce(np.abs(np.concatenate([trial.states for trial in trials])), axis=0, initial=0.0)
    levels = [np.sqrt(np.finfo(float).eps) * np.where(largest > 0, largest, 1.0)]
    levels += [noise_level(trial.times, trial.states) for trial in trials if trial.complete]
    noise = np.where(known > 0, known, np.max(levels, axis=0))
    return replace(law, uncertainty=replace(law.uncertainty, noise=noise))


def _curve(times: Floats, states: Floats, second: Indices) -> Floats:
    measured = np.isfinite(states)
    if measured.sum(axis=0).min() >= MIN_SAMPLES:
        rates = RobustSpline().differentiate(times, states, 1)
        return np.column_stack([rates.states, rates.derivatives[0][:, second]])
    pairs = zip(measured.T, states.T, strict=True)
    lines = np.column_stack([np.interp(times, times[seen], column[seen]) for seen, column in pairs])
    return np.column_stack([lines, *(np.gradient(lines[:, j], times) for j in second)])


@dataclass(frozen=True, eq=False)
class StartedTrial:
    """A trial with all times that are forecast, its inputs, known at any time, and where its forecast starts."""

    trial: Trial
    inputs: Inputs
    start: Start

    @property
    def ahead(self) -> Trial:
        """The rows of the trial from the time of the initial state on."""
        first = int(np.searchsorted(self.trial.times, self.start.begins))
        return self.trial.rows(slice(first, None)) if first else self.trial


def default_start(law: Law, trial: Trial, ahead: bool) -> int:
    """Return how many samples determine where a forecast starts, by default.

    All if other trials are to be forecast; else the first, or, if the law has noise, those that its rate, or what it
    lacks, would be estimated from.
    """
    if not can_fit_initial_state(law) or ahead:
        return len(trial) if ahead and can_fit_initial_state(law) else 1
    is_known = np.isfinite(trial.states)
    known = is_known[:, ~law.schema.is_latent].cumsum(axis=0).min(axis=1)
    if rate_names(law) and law.provenance.differentiation is not None:
        count = max(MIN_SAMPLES, _samples(law.provenance.differentiation, len(trial)))
        if known[:count][-1] >= MIN_SAMPLES:
            return count
    ready = is_known[0].all() and (not rate_names(law) or _differentiation(law, trial) is not None)
    return 1 if ready else int(np.searchsorted(known, MIN_SAMPLES)) + 1


def samples_of_rates(law: Law, trial: Trial) -> int:
    """Return how many of the first samples of a trial the rates at its start would be estimated from."""
    method = _differentiation(law, trial)
    return MIN_SAMPLES if method is None else max(MIN_SAMPLES, _samples(method, len(trial)))


def _differentiation(law: Law, trial: Trial) -> AbstractDifferentiator | None:
    """Return what estimates the first rates: the law's own method, or the first that takes the samples, if any."""
    methods = law.provenance.differentiation or RobustSpline(), RobustSpline(), ForwardDifference()
    return next((method for method in methods if method.takes(trial.times, trial.states)), None)


def _samples(differentiation: AbstractDifferentiator, count: int) -> int:
    """Return how many of the first samples the first rate can depend on; formulas at the ends reach twice as far."""
    reach = differentiation.reach(1)
    return count if reach is None else min(count, 2 * (reach + 1))
