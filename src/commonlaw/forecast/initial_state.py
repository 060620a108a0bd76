"""Where the forecast of a trial starts, by what its first samples and the law say together."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.differentiation import RobustSpline, noise_level
from commonlaw.errors import CommonlawError
from commonlaw.forecast.model_error import MODEL_ERRORS, POINTS, FilteredStart, filtered_start, unit_of_errors
from commonlaw.integration import Inputs, Trajectory
from commonlaw.law import Law
from commonlaw.library import order_of_each, with_rates
from commonlaw.likelihood import (
    HUBER_THRESHOLD,
    Estimate,
    ObservationModel,
    TrajectoryModel,
    fit,
    interpolate,
    meshes,
)
from commonlaw.trials import Trial, Trials
from commonlaw.trials.trial import with_typical

_EXACT = 1e-4
"""Noise of a state that is exactly zero, relative to that of the state elsewhere: next to none."""

MIN_SAMPLES = 5
"""Measured values of each state that the first guess takes if it is a smoothing spline; else it is straight lines."""


@dataclass(frozen=True, eq=False)
class FittedInitialState:
    """The initial state of largest likelihood under a law whose coefficients stay as they are.

    Shape (width,), fitted to the first samples of a trial, which are worth what the observation model says.
    """

    initial: Floats
    trial: Trial
    observation_model: ObservationModel

    @property
    def begins(self) -> float:
        """When the forecast starts."""
        return float(self.trial.times[0])

    @property
    def known_until(self) -> float:
        """The time of the last sample that it was fitted to."""
        return float(self.trial.times[-1])

    def followed_by(self, trajectory: Trajectory, times: Floats) -> Trajectory:
        """Return a trajectory from this start, which lacks nothing."""
        return trajectory

    def std_followed_by(self, std: Floats, times: Floats) -> Floats:
        """Return standard deviations of a forecast from this start, which lack nothing."""
        return std

    def propagated(self, trajectory: Trajectory) -> tuple[Trajectory, Floats]:
        """Return a trajectory from this start with derivatives that let the start follow the coefficients.

        The start makes up for errors of the coefficients, as far as the samples tell. Beside it the covariance of the
        start by the noise alone, shape (width, width): the inverse of the information in the samples, NaN if the
        trajectory, which must have sensitivities, ends before they tell all of it.
        """
        assert trajectory.sensitivities is not None
        width, states = len(self.initial), self.trial.states.shape[1]
        samples = np.searchsorted(trajectory.times, self.trial.times)
        by_own, by_start = np.split(trajectory.sensitivities, [-width], axis=2)
        noise = self.observation_model.noise
        scale = self.trial.std(noise) / noise
        weights = self.observation_model.weights(self.trial.states - trajectory.states[samples, :states], scale)
        rows = np.sqrt(weights)[:, :, np.newaxis] * trajectory.sensitivities[samples, :states]
        rows = rows[np.isfinite(rows).all(axis=2)]
        # With Q R = rows of the start, the information is R' R
        basis, factor = np.linalg.qr(rows[:, -width:])
        try:
            root = np.linalg.inv(factor)
        except np.linalg.LinAlgError:
            return trajectory, np.full((width, width), np.nan)
        follow = -root @ (basis.T @ rows[:, :-width])
        with np.errstate(all="ignore"):  # Chaos makes derivatives as large as one likes
            carried = np.concatenate([by_own + by_start @ follow, by_start], axis=2)
        return replace(trajectory, sensitivities=carried), root @ root.T


Start = FittedInitialState | FilteredStart
"""Where the forecast of a trial starts, and what came before."""


def fit_initial_state(law: Law, trial: Trial, inputs: Inputs, count: int) -> Start:
    """Return the start of largest likelihood, given the noise of the law and a trial's first samples.

    The states at these are fitted as in `commonlaw.likelihood`, from a smooth curve through them to a solution of the
    law; the start is the first of them. States may be missing, in the first sample too; a trial that has fewer samples
    than the count is used whole.
    """
    noise = _noise_of(law)
    unmeasured = _unmeasured(law, trial)
    trial = _with_exact_zeros(trial.cut(count), noise)
    _check_measured(law, trial, unmeasured)
    guess = _guess(law, trial)
    if law.uncertainty.error_model:
        filtered = filtered_start(law, trial, inputs, guess, noise)
        if filtered is None:
            raise _not_finite(trial)
        return filtered
    observation_model = ObservationModel(noise, HUBER_THRESHOLD)
    (mesh,) = meshes([trial], POINTS, len(trial))
    mesh = replace(mesh.with_inputs(inputs), scale=with_typical(mesh.noise, noise) * mesh.averaging / noise)
    model = TrajectoryModel(law.terms, (mesh,), observation_model, unit_of_errors(law, noise, trial))
    own = law.coefficients_of(trial.object)
    found = fit(
        model,
        Estimate(tuple(interpolate([guess], POINTS, len(trial))), own),
        np.zeros(own.shape, dtype=np.bool_),
        MODEL_ERRORS,
    )
    if not np.isfinite(found.objective):
        raise _not_finite(trial)
    start = found.states[0][0]
    start = np.where(np.abs(start) < np.finfo(float).eps * model.unit, 0.0, start)  # At rest, with no scale of its own
    return FittedInitialState(start, trial, observation_model)


def _with_exact_zeros(trial: Trial, noise: Floats) -> Trial:
    """Return a trial in which states that are exactly zero, such as a species that is absent, have next to no noise."""
    return replace(trial, noise=np.where(trial.absent, _EXACT * noise, trial.noise)) if trial.absent.any() else trial


def _not_finite(trial: Trial) -> CommonlawError:
    return CommonlawError("initial-value-not-fitted", trial.label, samples=len(trial))


def can_fit_initial_state(law: Law) -> bool:
    """Whether the law knows what samples are worth, so that a start can be fitted to them."""
    return law.order != 0 and law.noise is not None and bool(law.noise.all())


def with_weights(law: Law, trials: Trials) -> Law:
    """Return a law whose noise weighs the samples of every state, so that starts can be fitted to them.

    Noise that the law does not know, or says is zero, is estimated from differences of neighbouring samples, and is as
    large as rounding errors at least.
    """
    known = np.zeros(len(law.states)) if law.noise is None else law.noise
    if law.order == 0 or known.all():
        return law
    largest = np.fmax.reduce(np.abs(np.concatenate([each.states for each in trials])), axis=0, initial=0.0)
    levels = [np.sqrt(np.finfo(float).eps) * np.where(largest > 0, largest, 1.0)]
    levels += [noise_level(each.times, each.states) for each in trials if each.complete]
    noise = np.where(known > 0, known, np.max(levels, axis=0))
    return replace(law, uncertainty=replace(law.uncertainty, noise=noise))


def _unmeasured(law: Law, trial: Trial) -> list[str]:
    """Return the states that were never measured in a trial in which others were: by these the law tells them."""
    measured: Bools = np.asarray(np.isfinite(trial.states).any(axis=0))
    return [name for name, own in zip(law.states, measured, strict=True) if not own] if measured.any() else []


def _guess(law: Law, trial: Trial) -> Floats:
    """Return a curve through a trial's samples: its states, and the rates of those of second order.

    A state that was not measured begins in the middle of where the law was learned from, and moves when it is fitted.
    """
    states, visited = trial.states.copy(), law.provenance.domain.visited
    for name in _unmeasured(law, trial):
        states[:, law.states.index(name)] = np.mean(visited.get(name, (0.0, 0.0)))
    return _curve(trial.times, states, with_rates(law.order, len(law.states)))


def _curve(times: Floats, states: Floats, second: Indices) -> Floats:
    measured = np.isfinite(states)
    if measured.sum(axis=0).min() >= MIN_SAMPLES:
        rates = RobustSpline().differentiate(times, states, 1)
        return np.column_stack([rates.states, rates.derivatives[0][:, second]])
    pairs = zip(measured.T, states.T, strict=True)
    lines = np.column_stack([np.interp(times, times[own], column[own]) for own, column in pairs])
    return np.column_stack([lines, *(np.gradient(lines[:, j], times) for j in second)])


def _noise_of(law: Law) -> Floats:
    """Return the noise of a law that a start can be fitted by."""
    if law.order == 0:
        raise CommonlawError("discrete-start")
    if law.noise is None or not can_fit_initial_state(law):
        lacks = "does not know the noise of the measurements" if law.noise is None else "says that a state has no noise"
        raise CommonlawError("initial-values-without-noise", lacking=lacks)
    return law.noise


def _check_measured(law: Law, trial: Trial, unmeasured: Sequence[str]) -> None:
    orders = order_of_each(law.order, len(law.states))
    for name, column, order in zip(law.states, trial.states.T, orders, strict=True):
        measured = int(np.isfinite(column).sum())
        if measured < order and name not in unmeasured:
            raise CommonlawError(
                "initial-values-too-few",
                where=trial.label,
                name=name,
                measured=measured,
                samples=len(trial),
                least=order,
            )
