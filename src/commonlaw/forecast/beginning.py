"""Where the forecasts of trials begin: at which sample, in which state, and how well that is known."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.diagnostics import Diagnostic, marked
from commonlaw.differentiation import AbstractDifferentiator, ForwardDifference, RobustSpline
from commonlaw.errors import CommonlawError
from commonlaw.forecast.initial_state import MIN_SAMPLES, Start, can_fit_initial_state, fit_initial_state, with_weights
from commonlaw.integration import Inputs
from commonlaw.law import Law
from commonlaw.library import with_rates
from commonlaw.trials import Trial, Trials
from commonlaw.wording import shown

_DRAWS = 200
"""Vectors of noise that show what a differentiator makes of noise."""
_MOST = 500
"""Samples before a time that tell a start: those before them add little, and take long."""


@dataclass(frozen=True, eq=False)
class Beginning:
    """Where the forecast of one trial begins.

    Parameters
    ----------
    trial
        At whose times to forecast.
    inputs
        At any time.
    start_samples
        The samples that tell the initial state.
    fitted
        The initial state that is fitted to them, or None for the first of them as measured.
    """

    trial: Trial
    inputs: Inputs
    start_samples: Trial
    fitted: Start | None

    @property
    def ahead(self) -> Trial:
        """The rows of the trial from the time of the initial state on."""
        begins = self.trial.times[0] if self.fitted is None else self.fitted.begins
        first = int(np.searchsorted(self.trial.times, begins))
        return self.trial.rows(slice(first, None)) if first else self.trial

    @property
    def known_until(self) -> float:
        """The time of the last sample that tells the initial state."""
        return float(self.start_samples.times[0]) if self.fitted is None else self.fitted.known_until

    def initial(self, law: Law) -> Floats:
        """Return the initial state, shape (width,)."""
        return _measured_start(law, self.start_samples) if self.fitted is None else self.fitted.initial


def begin(
    law: Law,
    trials: Trials,
    times: ArrayLike | None,
    start: int | Literal["all"] | None,
    from_time: float | None,
    input_between: str | None,
) -> tuple[Trials, list[Beginning]]:
    """Return the trials that can be forecast, with samples at all times that are wanted, and where each begins."""
    wanted = np.unique(np.asarray([] if times is None else times, dtype=np.float64))
    if not np.isfinite(wanted).all() or (law.order == 0 and len(wanted)):
        raise CommonlawError("forecast-times")
    if isinstance(start, str) and start != "all":
        raise CommonlawError("forecast-start", start=start)
    if isinstance(start, int) and start < 1:
        raise CommonlawError("forecast-start-count", start=start)
    if start == "all":
        law, start = with_weights(law, trials), max(map(len, trials))
    if from_time is not None and not np.isfinite(from_time):
        raise CommonlawError("forecast-from-time", from_time=from_time)
    found, lost = [], []
    for trial in trials:
        inputs = Inputs.of(trial.times, trial.inputs, input_between or law.schema.input_between)
        extended = with_times(trial, inputs, wanted) if len(wanted) else trial
        if from_time is None:
            found.append(Beginning(extended, inputs, trial.measured(), _fitted_start(law, trial, inputs, start)))
        elif trial.times[0] < from_time <= extended.times[-1]:
            found.append(_begin_later(law, trial, extended, inputs, start, from_time))
        else:
            lost.append(f"{trial.label}, t = {trial.times[0]:g} to {extended.times[-1]:g}")
    why = Diagnostic("no-samples-around", {"from_time": from_time, "trials": shown(lost)})
    if not found:
        raise CommonlawError("forecast-no-trial", reason=why)
    notes = [f"trials not forecast {why.sentence(marked)}"] if lost else []
    unknown = [each.start_samples.label for each in found if law.rates and len(each.start_samples) == 1]
    if unknown:
        notes.append(f"zero was taken for a rate that one sample does not tell, without a band: {'; '.join(unknown)}")
    # Trials that are forecast as they are stay the same
    kept = [each.trial for each in found]
    trials = trials if kept == list(trials) else trials.with_trials(kept)
    return (replace(trials, notes=(*trials.notes, *notes)) if notes else trials), found


def _fitted_start(law: Law, trial: Trial, inputs: Inputs, start: int | None) -> Start | None:
    """Return the start fitted to the first samples of a trial, or None if the first one is taken as measured."""
    measured = trial if law.schema.doses else trial.measured()
    count = _count(law, measured, len(measured) < len(trial)) if start is None else start
    return None if min(count, len(measured)) == 1 else fit_initial_state(law, measured, inputs, count)


def _begin_later(
    law: Law, trial: Trial, extended: Trial, inputs: Inputs, start: int | None, from_time: float
) -> Beginning:
    """Return the beginning at the last samples before a time: so many as are asked for, else as can be fitted."""
    measured = trial.measured()
    stop = int(np.searchsorted(measured.times, from_time))
    fits = can_fit_initial_state(law)
    count = start or (min(stop, _MOST) if fits else MIN_SAMPLES if law.rates else 1)
    start_samples = measured.rows(slice(max(0, stop - count), stop))
    first = int(np.searchsorted(extended.times, start_samples.times[0]))
    fitted = None
    if (start or fits) and len(start_samples) > 1:
        if law.schema.doses:  # Which are given where nothing was measured
            begins, ends = np.searchsorted(trial.times, start_samples.times[[0, -1]])
            start_samples = trial.rows(slice(begins, ends + 1))
        fitted = fit_initial_state(law, start_samples, inputs, len(start_samples))
    return Beginning(extended.rows(slice(first, None)), inputs, start_samples, fitted)


def _count(law: Law, trial: Trial, ahead: bool) -> int:
    """Return how many samples tell where a forecast starts, if that is left open.

    All if others are to be forecast; else the first, or those that its rate, or what it lacks, would be estimated from:
    the law knows better than a polynomial how the states move there, if it knows what the samples are worth.
    """
    if not can_fit_initial_state(law) or ahead:
        return len(trial) if ahead and can_fit_initial_state(law) else 1
    is_known = np.isfinite(trial.states)
    known = is_known[:, ~law.schema.unmeasured].cumsum(axis=0).min(axis=1)
    if law.rates and law.differentiation is not None:
        count = max(MIN_SAMPLES, _samples(law.differentiation, len(trial)))
        if known[:count][-1] >= MIN_SAMPLES:
            return count
    ready = is_known[0].all() and (not law.rates or _differentiation(law, trial) is not None)
    return 1 if ready else int(np.searchsorted(known, MIN_SAMPLES)) + 1


def with_times(trial: Trial, inputs: Inputs, wanted: Floats) -> Trial:
    """Return a trial with samples to be forecast at more times after its first.

    Between samples their standard deviations lie on straight lines.
    """
    index = np.interp(wanted, trial.times, np.arange(len(trial)))
    between = (wanted > trial.times[-1]) | (abs(index - np.round(index)) > 1e-9)
    grid = np.concatenate([trial.times, wanted[between]])
    order = np.argsort(grid)
    states = np.pad(trial.states, ((0, between.sum()), (0, 0)), constant_values=np.nan)
    noise = [np.interp(grid[order], trial.times, column, right=np.nan) for column in trial.noise.T]
    rows = np.flatnonzero(order < len(trial))
    return replace(
        trial,
        times=grid[order],
        states=states[order],
        inputs=inputs.at(grid[order]),
        noise=np.stack(noise, axis=1),
        repeats=trial.repeats and trial.repeats.placed(rows, len(grid)),
    )


def _measured_start(law: Law, trial: Trial) -> Floats:
    """Return the first measured states, and the estimated rates of those of second order, shape (width,)."""
    missing = np.isnan(trial.states)
    if missing[0].any():
        state = law.states[int(np.argmax(missing[0]))]
        whole = np.flatnonzero(~missing.any(axis=1))
        remedy = f"start the trial at sample {whole[0] + 1}, which has every state, or " if len(whole) else ""
        raise CommonlawError("initial-value-missing", where=trial.label, state=state, remedy=remedy)
    second = with_rates(law.order, len(law.states))
    rates = [_first_rates(law, trial, trial.states)[second]] if len(second) else []
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


def start_covariance(law: Law, trial: Trial, noise: Floats, seed: int) -> Floats:
    """Return the covariance of a trial's initial states (and rates) due to noise, shape (width, width).

    The noise is that of each sample, shape (n, states).

    Rates are estimated once more from the measured states with noise on top, many times: with draws that are white to
    the last digit, so that this is exact for every linear differentiator. For others it is close; for medians, which
    are the odd ones, it is up to a quarter too much.
    """
    second = with_rates(law.order, len(law.states))
    if not len(second):
        return np.diag(noise[0] ** 2)
    method = _differentiation(law, trial)
    if method is None:
        return np.diag(np.append(noise[0] ** 2, np.full(len(second), np.nan)))
    states, samples = noise.shape[1], _samples(method, len(trial))
    covariance = np.diag(np.append(noise[0] ** 2, np.zeros(len(second))))
    for k, j in enumerate(second):
        draws = noise[:samples, j : j + 1] * _white(samples, seed)
        noisy = np.repeat(trial.states[:, j : j + 1], _DRAWS, axis=1)
        noisy[:samples] += draws
        indices = np.ix_((j, states + k), (j, states + k))
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
