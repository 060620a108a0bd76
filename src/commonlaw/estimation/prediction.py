"""Laws with observation equations, ``y = h(x(t; p, x0); p)``: what they predict, with derivatives and errors."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.errors import CommonlawError
from commonlaw.estimation.model import Model, ModelText, read_model
from commonlaw.estimation.problem import NormalPrior, Predicted, Problem, TrialData
from commonlaw.estimation.search import LACK_OF_FIT, Bounds, Optimum, is_solved, maximize, rough_noise, under_errors
from commonlaw.forecast.forecast import Forecast
from commonlaw.forecast.initial_state import MIN_SAMPLES, notes_of_few, notes_of_lost, samples_of_rates
from commonlaw.forecast.prediction import initial_value_problems, wanted_times, with_discrepancy, with_object
from commonlaw.integration import Inputs, Trajectory
from commonlaw.integration.problem import diverged
from commonlaw.integration.shooting import NO_INPUTS, DelayedInputs, shoot
from commonlaw.law import Law
from commonlaw.law.alignment import matched
from commonlaw.law.law import object_index
from commonlaw.law.observation import Observation
from commonlaw.law.parameters import Parameters, named_parameters, restrictions_of, state_rates
from commonlaw.law.quantiles import two_sided
from commonlaw.law.restrictions import OBJECT, Restrictions, by_trial
from commonlaw.law.uncertainty import Uncertainty
from commonlaw.library.bounds import bounds_in, limits_of
from commonlaw.runtime.forking import cached_property
from commonlaw.trials import Trial, Trials
from commonlaw.trials.transformations import number_of, starts_by, with_logarithms, with_noise
from commonlaw.trials.trial import property_names

_FIRST = 8
"""Measurements of a state from whose curve its initial rate is guessed."""


@dataclass(frozen=True, eq=False)
class ObservedLaw:
    """A law with observation equations, and its model in trials that set the initial values of some states.

    Unknowns of `predicted` are the P parameters of the model and then the D initial values.
    """

    law: Law
    model: Model
    named: Parameters

    @classmethod
    def of(
        cls,
        law: Law,
        properties: Sequence[str],
        input_interpolation: str | None = None,
        chosen: Collection[str] = (),
    ) -> "ObservedLaw":
        """Return the law for objects with these properties, where initial values of chosen states (rates) are set."""
        observation, rates = law.observation, {f"{state}'": rate for state, rate in state_rates(law)}
        measured = observation.measured
        measured = replace(measured, input_interpolation=input_interpolation or measured.input_interpolation)
        initial = {name: start for name, start in observation.initial.items() if rates.get(name, name) not in chosen}
        text = ModelText(
            law.provenance.equations,
            observation.equations,
            initial,
            events=observation.events,
            functions=observation.functions,
        )
        return cls(law, read_model(text, measured, properties), named_parameters(law))

    @property
    def observation(self) -> Observation:
        """What was measured."""
        return self.law.observation

    @cached_property
    def restrictions(self) -> Restrictions:
        """What restricts the parameters."""
        return restrictions_of(self.law)

    @cached_property
    def of_trial(self) -> list[int]:
        """The q parameters that differ between trials, by index; like initial values, each trial determines them."""
        shared = [self.restrictions.shared.get(name, OBJECT) for name in self.model.parameters]
        return [i for i, by in enumerate(shared) if by_trial(by, self.observation.measured)]

    def has_free_starts(self, trials: Trials) -> bool:
        """Return whether a trial determines an initial value or a parameter, which the law does not give."""
        return bool(self.of_trial) or any(self.model.free_in(trial) for trial in trials)

    @cached_property
    def sizes(self) -> Floats:
        """How large states and rates get, shape (D,)."""
        sizes = self.law.provenance.domain.sizes
        return np.array([sizes[name] for name in self.model.variables.states])

    def problem(self, trials: tuple[TrialData, ...], unknowns: int, priors: tuple[NormalPrior, ...] = ()) -> Problem:
        """Return the likelihood of trials."""
        logarithmic = np.array([name in self.observation.measured.logarithmic for name in self.model.observables])
        return Problem(self.model, trials, unknowns, logarithmic, self.sizes, priors)

    def parameters(self, values: Floats, properties: Mapping[str, Any]) -> Floats:
        """Return the parameters of the model from those of the law, shape (parameters,), and properties."""
        known = {**properties, **dict(zip(self.named.names, values.tolist(), strict=True))}
        return np.array([known[name] for name in self.model.parameters], dtype=np.float64)

    def beginning(self, start: Floats, std: Floats) -> tuple[Floats, Floats]:
        """Return initial values, and zeros for the parameters of a trial, with standard deviations, shape (D + q,).

        Initial values that are NaN follow from the parameters of the law, with a deviation of zero.
        """
        start, std, priors = start.copy(), std.copy(), self.restrictions.priors
        for j in np.flatnonzero(np.isnan(start)).tolist():
            start[j], std[j] = self.model.expected.get(j, (np.nan, 0.0))
        shift_std = [priors.get(self.model.parameters[i], (0.0, np.inf))[1] for i in self.of_trial]
        return np.append(start, np.zeros(len(shift_std))), np.append(std, shift_std)

    def predicted(
        self,
        name: str,
        times: Floats,
        coefficients: Floats,
        beginning: Floats,
        properties: Mapping[str, Any],
        inputs: Inputs | None,
        slopes: bool = True,
    ) -> Predicted:
        """Return a trial of an object at times, with slopes by coefficients in the support, then by its `beginning`.

        Coefficients have the shape (equations, terms). With the parameters p(c), ``dy/dc = dy/dp dp/dc``.
        """
        model, names, count = self.model, self.named.names, len(self.model.parameters)
        values = self.parameters(self.named.of(coefficients), properties)
        for shift, i in zip(beginning[model.width :], self.of_trial, strict=True):
            values[i] = self.restrictions.priors.get(model.parameters[i], (values[i], 0.0))[0] + shift
        at = self.observation.initial_time
        trial = Trial(
            name, "planned", times, np.zeros((len(times), len(model.observables)))
        )  # Not one that was measured
        free = np.isin(np.arange(model.width), model.free_of(trial))
        grid = times if at is None or starts_by(trial, at) else np.append(at, times)
        data = TrialData(
            trial,
            grid,
            np.searchsorted(grid, times),
            DelayedInputs(inputs, model.column, model.delay) if inputs else NO_INPUTS,
            np.arange(count),
            values,
            np.where(free, count + np.arange(model.width), -1),
            model.initial_of(trial),
        )
        unknowns = np.append(values, beginning[: model.width])
        prediction = self.problem((), len(unknowns)).predicted(data, unknowns, slopes)
        if prediction.slopes is None:
            return prediction
        inner = [i for i, parameter in enumerate(model.parameters) if parameter in names and i not in self.of_trial]
        by_coefficients = np.nan_to_num(self.named.slopes(coefficients[np.newaxis])[0])
        by_coefficients = by_coefficients[[names.index(model.parameters[i]) for i in inner]]
        rows = prediction.slopes[:, :, inner] @ by_coefficients
        parts = [rows, prediction.slopes[:, :, count:], prediction.slopes[:, :, self.of_trial]]
        return prediction._replace(slopes=np.concatenate(parts, axis=2))

    @cached_property
    def levels(self) -> dict[str, float]:
        """The noise of measured quantities, as far as it is known."""
        known, names = self.law.uncertainty.noise, self.observation.measured.states
        return {} if known is None else dict(zip(names, known.tolist(), strict=True))

    def noise(self, name: str) -> Floats:
        """Return the standard deviations of the measurements of an object, relative where log-scaled, shape (m,)."""
        by_object = self.law.uncertainty.noise_of
        return np.array(
            [by_object.get(quantity, {}).get(name, self.levels[quantity]) for quantity in self.model.observables]
        )


def has_free_starts(law: Law, trials: Trials) -> bool:
    """Return whether a trial determines where its forecast by a law with observation equations begins."""
    return ObservedLaw.of(law, property_names(trials.properties)).has_free_starts(trials)


def predict_observed(
    law: Law,
    trials: Trials,
    *,
    times: ArrayLike | None = None,
    start: int | Literal["all"] | None = None,
    from_time: float | None = None,
    return_std: bool = False,
    tolerance: float = 1e-8,
    input_interpolation: str | None = None,
    discrepancy: bool = False,
) -> Forecast:
    """Return what should have been measured in trials, see `Law.predict`.

    Initial values that the law does not give are estimated from the first `start` samples, or those before `from_time`,
    by maximum likelihood at the parameters of the law.

    Raises
    ------
    CommonlawError
        If something else was measured than for the law, a trial has no sample that
        initial values could be estimated from, samples are chosen for these where the law gives all, or it has no
        discrepancy that is asked for.
    """
    more, from_time = wanted_times(law, trials, times, from_time)
    trials = matched(law, trials, observed=True)
    if discrepancy:
        law, trials = with_discrepancy(law, trials)
    law, trials = with_object(law, trials)
    observation = law.observation
    if return_std:
        law.uncertainty.known_covariance()
        if law.uncertainty.noise is None:
            raise CommonlawError("noise-unknown-at-start")
    observed = ObservedLaw.of(law, property_names(trials.properties), input_interpolation)
    if (start not in (None, "all") or from_time is not None) and not observed.has_free_starts(trials):
        option = f"start={start}" if from_time is None else f"from_time={from_time:g}"
        raise CommonlawError("option-without-effect", option=option, kind="a law that gives all initial values")
    if from_time is not None:
        spans = [(trial, max([trial.times[-1], *more])) for trial in trials]
        kept = [trial for trial, last in spans if trial.times[0] < from_time <= last]
        lost = [
            f"{trial.label}, t = {trial.times[0]:g} to {last:g}"
            for trial, last in spans
            if not trial.times[0] < from_time <= last
        ]
        notes = notes_of_lost(lost, from_time, len(kept))
        trials = trials.with_trials(kept, *notes) if lost else trials
    notes = notes_of_few(trials, start, from_time)
    trials = trials.with_trials(trials.trials, *notes) if notes else trials
    shown = with_noise(with_logarithms(trials, observation.measured.logarithmic), law.uncertainty.noise_of)
    curves = [_Curve.of(observed, trials, trial, start, from_time, tolerance) for trial in shown]
    points = shown.with_trials([_with_times(trial, more) for trial in shown])
    forecast = replace(_forecast(law.uncertainty, points, curves, from_time, return_std), wanted=more)
    return forecast.as_measured(trials) if observation.measured.logarithmic else forecast


def _with_times(trial: Trial, more: Floats) -> Trial:
    """Return a trial with further samples, at which nothing was measured."""
    new = np.setdiff1d(more, trial.times)
    if not len(new):
        return trial
    if new[0] < trial.times[0]:
        raise CommonlawError("forecast-before-start", trial=trial.label, time=new[0], begins=trial.times[0])
    times = np.concatenate([trial.times, new])
    order = np.argsort(times, kind="stable")
    unknown = np.full((len(new), trial.states.shape[1]), np.nan)
    inputs = np.repeat(trial.inputs[-1:], len(new), axis=0)
    return replace(
        trial,
        times=times[order],
        states=np.concatenate([trial.states, unknown])[order],
        noise=np.concatenate([trial.noise, unknown])[order],
        below=np.concatenate([trial.below, unknown])[order],
        inputs=np.concatenate([trial.inputs, inputs])[order],
        repeats=trial.repeats and trial.repeats.placed(np.argsort(order)[: len(trial)], len(times)),
    )


@dataclass(frozen=True, eq=False)
class _Curve:
    """What should have been measured in a trial, at any times.

    Parameters
    ----------
    data, problem
        The trial, whose unknowns are all parameters and then the initial values.
    unknowns
        Their values.
    known, free
        Of these the P parameters of the law, and k that the trial determines, by index.
    parameter_covariance
        Of the parameters of the law, shape (P, P).
    covariance, sensitivity
        Of what the trial determines where these are known, shape (k, k), and how it changes with these, (k, P).
    known_until
        The time of the last sample that determined initial values.
    ends
        The unknowns with a parameter that has only a limit at that, and far beyond it.
    """

    data: TrialData
    problem: Problem
    unknowns: Floats
    known: Indices
    free: list[int]
    parameter_covariance: Floats
    covariance: Floats
    sensitivity: Floats
    known_until: float
    ends: tuple[Floats, ...]

    @classmethod
    def of(
        cls,
        observed: ObservedLaw,
        trials: Trials,
        trial: Trial,
        start: int | Literal["all"] | None,
        from_time: float | None,
        tolerance: float,
    ) -> "_Curve":
        """Return the curve whose initial values have the largest likelihood at the parameters of a law.

        Parameters that differ between trials of an object are estimated with the initial values. Of the information H
        of other parameters p and these, x: Cov(x | p) = inv(H_xx), dx/dp = -inv(H_xx) H_xp.
        """
        model, observation, named, of_trial = observed.model, observed.observation, observed.named, observed.of_trial
        index = object_index(observed.law, trial.object)
        others = [name for name in model.parameters if name not in named.names]
        properties = {name: number_of(name, trial.object, trials) for name in others}
        values, count = observed.parameters(named.values[index], properties), len(model.parameters)
        inner = [i for i, name in enumerate(model.parameters) if name in named.names]
        chosen = [named.names.index(model.parameters[i]) for i in inner]
        covariance = np.zeros((count, count))
        covariance[np.ix_(inner, inner)] = np.nan_to_num(named.covariance[index])[np.ix_(chosen, chosen)]
        free = [*of_trial, *(count + j for j in model.free_in(trial))]
        place = {index: k for k, index in enumerate(free)}
        indices = [place.get(index, -1) for index in range(count + model.width)]
        whole = TrialData.of(trial, model, observation.initial_time, indices[:count], values.tolist(), indices[count:])
        used = np.asarray((np.isfinite(trial.states) | np.isfinite(trial.below)).any(axis=1))
        if from_time is not None:
            used = used & (trial.times < from_time)
        if start is None and from_time is None:
            start = _default_start(observed, trial, used)
        if start is not None and start != "all":
            numbers = np.flatnonzero(used)
            used = np.isin(np.arange(len(trial)), numbers[-start:] if from_time is not None else numbers[:start])
        if free and not used.any():
            raise CommonlawError("trial-without-samples", trial=trial.label)
        measurements = int((np.isfinite(trial.states) | np.isfinite(trial.below))[used].sum())
        seen = whole.seen(used) if used.any() else whole
        given = observed.restrictions.priors
        known = {i: given[name] for i, name in enumerate(model.parameters) if name in given}
        known |= {count + j: prior for j, prior in model.expected.items()}
        known = {index: prior for index, prior in known.items() if index in place}
        if measurements < (unknown := len(free) - len(known)):
            raise CommonlawError("start-undetermined", trial=trial.label, unknown=unknown, measurements=measurements)
        priors = tuple(NormalPrior.of(place[index], *prior) for index, prior in known.items())
        problem = observed.problem((seen,), len(free), priors)
        rough = rough_noise(problem)
        noise = np.array([observed.levels.get(n, r) for n, r in zip(model.observables, rough, strict=True)])
        unknowns = np.concatenate([values, np.zeros(model.width)])
        if free:
            first = np.concatenate([values, observed.sizes])[free]
            names = (*model.parameters, *(f"{name}(0)" for name in model.variables.states))
            limits = np.array([limits_of(names[index], bounds_in(observed.restrictions.bounds)) for index in free])
            bounds, errors = Bounds(*limits.T), observed.law.uncertainty.error_model
            likely = _likely_starts(observed, trial, used)
            near = np.array([likely.get(names[index], np.nan) for index in free])
            optimum = _near_optimum(problem, near, bounds, noise)
            if optimum is None:
                nothing = np.zeros(len(free), dtype=np.bool_)
                optimum = maximize(problem, first, nothing, bounds, noise, 0, lambda _: None)
            if errors:
                optimum = under_errors(replace(problem, errors=errors), errors.kind, optimum, bounds)[1]
            unknowns[free] = optimum.unknowns
        fixed = np.setdiff1d(np.arange(count), of_trial)
        shifted = tuple(NormalPrior.of(index, *prior) for index, prior in known.items())
        initial = np.where(seen.initial < 0, -1, np.arange(model.width) + count)
        both = replace(seen, parameter=np.arange(count), initial=initial)
        problem = replace(observed.problem((both,), len(unknowns), shifted), tolerance=tolerance)
        rows = problem.about(unknowns, observed.law.uncertainty.error_model).information(unknowns, noise)
        inverse = np.asarray(np.linalg.pinv(rows[:, free].T @ rows[:, free]), dtype=np.float64)
        sensitivity = -inverse @ rows[:, free].T @ rows[:, fixed]
        until = float(trial.times[used][-1]) if used.any() else float(whole.times[0])
        covariance = covariance[np.ix_(fixed, fixed)]
        ends = list[Floats]()
        for limit in observed.law.uncertainty.limits:
            if limit.object == trial.object and limit.parameter in model.parameters:
                for value in (limit.value, limit.beyond):
                    end = unknowns.copy()
                    end[model.parameters.index(limit.parameter)] = value
                    ends.append(end)
        return cls(both, problem, unknowns, fixed, free, covariance, inverse, sensitivity, until, tuple(ends))

    def at(self, times: Floats, return_std: bool) -> tuple[Floats, Floats, Floats, bool]:
        """Return observables, their standard deviations, shape (n, m) each, states, shape (n, D), and if it is endless.

        Observables that are log-scaled are given by their logarithms.
        """
        grid = np.union1d(self.data.times[:1], times)
        data = replace(self.data, times=grid, rows=np.searchsorted(grid, times))
        predicted = self.problem.predicted(data, self.unknowns, return_std)
        if predicted.slopes is None:
            return predicted.values, np.zeros(predicted.values.shape), predicted.states, predicted.is_endless
        by_initial = predicted.slopes[:, :, self.free]
        by_parameters = predicted.slopes[:, :, self.known] + by_initial @ self.sensitivity
        with np.errstate(all="ignore"):
            variance = np.einsum("nmp,pq,nmq->nm", by_parameters, self.parameter_covariance, by_parameters)
            variance += np.einsum("nmp,pq,nmq->nm", by_initial, self.covariance, by_initial)
            moved = [np.abs(self.problem.predicted(data, end, False).values - predicted.values) for end in self.ends]
            variance += (np.fmax.reduce([np.zeros_like(variance), *moved]) / two_sided(0.95)) ** 2
            return predicted.values, np.sqrt(np.maximum(variance, 0.0)), predicted.states, predicted.is_endless


def _likely_starts(observed: ObservedLaw, trial: Trial, used: Bools) -> dict[str, float]:
    """Return likely initial values and parameters of a trial, by name, as far as there are some.

    They are those of the fit of the law, if the trial is one of its trials; else the first measurements of states, of
    those that are used, and the slopes there.
    """
    model, names = observed.model, observed.observation.measured.states
    result, rates = dict[str, float](), dict(state_rates(observed.law))
    for name in (name for name in names if name not in observed.observation.equations and name in model.schema.states):
        column = trial.states[:, names.index(name)]
        rows = np.flatnonzero(used & np.isfinite(column))[:_FIRST]
        if len(rows):
            values = np.exp(column[rows]) if name in observed.observation.measured.logarithmic else column[rows]
            result[f"{name}(0)"] = float(values[0])
            if name in rates and len(rows) > 1:
                times = trial.times[rows] - trial.times[rows[0]]
                result[f"{rates[name]}(0)"] = float(np.polyfit(times, values, min(2, len(rows) - 1))[-2])
    of_trial = (trial.object, trial.name)
    fitted = observed.law.trial_estimates
    return result | {
        estimate.name: estimate.value for estimate in fitted if (estimate.object, estimate.trial) == of_trial
    }


def _near_optimum(problem: Problem, near: Floats, bounds: Bounds, noise: Floats) -> Optimum | None:
    """Return the optimum to which likely first values lead; None where some are unknown, or it has a lack of fit."""
    near = np.clip(near, bounds.low, bounds.high)
    if not np.isfinite(near).all() or not is_solved(problem, near):
        return None
    known = np.ones(len(near), dtype=np.bool_)
    optimum = maximize(problem, near, known, bounds, noise, 0, lambda _: None, draws=1)
    squares = np.concatenate([part.z[part.seen] for part in problem.standardized(optimum.unknowns, noise, False)]) ** 2
    return optimum if len(squares) and np.mean(squares) < LACK_OF_FIT**2 else None


def _default_start(observed: ObservedLaw, trial: Trial, used: Bools) -> int | Literal["all"]:
    """Return how many of the used samples determine the initial values of a trial by default.

    The first one, if it has every state with an unknown initial value; else as many as have `MIN_SAMPLES` of each
    measured quantity, and at least one for each unknown, or as rates of measured states would be estimated from. All if
    later rows are forecast, or the trial has parameters.
    """
    model, free = observed.model, observed.model.free_in(trial)
    rows = np.flatnonzero(used)
    if observed.of_trial or not len(rows) or rows[-1] < len(trial) - 1:
        return "all"
    seen, names = np.isfinite(trial.states[rows]), observed.observation.measured.states
    states = [model.variables.states[j] for j in free]
    measured = [name in names and name not in observed.observation.equations for name in states]
    if all(measured) and seen[0, [names.index(name) for name in states]].all():
        return 1
    rates = dict(state_rates(observed.law))
    if {*states} <= {*names, *(rates[name] for name in names if name in rates)} - {*observed.observation.equations}:
        return samples_of_rates(observed.law, trial)
    counts = seen[:, seen.any(axis=0)].cumsum(axis=0).min(axis=1, initial=len(rows))
    return int(np.searchsorted(counts, max(MIN_SAMPLES, len(free)))) + 1


def simulate_observed(
    law: Law,
    times: ArrayLike,
    initial: ArrayLike | Mapping[str, ArrayLike],
    *,
    tolerance: float,
    doses: Mapping[str, Mapping[float, float]] | None,
    inputs: Any,
    **settings: Any,
) -> dict[str, Trajectory]:
    """Integrate a law with the events of its observation for every object, see `Law.simulate`."""
    trajectories = dict[str, Trajectory]()
    if refused := [name for name, value in settings.items() if value]:
        raise CommonlawError("simulate-with-events", settings=refused)
    observed = ObservedLaw.of(law, ())
    for name, problem in initial_value_problems(law, times, initial, doses, inputs, tolerance).items():
        driven, count = problem.field.inputs, len(law.schema.inputs)
        delayed = NO_INPUTS if driven is None else DelayedInputs(driven, tuple(range(count)), (-1,) * count)
        states, _, is_endless = shoot(
            observed.model.switched,
            observed.parameters(observed.named.values[object_index(law, name)], law.properties.get(name, {})),
            problem.initial,
            problem.times,
            observed.sizes,
            delayed,
            derivatives=False,
            tolerance=tolerance,
        )
        trajectories[name] = _trajectory(problem.times, states, is_endless, name)
    return trajectories


def _trajectory(times: Floats, values: Floats, is_endless: bool, where: str) -> Trajectory:
    """Return a trajectory that ends where its values are not finite."""
    finite = np.isfinite(values).all(axis=1)
    ended = None if finite.all() else float(times[int(np.argmin(finite))])
    reason = "events repeat infinitely often" if is_endless else "a state is not finite"
    outcome = None if ended is None else diverged(ended, reason, where, "ends" if is_endless else "ran away")
    return Trajectory(times, values, outcome, ended, method="shooting")


def _forecast(
    known: Uncertainty,
    trials: Trials,
    curves: Sequence[_Curve],
    from_time: float | None,
    return_std: bool,
    times: Sequence[Floats] = (),
) -> Forecast:
    """Return curves at the times of trials, and more of each trial, of log-scaled quantities by their logarithms."""
    if times:
        trials = trials.with_trials([_with_times(trial, time) for trial, time in zip(trials, times, strict=True)])
    predictions = [curve.at(trial.times, return_std) for trial, curve in zip(trials, curves, strict=True)]
    return Forecast(
        with_noise(trials, known.noise_of),
        tuple(
            _trajectory(trial.times, values, is_endless, trial.label)
            for trial, (values, *_, is_endless) in zip(trials, predictions, strict=True)
        ),
        tuple(std for _, std, *_ in predictions) if return_std else None,
        known.noise if return_std else None,
        from_time,
        known.error_model,
        degrees_of_freedom=known.degrees_of_freedom,
        at_more_times=partial(_forecast, known, trials, curves, from_time, return_std),
        horizons=tuple(
            np.maximum(0.0, trial.times - curve.known_until) for trial, curve in zip(trials, curves, strict=True)
        ),
        latent=tuple(states for *_, states, _ in predictions),
    )
