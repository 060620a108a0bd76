"""The errors of measurements and of the law, estimated with it: the levels of each kind by their largest evidence."""

from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Literal

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.inference.data.noise import noise_floor, spread_within
from commonlaw.inference.fit.annealing import to_scale
from commonlaw.inference.fit.newton import minimum
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.fit.state import FINAL, NO_ERROR, SearchState, errors_to_fit, fitted, price_of_model_error
from commonlaw.inference.score.evidence import Measured, minus_twice_log_evidence
from commonlaw.likelihood import AboutEstimates, ErrorModel, NotPositiveError
from commonlaw.spacing import evenly_spaced

ErrorKind = Literal["white", "proportional", "correlated", "walk", "force"]
"""White noise, white noise that also grows with the state, an error of the measurement with a memory; a law with a
random walk, or with a smooth force."""

_MEASURED = 300
"""Levels are found on objects with so many measurements together, evenly spread: what they are is soon told."""

_FEWEST, _MOST = 3, 12
"""How many objects these are."""

_SMALLEST = 1e-4
"""Shares, and forces relative to the rates of the states, that count as none."""

_WORST = 1e12
"""In place of a value that cannot be computed."""


def kind_of(errors: ErrorModel) -> ErrorKind:
    """Return of which kind the errors of a law are."""
    if errors.force is not None:
        return "force"
    if errors.correlated is not None:
        return "correlated"
    if errors.proportional is not None:
        return "proportional"
    return "white" if errors.walk is None else "walk"


def with_errors_of_kind(
    problem: SearchProblem, state: SearchState, kind: ErrorKind
) -> tuple[SearchProblem, SearchState]:
    """Return the problem with errors of a kind, and the state fitted under them with the supports that it has.

    Levels, and times, are those of largest evidence with the likelihood linearised about the state (empirical Bayes).

    Raises
    ------
    NotPositiveError
        If the likelihood cannot be computed.
    """
    problem, state = _with_levels(problem.about(state.estimates) if kind == "proportional" else problem, state, kind)
    for _ in range(1, problem.errors.rounds):
        problem, state = _with_levels(problem.about(state.estimates), state, kind)
    return to_scale(problem, state)


def _with_levels(problem: SearchProblem, state: SearchState, kind: ErrorKind) -> tuple[SearchProblem, SearchState]:
    levels = _Levels(problem, kind)
    count = int(np.clip(np.ceil(_MEASURED / np.mean(problem.measured)), _FEWEST, _MOST))
    few = evenly_spaced(len(problem.models), count)
    some, estimates = levels.problem(levels.starts[0], problem.of_objects(few)), [state.estimates[i] for i in few]
    value = partial(
        _value, levels, some, AboutEstimates(some.models, some.padded(estimates), state.supports & some.allowed)
    )

    starts = [(value(each), i) for i, each in enumerate(levels.starts)]
    index = min(starts)[1]
    found = minimum(value, levels.starts[index], *levels.bounds)
    changed = levels.problem(found, problem)
    return changed, fitted(changed, changed.padded(state.estimates), state.supports, levels.model_error(found))[0]


@dataclass(frozen=True, eq=False)
class _Levels:
    """The logarithms of all levels and times of a kind of errors: noise first, times last."""

    before: SearchProblem
    kind: ErrorKind

    def errors(self, logs: Floats) -> tuple[Floats, ErrorModel]:
        """Return the noise of each state, shape (d,), and the other errors."""
        d, kind, values = len(self.before.noise), self.kind, np.exp(logs)
        errors = ErrorModel()
        if kind == "proportional":
            errors = ErrorModel(proportional=values[d:])
        elif kind == "correlated":
            errors = ErrorModel(correlated=values[d:-1], memory=float(values[-1]))
        elif kind == "force":
            errors = ErrorModel(force=values[d:-1], force_time=float(values[-1]))
        return values[:d], errors

    def problem(self, logs: Floats, before: SearchProblem) -> SearchProblem:
        """Return a problem with these levels."""
        return before.with_errors(*self.errors(logs), "level of largest evidence for errors of this kind, with the law")

    def model_error(self, logs: Floats) -> float:
        """Return the random walk, relative to the noise."""
        return float(np.exp(logs[-1])) if self.kind == "walk" else NO_ERROR

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """The least and the largest values, each of shape (levels and times,)."""
        states, rates, step, duration = self._scales
        noise, floor = self.before.first_noise, noise_floor(self.before.trials)
        fixed = self.before.noise_given | self.before.trials.schema.unmeasured
        found = [(np.where(fixed, noise, floor), np.where(fixed, noise, np.maximum(states, floor)))]
        if self.kind == "proportional":
            found.append((np.full(len(states), _SMALLEST), np.ones(len(states))))
        elif self.kind == "correlated":
            found += [(_SMALLEST * states, states), (np.array([step]), np.array([3 * duration]))]
        elif self.kind == "force":
            found += [(_SMALLEST * rates, rates), (np.array([2 * step]), np.array([duration]))]
        elif self.kind == "walk":
            found.append((np.array([FINAL[0]]), np.array([30.0])))
        low, high = (np.log(np.concatenate(each)) for each in zip(*found, strict=True))
        return low, high

    @property
    def starts(self) -> list[Floats]:
        """Where to begin: some levels that errors may have beside the noise, and some times."""
        noise, (low, high) = np.log(self.before.noise), self.bounds
        d = len(noise)
        if self.kind == "white":
            return [np.clip(noise, low, high)]
        timed = self.kind in ("correlated", "force")
        times = [low[-1:] + share * (high - low)[-1:] for share in (0.2, 0.5, 0.8)] if timed else [np.empty(0)]
        others = slice(d, -1) if timed else slice(d, None)
        shares = np.log([0.3, 1.0]) if self.kind == "correlated" else (0.2, 0.5, 0.7)
        base, width = (noise, 1.0) if self.kind == "correlated" else (low[others], (high - low)[others])
        found = [np.concatenate([noise, base + share * width, time]) for share, time in product(shares, times)]
        return [np.clip(each, low, high) for each in found]

    @cached_property
    def _scales(self) -> tuple[Floats, Floats, float, float]:
        """Standard deviations of states and of their highest derivatives, the median step, the longest trial."""
        problem, d = self.before, len(self.before.noise)
        groups = [problem.trials.of_object(name) for name in problem.trials.objects]
        trials = [trial for group in groups for trial in group]
        curves = [own[:, -d:] for group in problem.smoothed for own in group]
        states = np.where(problem.trials.schema.unmeasured, noise_floor(problem.trials), spread_within(problem.trials))
        rates = [np.gradient(own, trial.times, axis=0) for own, trial in zip(curves, trials, strict=True)]
        steps = np.concatenate([np.diff(trial.times) for trial in trials])
        longest = max(float(trial.times[-1] - trial.times[0]) for trial in trials)
        return states, np.sqrt(np.mean(np.concatenate(rates) ** 2, axis=0)), float(np.median(steps)), longest


def _value(levels: _Levels, problem: SearchProblem, about: AboutEstimates, logs: Floats) -> float:
    """Return minus twice the log-evidence of the supports of estimates, linearised about them, at these levels."""
    measurements, (noise, errors), model_error = problem.measurements, levels.errors(logs), levels.model_error(logs)
    std = measurements.white_std(noise, errors)
    try:
        factors, log_determinant = about.linearize(std, errors.latent, errors_to_fit(model_error)[-1])
    except NotPositiveError:
        return _WORST
    prior = measurements.counted(noise, errors, std).prior
    evidence = minus_twice_log_evidence(factors, np.arange(factors.shape[2] - 1), Measured(measurements.count))
    price = measurements.price(noise, errors, std) + price_of_model_error(model_error, measurements.count)
    found = evidence + prior + log_determinant + price
    return found if np.isfinite(found) else _WORST
