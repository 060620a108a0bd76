"""Errors of forecasts of trials that were held out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.law.quantiles import two_sided
from commonlaw.selection.cross_validation import CrossValidationScore, Fold
from commonlaw.trials import Trial, Trials

_SEGMENTS = 8
"""Into how many segments the later parts of few trials are cut, so that their scores show how sure the mean is."""

ENOUGH = 20
"""Measurements that tell by how much intervals are too narrow."""

_TRIALS = 30
"""How many trials are forecast at most."""

_TOLD = 3
"""Measured values of each state that a start is fitted to."""


@dataclass(frozen=True, eq=False)
class ForecastError:
    """Scores a support of one equation on forecasts of held-out trials by the law that was fitted to the others.

    The error of a trial is the mean over states of the mean squared error, divided by the variance of the state over
    the object's trials; it is infinite where a forecast diverges.

    Parameters
    ----------
    folds
        From `make_folds`, of problems whose known terms were moved to the left-hand side.
    target
        The equation whose support is scored.
    law
        The law whose other equations stand, refitted on each fold.
    free
        Which terms are to be found, shape (equations, terms); the others keep the coefficients that they have in `law`.
    trials
        The trials of all folds, with the law's objects in its order.

    Raises
    ------
    CommonlawError
        If an object has a single trial: segments of it cannot be forecast by themselves.
    """

    folds: Sequence[Fold]
    target: int
    law: Law
    free: Bools
    trials: Trials

    def __post_init__(self) -> None:
        for fold in self.folds:
            if not fold.trials:
                raise CommonlawError(
                    f"{self.law.objects[fold.object]} has a single trial, so none can be held out and forecast: "
                    "score on residuals, or measure another trial"
                )

    def __call__(self, support: Bools) -> CrossValidationScore:
        """Return the errors of a support, shape (objects, terms)."""
        return CrossValidationScore.of(self.folds, [self._error(fold, support[fold.object]) for fold in self.folds])

    def _error(self, fold: Fold, support: Bools) -> float:
        name = self.law.objects[fold.object]
        coefficients = np.where(self.free, 0.0, self.law.coefficients[fold.object])
        for j in range(len(coefficients)):
            own = support if j == self.target else (self.law.coefficients[fold.object, j] != 0) & self.free[j]
            coefficients[j] += fold.rest.least_squares(own, j)
        law = replace(self.law.select([name]), coefficients=coefficients[np.newaxis])
        trials = self.trials.of_object(name)
        errors = law.predict(self.trials.with_trials([trials[i] for i in fold.trials])).errors()
        variances = np.var(np.concatenate([trial.states for trial in trials]), axis=0)
        rms = errors["rms error"].to_numpy().reshape(len(fold.trials), -1)
        return float(np.mean(rms**2 / variances))


@dataclass(frozen=True, eq=False)
class FreeForecast:
    """How well a law forecasts the later parts of trials.

    Parameters
    ----------
    scores
        The continuous ranked probability score of the measurements (Gneiting and Raftery 2007), each state in units of
        its standard deviation over all trials: the mean in each of several segments, shape (segments,).
    missed
        How far each measurement is from its forecast, in standard deviations, shape (measurements,).
    """

    scores: Floats
    missed: Floats

    @property
    def inside(self) -> float:
        """The share of the measurements in their 95 % intervals."""
        return float(np.mean(np.abs(self.missed) <= two_sided(0.95)))

    @property
    def widening(self) -> float:
        """The factor, at least one, by which the intervals must be wider to hold 95 %; one if too few can tell."""
        if len(self.missed) < ENOUGH:
            return 1.0
        return max(1.0, float(np.quantile(np.abs(self.missed), 0.95)) / float(two_sided(0.95)))

    def as_good_as(self, best: "FreeForecast") -> bool:
        """Whether the score is within one standard error of another, the best."""
        return self.score <= best.score + best.standard_error

    @property
    def score(self) -> float:
        """The mean score of the segments."""
        return float(self.scores.mean())

    @property
    def standard_error(self) -> float:
        """Of the mean score."""
        count = len(self.scores)
        return float(self.scores.std(ddof=1) / np.sqrt(count)) if count > 1 else 0.0


def free_forecast(law: Law, trials: Trials, first: Trials) -> FreeForecast | None:
    """Return how well a law forecasts the later part of trials, from starts fitted to their first parts.

    None if a forecast diverges, or none can begin. The law must know its errors; steps are integrated to 1e-6. Of many
    trials some are forecast, evenly spread.
    """
    scale = np.nanstd(np.concatenate([trial.states for trial in trials]), axis=0)
    pairs = [pair for pair in zip(trials, first, strict=True) if _can_be_forecast(*pair)]
    pairs = [pairs[i] for i in np.unique(np.linspace(0, len(pairs) - 1, _TRIALS).round().astype(int))] if pairs else []
    scores, misses = [], []
    for count in dict.fromkeys(len(part) for _, part in pairs):
        alike = [trial for trial, part in pairs if len(part) == count]
        try:
            forecast = law.predict(
                trials.with_trials(alike), start=count, return_std=True, tolerance=1e-6, averaged=False
            )
        except CommonlawError:
            return None
        for trial, trajectory, margins in zip(
            alike, forecast.trajectories, forecast.margins(measured=True), strict=True
        ):
            middle, std = trajectory.states[count:, : len(scale)], margins[count:] / two_sided(0.95)
            if not (np.isfinite(middle).all() and np.isfinite(std).all()):
                return None
            missed = (trial.states[count:] - middle) / std
            parts = np.array_split(_crps(missed) * std / scale, min(-(-_SEGMENTS // len(pairs)), len(missed)))
            scores += [float(np.nanmean(own)) for own in parts if np.isfinite(own).any()]
            misses.append(missed[np.isfinite(missed)])
    return FreeForecast(np.array(scores), np.concatenate(misses)) if scores else None


def _can_be_forecast(trial: Trial, part: Trial) -> bool:
    """Whether the first part tells a start, and the later one was measured."""
    told = np.isfinite(part.states).sum(axis=0).min()
    return bool(told >= _TOLD and np.isfinite(trial.states[len(part) :]).any())


def _crps(missed: Floats) -> Floats:
    """Return the score of a normal distribution of unit variance, so far from the measurement."""
    from scipy.special import ndtr

    density = np.exp(-(missed**2) / 2) / np.sqrt(2 * np.pi)
    return np.asarray(missed * (2 * ndtr(missed) - 1) + 2 * density - 1 / np.sqrt(np.pi))
