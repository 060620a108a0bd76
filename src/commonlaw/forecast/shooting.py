"""Laws with observation equations, ``y = h(x(t; p, x0); p)``: what they predict, with derivatives and errors."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.errors import CommonlawError
from commonlaw.estimation.model import Model, ModelText, read_model
from commonlaw.estimation.problem import NormalPrior, Problem, TrialData
from commonlaw.estimation.search import LACK_OF_FIT, Bounds, Optimum, is_solved, maximize, rough_noise, under_errors
from commonlaw.forecast.initial_state import MIN_SAMPLES, samples_of_rates
from commonlaw.forecast.scheme import (
    PLANNED_TOLERANCE,
    WITHOUT_DRAWS,
    AbstractScheme,
    AbstractStarted,
    Extended,
    Followed,
    ForecastOptions,
    Measured,
    PlannedTrial,
    Solved,
    measurement_errors,
    refuse_method,
)
from commonlaw.formulation import inverse_information
from commonlaw.integration import Inputs, Trajectory
from commonlaw.integration.problem import diverged
from commonlaw.integration.shooting import NO_INPUTS, DelayedInputs
from commonlaw.law import Law
from commonlaw.law.law import object_index
from commonlaw.law.observation import Observation
from commonlaw.law.parameters import Parameters, named_parameters, restrictions_of, state_rates
from commonlaw.law.quantiles import two_sided
from commonlaw.law.restrictions import OBJECT, Restrictions, by_trial
from commonlaw.library.bounds import bounds_in, limits_of
from commonlaw.likelihood.outliers import capped
from commonlaw.runtime.forking import cached_property
from commonlaw.trials import Trial, Trials
from commonlaw.trials.transformations import number_of, starts_by, with_logarithms, with_noise

_FIRST = 8
"""Measurements of a state from whose curve its initial rate is guessed."""


@dataclass(frozen=True, eq=False)
class Shooting(AbstractScheme):
    """A law with observation equations, and its model in trials that set the initial values of some states."""

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
    ) -> "Shooting":
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

    def free_starts(self, trial: Trial) -> int:
        return len(self.of_trial) + len(self.model.free_in(trial))

    def check(self, options: ForecastOptions) -> None:
        refuse_method(options.method, "a law with observation equations")
        if options.seed is not None:
            raise CommonlawError("option-without-effect", option=f"seed={options.seed}", kind=WITHOUT_DRAWS)

    def taken(self, trials: Trials) -> Trials:
        return with_noise(with_logarithms(trials, self.observation.measured.logarithmic), self.law.uncertainty.noise_of)

    def begin(self, trials: Trials, extended: Sequence[Extended], options: ForecastOptions) -> AbstractStarted:
        """Return trials whose initial values have the largest likelihood at the parameters of the law."""
        curves = [
            _Curve.of(self, trials, trial, options.start, options.from_time, options.tolerance)
            for trial, *_ in extended
        ]
        return _Started(self.law, trials, extended, curves, options.return_std)

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
        start, std, priors = start.copy(), std.copy(), self.restrictions.priors
        for j in np.flatnonzero(np.isnan(start)).tolist():
            start[j], std[j] = self.model.expected.get(j, (np.nan, 0.0))
        shift_std = [priors.get(self.model.parameters[i], (0.0, np.inf))[1] for i in self.of_trial]
        return np.append(start, np.zeros(len(shift_std))), np.append(std, shift_std)

    @property
    def shown(self) -> tuple[str, ...]:
        return self.model.observables

    def followed(self, trials: Sequence[PlannedTrial], slopes: bool, limit: float | None = None) -> list[Followed]:
        return [self._followed(trial, slopes, limit) for trial in trials]

    def _followed(self, planned: PlannedTrial, slopes: bool, limit: float | None) -> Followed:
        """Return the solution in a trial; with the parameters p(c), ``dy/dc = dy/dp dp/dc``."""
        model, names, count = self.model, self.named.names, len(self.model.parameters)
        times, beginning, coefficients = planned.times, planned.beginning, planned.coefficients
        values = self.parameters(self.named.of(coefficients), planned.properties)
        for shift, i in zip(beginning[model.width :], self.of_trial, strict=True):
            values[i] = self.restrictions.priors.get(model.parameters[i], (values[i], 0.0))[0] + shift
        at = self.observation.initial_time
        trial = Trial(
            planned.object, "planned", times, np.zeros((len(times), len(model.observables)))
        )  # Not one that was measured
        free = np.isin(np.arange(model.width), model.free_of(trial))
        grid = times if at is None or starts_by(trial, at) else np.append(at, times)
        data = TrialData(
            trial,
            grid,
            np.searchsorted(grid, times),
            DelayedInputs(planned.inputs, model.column, model.delay) if planned.inputs else NO_INPUTS,
            np.arange(count),
            values,
            np.where(free, count + np.arange(model.width), -1),
            model.initial_of(trial),
        )
        unknowns = np.append(values, beginning[: model.width])
        problem = replace(self.problem((), len(unknowns)), tolerance=PLANNED_TOLERANCE)
        predicted = problem.predicted(data, unknowns, slopes)
        followed, by_unknowns = Followed(times, predicted.states), predicted.slopes
        too_far = limit is not None and bool(np.abs(predicted.states).max() > limit)
        if by_unknowns is None or too_far:
            return followed
        # Logarithms of states that are zero, as before a dose, are not measured
        unseen = np.isinf(predicted.values) & np.isfinite(predicted.states).all(axis=1, keepdims=True)
        by_unknowns = np.where(unseen[:, :, np.newaxis], 0.0, by_unknowns)
        if not np.isfinite(by_unknowns).all():
            return followed
        inner = [i for i, parameter in enumerate(model.parameters) if parameter in names and i not in self.of_trial]
        by_coefficients = np.nan_to_num(self.named.slopes(coefficients[np.newaxis])[0])
        by_coefficients = by_coefficients[[names.index(model.parameters[i]) for i in inner]]
        rows = by_unknowns[:, :, inner] @ by_coefficients
        parts = [rows, by_unknowns[:, :, count:], by_unknowns[:, :, self.of_trial]]
        return followed._replace(values=np.where(unseen, 0.0, predicted.values), slopes=np.concatenate(parts, axis=2))

    def measured(self, name: str, followed: Followed) -> Measured | None:
        times, _, values, slopes = followed
        if values is None or slopes is None:
            return None
        by_coefficients, by_start = np.split(slopes, [int(self.law.support.sum())], axis=2)
        errors = measurement_errors(self.law.uncertainty.error_model, self.noise(name), times, values)
        return Measured(values, by_coefficients, by_start, *errors)

    @cached_property
    def levels(self) -> dict[str, float]:
        """The noise of measured quantities, as far as it is known."""
        known, names = self.law.uncertainty.noise, self.observation.measured.states
        return {} if known is None else dict(zip(names, known.tolist(), strict=True))

    def noise(self, name: str) -> Floats:
        """Return the standard deviations of the measurements of an object, relative where log-scaled, shape (m,)."""
        given = self.law.uncertainty.noise_of
        levels = [given.get(quantity, {}).get(name, self.levels[quantity]) for quantity in self.model.observables]
        return self.law.uncertainty.error_model.noise_of(name, np.array(levels))


@dataclass(frozen=True, eq=False)
class _Started(AbstractStarted):
    """Trials with their curves."""

    law: Law
    trials: Trials
    extended: Sequence[Extended]
    curves: Sequence["_Curve"]
    return_std: bool

    @property
    def inputs(self) -> list[Inputs]:
        return [inputs for *_, inputs in self.extended]

    @property
    def known_until(self) -> list[float]:
        return [curve.known_until for curve in self.curves]

    def solved(self, trials: Sequence[Trial]) -> list[Solved]:
        pairs = zip(trials, self.curves, strict=True)
        return [curve.solved(trial, self.return_std) for trial, curve in pairs]


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
        scheme: Shooting,
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
        model, observation, named, of_trial = scheme.model, scheme.observation, scheme.named, scheme.of_trial
        index = object_index(scheme.law, trial.object)
        others = [name for name in model.parameters if name not in named.names]
        properties = {name: number_of(name, trial.object, trials) for name in others}
        values, count = scheme.parameters(named.values[index], properties), len(model.parameters)
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
            start = _default_start(scheme, trial, used)
        if start is not None and start != "all":
            numbers = np.flatnonzero(used)
            used = np.isin(np.arange(len(trial)), numbers[-start:] if from_time is not None else numbers[:start])
        if free and not used.any():
            raise CommonlawError("trial-without-samples", trial=trial.label)
        measurements = int((np.isfinite(trial.states) | np.isfinite(trial.below))[used].sum())
        seen = whole.seen(used) if used.any() else whole
        given = scheme.restrictions.priors
        known = {i: given[name] for i, name in enumerate(model.parameters) if name in given}
        known |= {count + j: prior for j, prior in model.expected.items()}
        known = {index: prior for index, prior in known.items() if index in place}
        if measurements < (unknown := len(free) - len(known)):
            raise CommonlawError("start-undetermined", trial=trial.label, unknown=unknown, measurements=measurements)
        priors = tuple(NormalPrior.of(place[index], *prior) for index, prior in known.items())
        problem = scheme.problem((seen,), len(free), priors)
        threshold = np.inf if problem.censored.any() else scheme.law.uncertainty.huber_threshold
        problem = replace(problem, huber_threshold=threshold)
        rough = rough_noise(problem)
        noise = np.array([scheme.levels.get(n, r) for n, r in zip(model.observables, rough, strict=True)])
        unknowns = np.concatenate([values, np.zeros(model.width)])
        if free:
            first = np.concatenate([values, scheme.sizes])[free]
            names = (*model.parameters, *(f"{name}(0)" for name in model.variables.states))
            limits = np.array([limits_of(names[index], bounds_in(scheme.restrictions.bounds)) for index in free])
            bounds, errors = Bounds(*limits.T), scheme.law.uncertainty.error_model
            likely = _likely_starts(scheme, trial, used)
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
        problem = scheme.problem((both,), len(unknowns), shifted)
        problem = replace(problem, tolerance=tolerance, huber_threshold=threshold)
        rows = problem.about(unknowns, noise, scheme.law.uncertainty.error_model).information(unknowns, noise)
        inverse = inverse_information(rows[:, free])
        sensitivity = -inverse @ rows[:, free].T @ rows[:, fixed]
        until = float(trial.times[used][-1]) if used.any() else float(whole.times[0])
        covariance = covariance[np.ix_(fixed, fixed)]
        ends = list[Floats]()
        for limit in scheme.law.uncertainty.limits:
            if limit.object == trial.object and limit.parameter in model.parameters:
                for value in (limit.value, limit.beyond):
                    end = unknowns.copy()
                    end[model.parameters.index(limit.parameter)] = value
                    ends.append(end)
        return cls(both, problem, unknowns, fixed, free, covariance, inverse, sensitivity, until, tuple(ends))

    def solved(self, trial: Trial, return_std: bool) -> Solved:
        """Return the solution at the samples of a trial."""
        grid = np.union1d(self.data.times[:1], trial.times)
        data = replace(self.data, times=grid, rows=np.searchsorted(grid, trial.times))
        predicted = self.problem.predicted(data, self.unknowns, return_std)
        values, is_measured = predicted.values, np.isfinite(trial.states)
        # The logarithm of a state that is zero, as before a dose, is a fault where it was measured alone
        judged = np.where(np.isinf(values) & ~is_measured, 0.0, values)
        finite = np.asarray(np.isfinite(np.column_stack([predicted.states, judged])).all(axis=1))
        trajectory = trajectory_of(trial.times, values, finite, predicted.is_endless, trial.label)
        if not return_std:
            return Solved(trajectory, None, predicted.states)
        if predicted.slopes is None:
            return Solved(trajectory, np.zeros(predicted.values.shape), predicted.states)
        by_initial = predicted.slopes[:, :, self.free]
        by_parameters = predicted.slopes[:, :, self.known] + by_initial @ self.sensitivity
        with np.errstate(all="ignore"):
            variance = np.einsum("nmp,pq,nmq->nm", by_parameters, self.parameter_covariance, by_parameters)
            variance += np.einsum("nmp,pq,nmq->nm", by_initial, self.covariance, by_initial)
            moved = [np.abs(self.problem.predicted(data, end, False).values - predicted.values) for end in self.ends]
            variance += (np.fmax.reduce([np.zeros_like(variance), *moved]) / two_sided(0.95)) ** 2
        return Solved(trajectory, np.sqrt(np.maximum(variance, 0.0)), predicted.states)


def _likely_starts(scheme: Shooting, trial: Trial, used: Bools) -> dict[str, float]:
    """Return likely initial values and parameters of a trial, by name, as far as there are some.

    They are those of the fit of the law, if the trial is one of its trials; else the first measurements of states, of
    those that are used, and the slopes there.
    """
    model, names = scheme.model, scheme.observation.measured.states
    result, rates = dict[str, float](), dict(state_rates(scheme.law))
    for name in (name for name in names if name not in scheme.observation.equations and name in model.schema.states):
        column = trial.states[:, names.index(name)]
        rows = np.flatnonzero(used & np.isfinite(column))[:_FIRST]
        if len(rows):
            values = np.exp(column[rows]) if name in scheme.observation.measured.logarithmic else column[rows]
            result[f"{name}(0)"] = float(values[0])
            if name in rates and len(rows) > 1:
                times = trial.times[rows] - trial.times[rows[0]]
                result[f"{rates[name]}(0)"] = float(np.polyfit(times, values, min(2, len(rows) - 1))[-2])
    of_trial = (trial.object, trial.name)
    fitted = scheme.law.trial_estimates
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
    parts = problem.standardized(optimum.unknowns, noise, False)
    squares = np.concatenate([capped(part.z[part.seen], problem.huber_threshold) for part in parts])
    return optimum if len(squares) and np.mean(squares) < LACK_OF_FIT**2 else None


def _default_start(scheme: Shooting, trial: Trial, used: Bools) -> int | Literal["all"]:
    """Return how many of the used samples determine the initial values of a trial by default.

    The first one, if it has every state with an unknown initial value; else as many as have `MIN_SAMPLES` of each
    measured quantity, and at least one for each unknown, or as rates of measured states would be estimated from. All if
    later rows are forecast, or the trial has parameters.
    """
    model, free = scheme.model, scheme.model.free_in(trial)
    rows = np.flatnonzero(used)
    if scheme.of_trial or not len(rows) or rows[-1] < len(trial) - 1:
        return "all"
    seen, names = np.isfinite(trial.states[rows]), scheme.observation.measured.states
    states = [model.variables.states[j] for j in free]
    measured = [name in names and name not in scheme.observation.equations for name in states]
    if all(measured) and seen[0, [names.index(name) for name in states]].all():
        return 1
    rates = dict(state_rates(scheme.law))
    if {*states} <= {*names, *(rates[name] for name in names if name in rates)} - {*scheme.observation.equations}:
        return samples_of_rates(scheme.law, trial)
    counts = seen[:, seen.any(axis=0)].cumsum(axis=0).min(axis=1, initial=len(rows))
    return int(np.searchsorted(counts, max(MIN_SAMPLES, len(free)))) + 1


def trajectory_of(times: Floats, values: Floats, finite: Bools, is_endless: bool, where: str) -> Trajectory:
    """Return a trajectory of values, shape (n, m), that ends where the solution is not finite, shape (n,)."""
    ended = None if finite.all() else float(times[int(np.argmin(finite))])
    reason = "events repeat infinitely often" if is_endless else "a state is not finite"
    outcome = None if ended is None else diverged(ended, reason, where, "ends" if is_endless else "ran away")
    return Trajectory(times, values, outcome, ended, method="shooting")
