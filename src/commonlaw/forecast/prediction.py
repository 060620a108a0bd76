"""From measured trials to forecasts: where each trial starts, and how far off its forecast may be."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.differentiation import AbstractDifferentiator, ForwardDifference, RobustSpline
from commonlaw.errors import CommonlawError
from commonlaw.forecast.initial_state import MIN_SAMPLES, FittedInitialState, can_fit_initial_state, fit_initial_state
from commonlaw.integration import InitialValueProblem, Inputs, Trajectory, simulate
from commonlaw.law import Law
from commonlaw.law.forecast import Forecast
from commonlaw.trials import Trial, Trials

_DRAWS = 200
"""Vectors of noise that show what a differentiator makes of noise."""


def predict(
    law: Law,
    trials: Trials,
    *,
    times: ArrayLike | None = None,
    start: int | None = None,
    return_std: bool = False,
    method: str = "auto",
    tolerance: float = 1e-8,
    seed: int = 0,
    input_between: str = "linear",
) -> Forecast:
    """Forecast each trial from its own initial state, see `Law.predict`."""
    _check_variables(law, trials)
    law, trials = _with_object(law, trials)
    covariance, noise = (law.uncertainty.known_covariance(), _noise_of(law)) if return_std else (None, None)
    inputs = [Inputs.of(trial.times, trial.inputs, input_between) for trial in trials]
    fitted = [_fitted_start(law, trial, own, start) for trial, own in zip(trials, inputs, strict=True)]
    unknown = [each.label for each in trials if law.order == 2 and len(each.measured()) == 1]
    note = f"zero was taken for a rate that one sample does not tell, without a band: {'; '.join(unknown)}"
    if times is not None or unknown:
        extended = [_with_times(law, trial, own, times) for trial, own in zip(trials, inputs, strict=True)]
        trials = trials.with_trials(extended, note if unknown else None)
    problems = [_problem(law, *each) for each in zip(trials, inputs, fitted, strict=True)]
    if covariance is None or noise is None:
        return Forecast(trials, simulate(problems, method=method, tolerance=tolerance))
    # By the coefficients of all objects, so that an object without one of the terms fits the covariance too
    problems = [replace(each, field=replace(each.field, free=law.support)) for each in problems]
    found = simulate(problems, method=method, tolerance=tolerance, sensitivities=True)
    deviations = []
    for trial, trajectory, own in zip(trials, found, fitted, strict=True):
        known = covariance[law.objects.index(trial.object)]
        if own is None:
            deviations.append(trajectory_std(trajectory, known, _start_covariance(law, trial.measured(), noise, seed)))
        else:
            carried, initial = own.propagated(trajectory)
            deviations.append(trajectory_std(carried, known, initial))
    # The derivatives have done their work, and are many times larger than the states
    return Forecast(trials, tuple(replace(each, sensitivities=None) for each in found), tuple(deviations), noise)


def _fitted_start(law: Law, trial: Trial, inputs: Inputs, start: int | None) -> FittedInitialState | None:
    """Return the start fitted to the first samples of a trial, or None if the first one is taken as measured."""
    measured = trial.measured()
    count = _count(law, measured, len(measured) < len(trial)) if start is None else start
    return None if min(count, len(measured)) == 1 else fit_initial_state(law, measured, inputs, count)


def _count(law: Law, trial: Trial, ahead: bool) -> int:
    """Return how many samples tell where a forecast starts, if that is left open.

    All if others are to be forecast; else the first, or those that its rate, or what it lacks, would be estimated from:
    the law knows better than a polynomial how the states move there, if it knows what the samples are worth.
    """
    if not can_fit_initial_state(law) or ahead:
        return len(trial) if ahead and can_fit_initial_state(law) else 1
    known = np.isfinite(trial.states).cumsum(axis=0).min(axis=1)
    if law.order == 2 and law.differentiation is not None:
        count = max(MIN_SAMPLES, _samples(law.differentiation, len(trial)))
        if known[:count][-1] >= MIN_SAMPLES:
            return count
    ready = known[0] and (law.order == 1 or _differentiation(law, trial) is not None)
    return 1 if ready else int(np.searchsorted(known, MIN_SAMPLES)) + 1


def _with_times(law: Law, trial: Trial, inputs: Inputs, times: ArrayLike | None) -> Trial:
    """Return a trial with samples to be forecast at more times after its first."""
    wanted = np.unique(np.asarray([] if times is None else times, dtype=np.float64))
    if not np.isfinite(wanted).all() or (law.order == 0 and len(wanted)):
        raise CommonlawError("times to forecast are finite, and laws in discrete time take none: leave them out")
    index = np.interp(wanted, trial.times, np.arange(len(trial)))
    between = (wanted > trial.times[-1]) | (abs(index - np.round(index)) > 1e-9)
    grid = np.concatenate([trial.times, wanted[between]])
    order = np.argsort(grid)
    states = np.pad(trial.states, ((0, between.sum()), (0, 0)), constant_values=np.nan)
    return replace(trial, times=grid[order], states=states[order], inputs=inputs.at(grid[order]))


def _problem(law: Law, trial: Trial, inputs: Inputs, fitted: FittedInitialState | None) -> InitialValueProblem:
    field = replace(law.vector_field(trial.object), inputs=inputs)
    initial = _measured_start(law, trial.measured()) if fitted is None else fitted.initial
    return InitialValueProblem(field, initial, trial.times, trial.label)


def _measured_start(law: Law, trial: Trial) -> Floats:
    """Return the first measured states, and the estimated rates of a law of second order, shape (width,)."""
    missing = np.isnan(trial.states)
    if missing[0].any():
        state = law.states[int(np.argmax(missing[0]))]
        whole = np.flatnonzero(~missing.any(axis=1))
        remedy = f"start the trial at sample {whole[0] + 1}, which has every state, or " if len(whole) else ""
        raise CommonlawError(
            f"{trial.label}: {state} is missing in sample 1, where the forecast starts; {remedy}fit "
            "it to the first samples with start=15"
        )
    rates = [_first_rates(law, trial, trial.states)] if law.order == 2 else []
    return np.concatenate([trial.states[0], *rates])


def _differentiation(law: Law, trial: Trial) -> AbstractDifferentiator | None:
    """Return what estimates the first rates: the law's own method, or the first that takes the samples, if any."""
    methods = law.differentiation or RobustSpline(), RobustSpline(), ForwardDifference()
    return next((each for each in methods if each.takes(trial.times, trial.states)), None)


def _first_rates(law: Law, trial: Trial, states: Floats) -> Floats:
    """Return the estimated rates of states at the trial's first sample, from shape (n, d) to (d,); zero if unknown."""
    method = _differentiation(law, trial)
    rates = None if method is None else method.differentiate(trial.times, states, 1).derivatives[0][0]
    return np.zeros(states.shape[1]) if rates is None else rates


def trajectory_std(trajectory: Trajectory, parameters: Floats, initial: Floats) -> Floats:
    """Return the standard deviation of every state of a trajectory, to first order, shape (n, states).

    From the covariances of the parameters and of the initial states, which are independent of each other; NaN where the
    trajectory has diverged.
    """
    if trajectory.sensitivities is None:
        raise CommonlawError("this trajectory has no derivatives: simulate with sensitivities=True")
    width, variances = len(initial), np.zeros(trajectory.states.shape)
    with np.errstate(all="ignore"):  # Chaos makes derivatives as large as one likes
        for derivatives, covariance in (
            (trajectory.sensitivities[:, :, :-width], parameters),
            (trajectory.sensitivities[:, :, -width:], initial),
        ):
            variances += np.sum((derivatives @ covariance) * derivatives, axis=2)
        return np.sqrt(np.maximum(variances, 0))


def _start_covariance(law: Law, trial: Trial, noise: Floats, seed: int) -> Floats:
    """Return the covariance of a trial's initial states (and rates) due to noise, shape (width, width).

    Rates are estimated once more from the measured states with noise on top, many times: with draws that are white to
    the last digit, so that this is exact for every linear differentiator. For others it is close; for medians, which
    are the odd ones, it is up to a quarter too much.
    """
    if law.order != 2:
        return np.diag(noise**2)
    method = _differentiation(law, trial)
    if method is None:
        return np.diag(np.append(noise**2, np.full(len(noise), np.nan)))
    states, samples = len(noise), _samples(method, len(trial))
    covariance = np.zeros((2 * states, 2 * states))
    for j, level in enumerate(noise):
        draws = level * _white(samples, seed)
        noisy = np.repeat(trial.states[:, j : j + 1], _DRAWS, axis=1)
        noisy[:samples] += draws
        indices = np.ix_((j, states + j), (j, states + j))
        covariance[indices] = np.cov(draws[0], _first_rates(law, trial, noisy), bias=True)
    return covariance


def _samples(differentiation: AbstractDifferentiator, count: int) -> int:
    """Return how many of the first samples the first rate can depend on; formulas at the ends reach twice as far."""
    reach = differentiation.reach(1)
    return count if reach is None else min(count, 2 * (reach + 1))


def _white(samples: int, seed: int) -> Floats:
    """Return draws of standard white noise, shape (samples, draws), centred and uncorrelated if there are enough."""
    draws = np.random.default_rng(seed).standard_normal((_DRAWS, samples))
    if samples < _DRAWS:
        draws = np.sqrt(_DRAWS) * np.linalg.qr(np.column_stack([np.ones(_DRAWS), draws]))[0][:, 1:]
    return np.asarray(draws.T)


def _noise_of(law: Law) -> Floats:
    if law.noise is None:
        raise CommonlawError(
            "this law does not know the noise of the measurements, and so not how accurate initial states are: "
            "give its noise, a standard deviation for each state"
        )
    return law.noise


def _with_object(law: Law, trials: Trials) -> tuple[Law, Trials]:
    """Return law and trials; where the trials' only object was not named, it is the only one of the law."""
    name, others = trials.objects[0], ", ".join(law.objects)
    if not trials.nameless or name in law.objects:
        return law, trials
    if len(law.objects) > 1:
        raise CommonlawError(
            f"the trials do not say of which object they are, and the law has several: say it with object_name=..., "
            f"one of {others}"
        )
    note = f"no object is named: {name} has the coefficients of {others}, the only object of the law"
    return replace(law, objects=(name,)), trials.with_trials(trials.trials, note)


def _check_variables(law: Law, trials: Trials) -> None:
    for kind, wanted, given in (
        ("states", law.schema.states, trials.schema.states),
        ("inputs", law.schema.inputs, trials.schema.inputs),
    ):
        if wanted != given:
            raise CommonlawError(
                f"the law has the {kind} {', '.join(wanted) or 'none'}, "
                f"the trials have {', '.join(given) or 'none'}; name the columns of the table as in the law"
            )
