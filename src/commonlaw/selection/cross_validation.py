"""Cross-validation: the data of each object in two, and errors on what was held out, of residuals or of forecasts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation import LeastSquaresProblem, leave_one_out, merge
from commonlaw.law import Law
from commonlaw.trials import Trials

ProblemGroups = Sequence[Sequence[Sequence[LeastSquaresProblem]]]
"""The problem of each segment of the data: for each object its trials, for each trial its segments in order of time."""


@dataclass(frozen=True, eq=False)
class Fold:
    """One object's data in two: the problems of what is held out and of the rest.

    `trials` are the indices of held-out trials, none if segments of a single trial are held out; `share` is the weight
    in a mean over folds in which objects count equally.
    """

    object: int
    held: LeastSquaresProblem
    rest: LeastSquaresProblem
    trials: tuple[int, ...]
    share: float


def make_folds(groups: ProblemGroups, count: int = 10) -> tuple[Fold, ...]:
    """Return the folds of all objects.

    Objects of several trials hold out trials: one at a time if there are at most `count`, otherwise every `count`-th
    together. A single trial holds out segments in the same way, whose rows at a cut share samples of the smoothing
    window. Raises `CommonlawError` if there are fewer than two folds, or an object has a single segment.
    """
    if count < 2:
        raise CommonlawError("too-few-folds", count=count)
    folds = []
    for index, trials in enumerate(groups):
        several = len(trials) > 1
        units = [merge(segments) for segments in trials] if several else list(trials[0])
        if len(units) < 2:
            raise CommonlawError("one-segment-to-hold-out")
        used = min(count, len(units))
        held = [merge(units[k::used]) for k in range(used)]
        for k, (own, rest) in enumerate(zip(held, leave_one_out(held), strict=True)):
            out = tuple(range(k, len(units), used)) if several else ()
            folds.append(Fold(index, own, rest, out, 1 / (used * len(groups))))
    return tuple(folds)


@dataclass(frozen=True, eq=False)
class CrossValidationScore:
    """A candidate's errors on the folds, and their weights, which sum to one, both of shape (folds,)."""

    errors: Floats
    shares: Floats

    @classmethod
    def of(cls, folds: Sequence[Fold], errors: Sequence[float]) -> "CrossValidationScore":
        """Return the score of an error on each fold."""
        return cls(np.array(errors), np.array([fold.share for fold in folds]))

    @property
    def mean(self) -> float:
        """The mean over folds, in which objects count equally."""
        return float(self.shares @ self.errors)

    @property
    def standard_error(self) -> float:
        """Standard error of the mean; NaN if an error is infinite."""
        return self._error_of(self.errors)

    def excess(self, best: "CrossValidationScore") -> tuple[float, float]:
        """Return by how much the mean exceeds another candidate's, with the standard error of the paired difference."""
        with np.errstate(invalid="ignore"):
            differences = self.errors - best.errors
        differences[np.isnan(differences)] = 0.0  # Both diverged on that fold
        return float(self.shares @ differences), self._error_of(differences)

    def _error_of(self, values: Floats) -> float:
        if not np.all(np.isfinite(values)):
            return np.nan
        count, away = len(values), values - self.shares @ values
        return float(np.sqrt(count / (count - 1) * np.sum((self.shares * away) ** 2)))


@dataclass(frozen=True, eq=False)
class ResidualError:
    """Scores a support of an equation by the mean squared residuals of held-out data after a fit to the rest.

    They are relative to the mean square of each object's target, so that objects count equally.
    """

    folds: Sequence[Fold]
    target: int

    def __call__(self, support: Bools) -> CrossValidationScore:
        """Return the errors of a support, shape (objects, terms)."""
        return CrossValidationScore.of(self.folds, [self._error(fold, support[fold.object]) for fold in self.folds])

    def _error(self, fold: Fold, support: Bools) -> float:
        coefficients = fold.rest.least_squares(support, self.target)
        whole = fold.held.tss(self.target) + fold.rest.tss(self.target)
        scale = whole / (fold.held.rows + fold.rest.rows)
        return fold.held.rss(coefficients, self.target) / fold.held.rows / (scale or 1.0)


@dataclass(frozen=True, eq=False)
class ForecastError:
    """Scores a support of one equation on forecasts of held-out trials by the law that was fitted to the others.

    The error of a trial is the mean over states of the mean squared error, divided by the variance of the state over
    the object's trials; infinite where a forecast diverges.

    Raises `CommonlawError` if an object has a single trial.

    Parameters
    ----------
    folds
        From `make_folds`, of problems less known terms.
    target
        The equation whose support is scored.
    law
        The law whose other equations stand, refitted on each fold.
    free
        Which terms are fitted, shape (equations, terms); the others keep their coefficients in `law`.
    trials
        The trials of all folds, with the law's objects in its order.
    """

    folds: Sequence[Fold]
    target: int
    law: Law
    free: Bools
    trials: Trials

    def __post_init__(self) -> None:
        for fold in self.folds:
            if not fold.trials:
                raise CommonlawError("one-trial-to-forecast", object=self.law.objects[fold.object])

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
