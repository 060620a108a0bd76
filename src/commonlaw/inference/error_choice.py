"""Which law, and which errors, where white noise does not explain the measurements."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.effort import unannounced
from commonlaw.errors import CommonlawError
from commonlaw.inference.covariance import fitted_law
from commonlaw.inference.error_search import ErrorKind, with_errors_of_kind
from commonlaw.inference.hypotheses import OF_MEASUREMENTS, Hypothesis
from commonlaw.inference.search import STRONG, SearchState, evidence_of, fit_solutions
from commonlaw.inference.search_problem import SearchProblem, prepare, spread
from commonlaw.integration import InitialValueProblem, Inputs, simulate
from commonlaw.law import Law
from commonlaw.likelihood import Estimate, NotPositiveError, interpolate
from commonlaw.selection import ENOUGH, FreeForecast, free_forecast
from commonlaw.solvers import AbstractSolver

_SHARE = 0.65
"""Share of each trial's samples that laws are fitted to before they forecast the rest."""

_HELD = 0.85
"""Share of the measurements that 95 % intervals of forecasts hold at least, if the errors are what they seem."""

_OBJECTS = 20
"""Objects that are forecast at most, evenly spread."""

_FORECAST = 3
"""Supports of largest evidence that are forecast under each kind of errors, besides the best of each size."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """Supports under a kind of errors, fitted to all trials; and how the law fitted to their first parts forecasts."""

    hypothesis: Hypothesis
    problem: SearchProblem
    state: SearchState
    forecast: FreeForecast | None = None


@unannounced()
def candidates(
    frame: Law,
    problem: SearchProblem,
    found: Sequence[Hypothesis],
    others: Sequence[Bools],
    solver: AbstractSolver,
) -> list[Candidate]:
    """Return all supports that were found under any kind of errors, under each: those of largest evidence, forecast."""
    listed = [*(each for own in found for each in own.pool(solver)), *others]
    pool = {each.tobytes(): each for each in listed if each.sum(axis=1).max() <= problem.most_terms}
    first = _first_parts(frame, problem)
    compared = []
    for hypothesis in found:
        for supports in _forecast_supports(hypothesis, list(pool.values())):
            with suppress(CommonlawError, NotPositiveError):
                fitted = Candidate(hypothesis, *hypothesis.fit(hypothesis.problem, supports))
                if not runs_away(fitted.problem, fitted.state):
                    compared.append(fitted if first is None else _with_forecast(frame, fitted, first))
    return compared


def _forecast_supports(hypothesis: Hypothesis, pool: Sequence[Bools]) -> list[Bools]:
    """Return the supports of largest evidence under a kind of errors, and those of each number of terms."""
    values = evidence_of(hypothesis.problem, hypothesis.state, pool)
    listed = [pool[i] for i in np.argsort(values)]
    sizes = [int(each.sum()) for each in listed]
    first = {sizes.index(size) for size in set(sizes) if size <= hypothesis.state.supports.sum() + 1}
    return [each for i, each in enumerate(listed) if i < _FORECAST or i in first]


def holds(candidate: Candidate) -> bool:
    """Whether 95 % intervals of the candidate's forecasts hold the measurements."""
    return candidate.forecast is not None and candidate.forecast.inside >= _HELD


def chosen(compared: Sequence[Candidate]) -> tuple[Candidate, bool]:
    """Return the candidate that is chosen, and whether it passes its own check.

    Of those whose 95 % intervals hold the measurements that they forecast, the one of largest evidence passes, if
    errors of the measurements explain what it leaves, and no error of the law has strong evidence against them. If none
    does, no law of the library is exact, and one is taken
    whose score is within one standard error of the best: if intervals of some hold, of these that of largest evidence,
    else the shortest description. Where nothing could be forecast, or too little to tell, evidence decides alone.
    """
    by_evidence = sorted(compared, key=lambda each: each.state.value)
    forecasts = {id(each): each.forecast for each in by_evidence if each.forecast is not None}
    if not forecasts or not can_forecast(by_evidence[0].problem):
        return by_evidence[0], True
    holding = [each for each in by_evidence if holds(each)]
    exact = [each for each in holding if each.hypothesis.kind in OF_MEASUREMENTS]
    if exact and exact[0].state.value - holding[0].state.value < STRONG:
        return exact[0], True
    best = min(forecasts.values(), key=lambda each: each.score)
    good = [each for each in by_evidence if id(each) in forecasts and forecasts[id(each)].as_good_as(best)]
    if held := [each for each in good if each in holding]:
        return held[0], False
    return min(good, key=lambda each: (_description(each), forecasts[id(each)].score)), False


@unannounced()
def with_errors(frame: Law, problem: SearchProblem, supports: Bools, kinds: Sequence[ErrorKind]) -> list[Candidate]:
    """Return supports under each kind of errors, with levels of their own, and forecast."""
    first, compared = _first_parts(frame, problem), []
    start = fit_solutions(problem, supports)[1]
    for kind in kinds:
        with suppress(CommonlawError, NotPositiveError):
            own, state = with_errors_of_kind(problem, start, kind)
            hypothesis = Hypothesis(kind, own, state, ())
            candidate = Candidate(hypothesis, *hypothesis.fit(own, supports))
            if not runs_away(candidate.problem, candidate.state):
                compared.append(candidate if first is None else _with_forecast(frame, candidate, first))
    return compared


def _description(candidate: Candidate) -> int:
    """Return how long a law is: its terms, and their factors."""
    return int((candidate.state.supports * (1 + candidate.problem.models[0].terms.complexities)).sum())


@unannounced()
def runs_away(problem: SearchProblem, state: SearchState) -> bool:
    """Whether a trajectory of a trial that the law was learned from diverges there, from its fitted start."""
    found, course = [], problem.trials.schema.input_between
    for i in spread(len(problem.models), _OBJECTS):
        model, estimate = problem.models[i], state.estimates[i]
        for mesh, states in zip(model.meshes, estimate.states, strict=True):
            cuts = [0, *(np.flatnonzero(~mesh.contiguous) + 1).tolist(), len(mesh)]
            for first, last in pairwise(cuts):
                times = mesh.times[first:last]
                field = replace(
                    model.field(estimate.coefficients), inputs=Inputs.of(times, mesh.inputs[first:last], course)
                )
                found.append(InitialValueProblem(field, states[first, : model.width], times, ""))
    return any(each.outcome for each in simulate(found, tolerance=1e-6))


def can_forecast(problem: SearchProblem) -> bool:
    """Whether the later parts of trials have so many measurements that forecasts of them tell errors apart."""
    later = (trial.states[int(np.ceil(_SHARE * len(trial))) :] for trial in problem.trials)
    return sum(int(np.isfinite(each).sum()) for each in later) >= ENOUGH


def _first_parts(frame: Law, problem: SearchProblem) -> SearchProblem | None:
    """Return the problem of the first part of every trial, None if these are too short to find anything."""
    cut = [trial.cut(int(np.ceil(_SHARE * len(trial)))) for trial in problem.trials]
    threshold = problem.models[0].observation.huber_threshold
    with suppress(CommonlawError):
        trials, noise = problem.trials.with_trials(cut), problem.first_noise
        part = prepare(trials, frame.terms, frame.order, problem.known, noise=noise, huber_threshold=threshold)
        return part.of_objects(spread(len(part.models), _OBJECTS))
    return None


def _with_forecast(frame: Law, candidate: Candidate, first: SearchProblem) -> Candidate:
    """Return a candidate with the forecasts by the law that is fitted to the first parts of all trials."""
    with suppress(CommonlawError, NotPositiveError):
        part, supports = first.with_errors_of(candidate.problem), candidate.state.supports
        start = _first_states(candidate, part)
        frame = replace(frame, objects=part.trials.objects, coefficients=np.nan_to_num(part.known))
        law = fitted_law(frame, *candidate.hypothesis.fit(part.about(start), supports, start))
        whole = [each for each in candidate.problem.trials if each.object in part.trials.objects]
        return replace(candidate, forecast=free_forecast(law, part.trials.with_trials(whole), part.trials))
    return candidate


def _first_states(candidate: Candidate, part: SearchProblem) -> list[Estimate]:
    """Return the estimates of all trials, cut to those of a part of the problem; between samples on straight lines."""
    whole, found = candidate.problem, []
    fitted = dict(zip(whole.trials.objects, zip(whole.models, candidate.state.estimates, strict=True), strict=True))
    for name in part.trials.objects:
        model, estimate = fitted[name]
        sampled = [own[mesh.sampled(whole.points)] for mesh, own in zip(model.meshes, estimate.states, strict=True)]
        ends = np.cumsum([len(trial) for trial in whole.trials.of_object(name)])[:-1]
        each = np.split(np.concatenate(sampled), ends)
        cut = [own[: len(trial)] for own, trial in zip(each, part.trials.of_object(name), strict=True)]
        found.append(replace(estimate, states=tuple(interpolate(cut, part.points))))
    return found
