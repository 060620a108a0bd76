"""The errors of measurements and of the law, estimated with it: the levels of each kind by their largest evidence."""

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from commonlaw.array_types import Floats, evenly_spaced
from commonlaw.inference import settings
from commonlaw.inference.data.noise import noise_floor, spread_within
from commonlaw.inference.fit.annealing import to_scale
from commonlaw.inference.fit.fit import NO_ERROR, Fit, errors_to_fit, fitted, price_of_model_error
from commonlaw.inference.fit.newton import minimum
from commonlaw.inference.fit.problem import SearchProblem
from commonlaw.inference.score.evidence import Measured, minus_twice_log_evidence
from commonlaw.likelihood import ERRORS, AboutEstimates, ErrorModel, Heteroscedastic, NotPositiveError, Scales
from commonlaw.runtime.fit_options import ErrorKind


def with_errors_of_kind(fit: Fit, kind: ErrorKind) -> Fit:
    """Return the supports of a fit under errors of a kind.

    Levels, and times, are those of largest evidence with the likelihood linearised about the fit (empirical Bayes).
    """
    if not fit.is_usable:
        return fit
    grows = isinstance(ERRORS[kind], Heteroscedastic)
    fit = _with_levels(fit.problem.about(fit.estimates) if grows else fit.problem, fit, kind)
    for _ in range(1, fit.problem.errors.rounds):
        fit = _with_levels(fit.problem.about(fit.estimates), fit, kind) if fit.is_usable else fit
    return to_scale(fit)


def _with_levels(problem: SearchProblem, fit: Fit, kind: ErrorKind) -> Fit:
    levels = _Levels(problem, kind)
    count = int(
        np.clip(
            np.ceil(settings.LEVEL_MEASUREMENTS / np.mean(problem.measured)), settings.MIN_OBJECTS, settings.MAX_OBJECTS
        )
    )
    few = evenly_spaced(len(problem.models), count)
    some, estimates = levels.problem(levels.starts[0], problem.of_objects(few)), [fit.estimates[i] for i in few]
    about = AboutEstimates(some.models, some.padded(estimates), fit.supports & some.allowed)
    value = partial(_value, levels, some, about)
    starts = [(value(each), i) for i, each in enumerate(levels.starts)]
    index = min(starts)[1]
    found = minimum(value, levels.starts[index], *levels.bounds)
    changed = levels.problem(found, problem)
    return fitted(changed, changed.padded(fit.estimates), fit.supports, levels.model_error(found))


@dataclass(frozen=True, eq=False)
class _Levels:
    """The logarithms of all levels and times of a kind of errors: noise first, times last."""

    before: SearchProblem
    kind: ErrorKind

    def errors(self, logs: Floats) -> tuple[Floats, ErrorModel]:
        """Return the noise of each state, shape (d,), and the other errors."""
        d, values = len(self.before.noise), np.exp(logs)
        return values[:d], ERRORS[self.kind].model(values[d:])

    def problem(self, logs: Floats, before: SearchProblem) -> SearchProblem:
        """Return a problem with these levels."""
        return before.with_errors(*self.errors(logs), "level of largest evidence for errors of this kind, with the law")

    def model_error(self, logs: Floats) -> float:
        """Return the random walk, relative to the noise."""
        return float(np.exp(logs[-1])) if self.kind == "walk" else NO_ERROR

    @cached_property
    def bounds(self) -> tuple[Floats, Floats]:
        """The least and the largest values, each of shape (levels and times,)."""
        scales, floor, noise = self._scales, noise_floor(self.before.trials), self.before.first_noise
        fixed = self.before.noise_given | self.before.trials.schema.unmeasured
        least, largest = ERRORS[self.kind].bounds(scales)
        low = np.append(np.where(fixed, noise, floor), least)
        high = np.append(np.where(fixed, noise, np.maximum(scales.states, floor)), largest)
        return np.log(low), np.log(high)

    @property
    def starts(self) -> list[Floats]:
        """Where to begin: some levels that errors may have besides the noise, and some times."""
        noise, (low, high) = np.log(self.before.noise), self.bounds
        others = ERRORS[self.kind].starts(noise, low[len(noise) :], high[len(noise) :])
        return [np.clip(np.append(noise, each), low, high) for each in others]

    @cached_property
    def _scales(self) -> Scales:
        problem, d = self.before, len(self.before.noise)
        groups = [problem.trials.of_object(name) for name in problem.trials.objects]
        trials = [trial for group in groups for trial in group]
        curves = [own[:, -d:] for group in problem.smoothed for own in group]
        states = np.where(problem.trials.schema.unmeasured, noise_floor(problem.trials), spread_within(problem.trials))
        rates = [np.gradient(own, trial.times, axis=0) for own, trial in zip(curves, trials, strict=True)]
        steps = np.concatenate([np.diff(trial.times) for trial in trials])
        longest = max(float(trial.times[-1] - trial.times[0]) for trial in trials)
        deviations = np.sqrt(np.mean(np.concatenate(rates) ** 2, axis=0))
        least = settings.MIN_NOISE, settings.FINAL_MODEL_ERRORS[0]
        return Scales(states, deviations, float(np.median(steps)), longest, *least)


def _value(levels: _Levels, problem: SearchProblem, about: AboutEstimates, logs: Floats) -> float:
    """Return minus twice the log-evidence of the supports of estimates, linearised about them, at these levels."""
    measurements, (noise, errors), model_error = problem.measurements, levels.errors(logs), levels.model_error(logs)
    std = measurements.white_std(noise, errors)
    try:
        factors, log_determinant = about.linearize(std, errors.latent, errors_to_fit(model_error)[-1])
    except NotPositiveError:
        return 1e12
    prior = measurements.counted(noise, errors, std).prior
    evidence = minus_twice_log_evidence(factors, np.arange(factors.shape[2] - 1), Measured(measurements.count))
    price = measurements.price(noise, errors, std) + price_of_model_error(model_error, measurements.count)
    found = evidence + prior + log_determinant + price
    return found if np.isfinite(found) else 1e12
