"""Fitted curves and forecasts of what was measured, by a law with an observation."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.errors import CommonlawError
from commonlaw.estimation.model import Model, ModelText, read_model
from commonlaw.estimation.problem import NormalPrior, Problem, TrialData
from commonlaw.estimation.search import Bounds, maximize, rough_noise
from commonlaw.forecast.forecast import Forecast
from commonlaw.forecast.prediction import initial_value_problems, with_discrepancy
from commonlaw.integration import Trajectory
from commonlaw.integration.problem import diverged
from commonlaw.integration.shooting import NO_INPUTS, DelayedInputs, shoot
from commonlaw.law import Law
from commonlaw.law.alignment import matched, matched_times
from commonlaw.law.law import object_index
from commonlaw.law.observation import OBJECT, Observation, Restrictions, by_trial
from commonlaw.law.parameters import named_parameters
from commonlaw.library.bounds import bounds_in, limits_of
from commonlaw.trials import Trial, Trials
from commonlaw.trials.transformations import number_of, with_logarithms, with_noise
from commonlaw.trials.trial import property_names


def predict_observed(
    law: Law,
    trials: Trials,
    *,
    times: ArrayLike | None = None,
    start: int | Literal["all"] | None = None,
    from_time: float | None = None,
    return_std: bool = False,
    input_interpolation: str | None = None,
    discrepancy: bool = False,
) -> Forecast:
    """Return what should have been measured in trials, see `Law.predict`.

    Initial values that the law does not give are estimated from the first `start` samples, those before `from_time`, or
    by default all of them, by maximum likelihood at the parameters of the law.

    Raises
    ------
    CommonlawError
        If something else was measured than for the law, an object is not one of the law, a trial has no sample that
        initial values could be estimated from, or the law has no discrepancy that is asked for.
    """
    times = matched_times(law, trials, times)
    if from_time is not None:
        from_time = float(np.asarray(matched_times(law, trials, from_time)))
    trials = matched(law, trials, observed=True)
    if discrepancy:
        law, trials = with_discrepancy(law, trials)
    observation = law.observation
    assert observation is not None
    for name in trials.objects:
        object_index(law, name)
    measured = replace(
        observation.measured, input_interpolation=input_interpolation or observation.measured.input_interpolation
    )
    model = read_model(_text(law, observation), measured, property_names(trials.properties))
    more = np.zeros(0) if times is None else np.atleast_1d(np.asarray(times, dtype=np.float64))
    shown = with_noise(with_logarithms(trials, measured.logarithmic), observation.noise_of)
    curves = [_Curve.of(law, observation, model, trials, trial, start, from_time) for trial in shown]
    points = shown.with_trials([_with_times(trial, more) for trial in shown])
    forecast = _Curves(observation, points, curves, from_time, return_std).forecast()
    return forecast.as_measured(trials) if measured.logarithmic else forecast


def _text(law: Law, observation: Observation) -> ModelText:
    return ModelText(
        law.provenance.equations,
        observation.equations,
        observation.initial,
        events=observation.events,
        functions=observation.functions,
    )


def _with_times(trial: Trial, more: Floats) -> Trial:
    """Return a trial with further samples, at which nothing was measured."""
    new = np.setdiff1d(more, trial.times)
    if not len(new):
        return trial
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

    @classmethod
    def of(
        cls,
        law: Law,
        observation: Observation,
        model: Model,
        trials: Trials,
        trial: Trial,
        start: int | Literal["all"] | None,
        from_time: float | None,
    ) -> "_Curve":
        """Return the curve whose initial values have the largest likelihood at the parameters of a law.

        Parameters that differ between trials of an object are estimated with the initial values. Of the information H
        of other parameters p and these, x: Cov(x | p) = inv(H_xx), dx/dp = -inv(H_xx) H_xp.
        """
        values, covariance = _parameters(law, model, trials, trial.object)
        count, restrictions = len(values), observation.restrictions or Restrictions()
        shared = [restrictions.shared.get(name, OBJECT) for name in model.parameters]
        own = [i for i, by in enumerate(shared) if by_trial(by, observation.measured)]
        free = [*own, *(count + j for j in model.free_of(trial.object))]
        place = {index: k for k, index in enumerate(free)}
        indices = [place.get(index, -1) for index in range(count + model.width)]
        whole = TrialData.of(trial, model, observation.initial_time, indices[:count], values.tolist(), indices[count:])
        used = _used(trial, start, from_time)
        if free and not used.any():
            raise CommonlawError("trial-without-samples", trial=trial.label)
        seen = whole.seen(used) if used.any() else whole
        logarithmic = np.array([name in observation.measured.logarithmic for name in model.observables])
        sizes = np.array([observation.sizes[name] for name in model.variables.states])
        given = restrictions.priors
        known = {i: given[name] for i, name in enumerate(model.parameters) if name in given}
        known |= {count + j: prior for j, prior in model.expected.items()}
        known = {index: prior for index, prior in known.items() if index in place}
        priors = tuple(NormalPrior.of(place[index], *prior) for index, prior in known.items())
        problem = Problem(model, (seen,), len(free), logarithmic, sizes, priors)
        rough = rough_noise(problem)
        noise = np.array([observation.noise.get(n, r) for n, r in zip(model.observables, rough, strict=True)])
        unknowns = np.concatenate([values, np.zeros(model.width)])
        if free:
            first, guessed = np.concatenate([values, sizes])[free], np.zeros(len(free), dtype=np.bool_)
            names = (*model.parameters, *(f"{name}(0)" for name in model.variables.states))
            limits = np.array([limits_of(names[index], bounds_in(restrictions.bounds)) for index in free])
            found = maximize(problem, first, guessed, Bounds(*limits.T), noise, 0, lambda _: None)
            unknowns[free] = found.unknowns
        others = np.setdiff1d(np.arange(count), own)
        shifted = tuple(NormalPrior.of(index, *prior) for index, prior in known.items())
        initial = np.where(seen.initial < 0, -1, np.arange(model.width) + count)
        both = replace(seen, parameter=np.arange(count), initial=initial)
        problem = replace(problem, trials=(both,), unknowns=len(unknowns), priors=shifted)
        rows = problem.information(unknowns, noise)
        inverse = np.asarray(np.linalg.pinv(rows[:, free].T @ rows[:, free]), dtype=np.float64)
        sensitivity = -inverse @ rows[:, free].T @ rows[:, others]
        until = float(trial.times[used][-1]) if used.any() else float(whole.times[0])
        covariance = covariance[np.ix_(others, others)]
        return cls(both, problem, unknowns, others, free, covariance, inverse, sensitivity, until)

    def at(self, times: Floats, return_std: bool) -> tuple[Floats, Floats, Floats, bool]:
        """Return observables, their standard deviations, shape (n, m) each, states, shape (n, D), and if it is endless.

        Observables that are log-scaled are given by their logarithms.
        """
        grid = np.union1d(self.data.times[:1], times)
        data = replace(self.data, times=grid, rows=np.searchsorted(grid, times))
        found = self.problem.predicted(data, self.unknowns, return_std)
        if found.slopes is None:
            return found.values, np.zeros(found.values.shape), found.states, found.is_endless
        by_initial = found.slopes[:, :, self.free]
        by_parameters = found.slopes[:, :, self.known] + by_initial @ self.sensitivity
        with np.errstate(all="ignore"):
            variance = np.einsum("nmp,pq,nmq->nm", by_parameters, self.parameter_covariance, by_parameters)
            variance += np.einsum("nmp,pq,nmq->nm", by_initial, self.covariance, by_initial)
            return found.values, np.sqrt(np.maximum(variance, 0.0)), found.states, found.is_endless


def _used(trial: Trial, start: int | Literal["all"] | None, from_time: float | None) -> Bools:
    """Return which samples determine initial values, shape (n,)."""
    used = (np.isfinite(trial.states) | np.isfinite(trial.below)).any(axis=1)
    if from_time is not None:
        used = used & (trial.times < from_time)
    if start is not None and start != "all":
        rows = np.flatnonzero(used)
        used = np.isin(np.arange(len(trial)), rows[-start:] if from_time is not None else rows[:start])
    return np.asarray(used)


def _parameters(law: Law, model: Model, trials: Trials, owner: str) -> tuple[Floats, Floats]:
    """Return the values of the parameters of an object, in the order of the model, and their covariance."""
    known, index = named_parameters(law), object_index(law, owner)
    own = dict(zip(known.names, known.values[index].tolist(), strict=True))
    values = [own[name] if name in own else number_of(name, owner, trials) for name in model.parameters]
    inner = [i for i, name in enumerate(model.parameters) if name in own]
    chosen = [known.names.index(model.parameters[i]) for i in inner]
    covariance = np.zeros((len(values), len(values)))
    covariance[np.ix_(inner, inner)] = np.nan_to_num(known.covariance[index])[np.ix_(chosen, chosen)]
    return np.array(values), covariance


def simulate_observed(
    law: Law,
    times: ArrayLike,
    initial: ArrayLike | Mapping[str, ArrayLike],
    *,
    tolerance: float,
    doses: Mapping[str, Mapping[float, float]] | None,
    inputs: Any,
    method: str,
    **settings: Any,
) -> dict[str, Trajectory]:
    """Integrate a law with the events of its observation for every object, see `Law.simulate`."""
    observation, known, found = law.observation, named_parameters(law), dict[str, Trajectory]()
    assert observation is not None
    if method not in ("auto", "scipy") or any(settings.values()):
        refused = [name for name, value in settings.items() if value]
        raise CommonlawError("simulate-with-events", settings=refused or [f"method={method!r}"])
    model = read_model(_text(law, observation), observation.measured, ())
    sizes = np.array([observation.sizes[name] for name in model.variables.states])
    for name, problem in initial_value_problems(law, times, initial, doses, inputs, tolerance).items():
        own = dict(zip(known.names, known.values[object_index(law, name)].tolist(), strict=True))
        values = [own[each] if each in own else float(law.properties[name][each]) for each in model.parameters]
        driven, count = problem.field.inputs, len(law.schema.inputs)
        delayed = NO_INPUTS if driven is None else DelayedInputs(driven, tuple(range(count)), (-1,) * count)
        states, _, is_endless = shoot(
            model.switched,
            np.array(values),
            problem.initial,
            problem.times,
            sizes,
            delayed,
            derivatives=False,
            tolerance=tolerance,
        )
        found[name] = _trajectory(problem.times, states, is_endless, name)
    return found


def _trajectory(times: Floats, values: Floats, is_endless: bool, where: str) -> Trajectory:
    """Return a trajectory that ends where its values are not finite."""
    finite = np.isfinite(values).all(axis=1)
    ended = None if finite.all() else float(times[int(np.argmin(finite))])
    reason = "events repeat infinitely often" if is_endless else "a state is not finite"
    outcome = None if ended is None else diverged(ended, reason, where, "ends" if is_endless else "ran away")
    return Trajectory(times, values, outcome, ended, method="shooting")


@dataclass(frozen=True, eq=False)
class _Curves:
    """The curves of trials, of log-scaled quantities by their logarithms, and the times that they are wanted at."""

    observation: Observation
    trials: Trials
    curves: Sequence[_Curve]
    from_time: float | None
    return_std: bool

    def forecast(self) -> Forecast:
        """Return the curves at the times of the trials."""
        trajectories, deviations, latent = list[Trajectory](), list[Floats](), list[Floats]()
        for trial, curve in zip(self.trials, self.curves, strict=True):
            values, std, states, is_endless = curve.at(trial.times, self.return_std)
            trajectories.append(_trajectory(trial.times, values, is_endless, trial.label))
            deviations.append(std)
            latent.append(states)
        levels = self.observation.noise_levels
        pairs = list(zip(self.trials, self.curves, strict=True))
        return Forecast(
            with_noise(self.trials, self.observation.noise_of),
            tuple(trajectories),
            tuple(deviations) if self.return_std else None,
            levels if self.return_std else None,
            self.from_time,
            at_more_times=self.at_more_times,
            horizons=tuple(np.maximum(0.0, trial.times - curve.known_until) for trial, curve in pairs),
            latent=tuple(latent),
        )

    def at_more_times(self, times: Sequence[Floats]) -> Forecast:
        """Return the same at more times of each trial."""
        trials = [_with_times(trial, time) for trial, time in zip(self.trials, times, strict=True)]
        return replace(self, trials=self.trials.with_trials(trials)).forecast()
