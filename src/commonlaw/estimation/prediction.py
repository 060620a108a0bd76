"""Fitted curves and forecasts of what was measured, by a law with an observation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.estimation.model import Model, ModelText, read_model
from commonlaw.estimation.problem import Problem, TrialData
from commonlaw.estimation.search import Bounds, maximize, rough_noise
from commonlaw.forecast.forecast import Forecast
from commonlaw.integration import Trajectory
from commonlaw.integration.problem import diverged
from commonlaw.law import Law
from commonlaw.law.alignment import matched
from commonlaw.law.law import object_index
from commonlaw.law.observation import Observation
from commonlaw.law.parameters import named_parameters
from commonlaw.trials import Trial, Trials
from commonlaw.trials.transformations import natural, number_of, with_logarithms
from commonlaw.trials.trial import property_names


def predict_observed(
    law: Law,
    trials: Trials,
    *,
    times: ArrayLike | None = None,
    start: int | Literal["all"] | None = None,
    from_time: float | None = None,
    return_std: bool = False,
) -> Forecast:
    """Return what should have been measured in trials, see `Law.predict`.

    Initial values that the law does not give are estimated from the first `start` samples, those before `from_time`, or
    by default all of them, by maximum likelihood at the parameters of the law.

    Raises
    ------
    CommonlawError
        If something else was measured than for the law, or an object is not one of the law.
    """
    observation = law.observation
    assert observation is not None
    trials, wanted = matched(law, trials), observation.measured
    for name in trials.objects:
        object_index(law, name)
    fixed = [f"{each}(0)" for each in law.schema.states]
    properties = [*property_names(trials.properties), *fixed]
    text = ModelText(law.provenance.equations, observation.equations, observation.initial, ())
    model = read_model(text, wanted, properties)
    more = np.zeros(0) if times is None else np.atleast_1d(np.asarray(times, dtype=np.float64))
    beginnings = tuple(
        _begun(law, model, observation, trials, each, start, from_time)
        for each in with_logarithms(trials, wanted.logarithmic)
    )
    points = [_with_times(trial, more) for trial in trials]
    return _Curves(law, model, trials.with_trials(points), beginnings, from_time, return_std).forecast(
        [each.times for each in points]
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
        repeats=None,
    )


@dataclass(frozen=True, eq=False)
class _Begun:
    """A trial whose initial values are estimated.

    Their covariance is that at known parameters, shape (k, k); with these they change by their sensitivity, (k, P).
    """

    data: TrialData
    problem: Problem
    unknowns: Floats
    covariance: Floats
    sensitivity: Floats
    known_until: float


def _noise(problem: Problem, observation: Observation) -> Floats:
    rough = rough_noise(problem)
    return np.array([observation.noise.get(n, r) for n, r in zip(problem.model.observables, rough, strict=True)])


def _begun(
    law: Law,
    model: Model,
    observation: Observation,
    trials: Trials,
    trial: Trial,
    start: int | Literal["all"] | None,
    from_time: float | None,
) -> _Begun:
    values = _parameters(law, model, trials, trial.object)
    free = np.flatnonzero(model.is_free)
    initial = np.full(model.width, -1)
    initial[free] = np.arange(len(free))
    used = trial.measured()
    if from_time is not None:
        used = used.rows(used.times < from_time)
    if isinstance(start, int):
        used = used.rows(slice(-start, None) if from_time is not None else slice(start))
    if not len(used):
        raise CommonlawError("trial-without-samples", trial=trial.label)
    first = trial.times[0] if observation.initial_time is None else observation.initial_time
    data = TrialData.of(replace(used, repeats=None), model, first, [-1] * len(values), values, initial.tolist())
    logarithmic = np.array([name in observation.measured.logarithmic for name in model.observables])
    sizes = np.maximum(1e-12, np.abs([_size(model, data, j) for j in range(model.width)]))
    problem = Problem(model, (data,), len(free), logarithmic, sizes, {})
    known = {
        each.state: each.value
        for each in observation.estimated
        if (each.object, each.trial) == (trial.object, trial.name)
    }
    names = [model.variables.states[j] for j in free]
    if start is None and from_time is None and names and all(name in known for name in names):
        return _with_sensitivity(data, problem, np.array([known[name] for name in names]), observation, trial.times[-1])
    endless = np.full(len(free), np.inf)
    optimum = maximize(
        problem,
        sizes[free],
        np.zeros(len(free), dtype=np.bool_),
        Bounds(-endless, endless),
        _noise(problem, observation),
        0,
        lambda _: None,
    )
    return _with_sensitivity(data, problem, optimum.unknowns, observation, used.times[-1])


def _with_sensitivity(
    data: TrialData, problem: Problem, unknowns: Floats, observation: Observation, known_until: float
) -> _Begun:
    """Return a trial with initial values that maximize its likelihood, and how these follow from the parameters.

    Of the information H of parameters p and initial values x: Cov(x | p) = inv(H_xx), dx/dp = -inv(H_xx) H_xp.
    """
    whole = _with_parameters(data)
    count, values = len(data.values), np.concatenate([data.values, unknowns])
    slopes = replace(problem, trials=(whole,), unknowns=len(values)).residuals(values, _noise(problem, observation))[1]
    assert slopes is not None
    by_initial, by_parameters = slopes[:, count:], slopes[:, :count]
    inverse = np.asarray(np.linalg.pinv(by_initial.T @ by_initial), dtype=np.float64)
    return _Begun(data, problem, unknowns, inverse, -inverse @ by_initial.T @ by_parameters, known_until)


def _with_parameters(data: TrialData) -> TrialData:
    """Return a trial whose parameters are unknowns, too, the first ones."""
    count = len(data.values)
    return replace(data, parameter=np.arange(count), initial=np.where(data.initial < 0, -1, data.initial + count))


def _size(model: Model, data: TrialData, j: int) -> float:
    name = model.variables.states[j]
    if name in model.observables and name not in model.text.observed:
        return float(np.nanmax(np.abs(data.trial.states[:, model.observables.index(name)]), initial=0.0)) or 1.0
    return 1.0


def _parameters(law: Law, model: Model, trials: Trials, owner: str) -> list[float]:
    known = named_parameters(law)
    own = dict(zip(known.names, known.values[object_index(law, owner)].tolist(), strict=True))
    return [own[name] if name in own else number_of(name, owner, trials) for name in model.parameters]


@dataclass(frozen=True, eq=False)
class _Curves:
    """What should have been measured at any times of trials."""

    law: Law
    model: Model
    trials: Trials
    beginnings: Sequence[_Begun]
    from_time: float | None
    return_std: bool

    def forecast(self, times: Sequence[Floats]) -> Forecast:
        """Return the curves at times of each trial."""
        observation, found, deviations = self.law.observation, list[Trajectory](), list[Floats]()
        assert observation is not None
        for begun, own in zip(self.beginnings, times, strict=True):
            values, std = self._curve(begun, own)
            finite = np.isfinite(values).all(axis=1)
            outcome, ended = None, None
            if not finite.all():
                ended = float(own[int(np.argmin(finite))])
                outcome = diverged(ended, "a state is not finite", begun.data.trial.label)
            found.append(Trajectory(own, values, outcome, ended))
            deviations.append(std)
        schema = replace(self.trials.schema, logarithmic=())
        noise = np.array([observation.noise.get(name, np.nan) for name in schema.states])
        trials = replace(self.trials, schema=schema)
        horizons = tuple(
            np.maximum(0.0, own - each.known_until) for own, each in zip(times, self.beginnings, strict=True)
        )
        return Forecast(
            trials,
            tuple(found),
            tuple(deviations) if self.return_std else None,
            noise if self.return_std and np.isfinite(noise).all() else None,
            self.from_time,
            at_more_times=self.at_more_times,
            horizons=horizons,
        )

    def at_more_times(self, times: Sequence[Floats]) -> Forecast:
        """Return the same at more times of each trial."""
        rows = [_with_times(trial, own) for trial, own in zip(self.trials, times, strict=True)]
        finer = replace(self, trials=self.trials.with_trials(rows))
        return finer.forecast([each.times for each in rows])

    def _curve(self, begun: _Begun, times: Floats) -> tuple[Floats, Floats]:
        """Return observables and their standard deviations at times, shape (n, m) each."""
        grid = np.union1d(begun.data.times[:1], times)
        count = len(self.model.parameters)
        data = replace(_with_parameters(begun.data), times=grid, rows=np.searchsorted(grid, times))
        unknowns = np.concatenate([begun.data.values, begun.unknowns])
        problem = replace(begun.problem, trials=(data,), unknowns=len(unknowns))
        found = problem.predicted(data, unknowns, self.return_std)
        schema = replace(self.trials.schema, logarithmic=self.law.observation.measured.logarithmic)  # type: ignore[union-attr]
        values = natural(found.values, schema)
        if found.slopes is None:
            return values, np.zeros(values.shape)
        covariance, by_initial = self._covariance(begun.data.trial.object), found.slopes[:, :, count:]
        by_parameters = found.slopes[:, :, :count] + by_initial @ begun.sensitivity
        with np.errstate(all="ignore"):
            variance = np.einsum("nmp,pq,nmq->nm", by_parameters, covariance, by_parameters)
            variance += np.einsum("nmp,pq,nmq->nm", by_initial, begun.covariance, by_initial)
            std = np.sqrt(np.maximum(variance, 0.0))
        logarithmic = begun.problem.logarithmic
        return values, np.where(logarithmic, std * values, std)

    def _covariance(self, owner: str) -> Floats:
        """Return the covariance of the parameters of an object, in the order of the model."""
        parameters, model = named_parameters(self.law), self.model
        place = [parameters.names.index(n) if n in parameters.names else -1 for n in model.parameters]
        whole = np.nan_to_num(parameters.covariance[object_index(self.law, owner)])
        found = np.zeros((len(place), len(place)))
        inner = [i for i, k in enumerate(place) if k >= 0]
        chosen = [place[i] for i in inner]
        found[np.ix_(inner, inner)] = whole[np.ix_(chosen, chosen)]
        return found
