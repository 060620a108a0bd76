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
    """One object's data in two.

    Parameters
    ----------
    object
        The index of the object.
    held, rest
        The problems of what is held out, and of all other data of the object.
    trials
        The indices, among the trials of the object, of those held out; none if segments of a single trial are held out.
    share
        How much the fold counts in a mean over folds in which objects count equally.
    """

    object: int
    held: LeastSquaresProblem
    rest: LeastSquaresProblem
    trials: tuple[int, ...]
    share: float


def make_folds(groups: ProblemGroups, count: int = 10) -> tuple[Fold, ...]:
    """Return the folds of all objects.

    An object of several trials holds out whole trials: one at a time if it has at most `count`, otherwise every
    `count`-th together. An object of a single trial holds out segments of it in the same way; rows on both sides of a
    cut share samples of the smoothing window, so these folds are a little less independent than trials.

    Raises
    ------
    CommonlawError
        If there are fewer than two folds, or an object has a single trial in a single segment.
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
    """A candidate's errors on the folds.

    Parameters
    ----------
    errors
        Shape (folds,).
    shares
        How much each fold counts, shape (folds,); they sum to one.
    """

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
        """Return by how much the mean is above another candidate's, and the standard error of that difference.

        Folds differ far more from each other than two candidates on one fold; the difference is taken fold by fold.
        """
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
    """Scores a support on the residuals of held-out data: their mean square after a fit to the rest.

    Each object's is divided by the mean square of its target, so that objects count equally.

    Parameters
    ----------
    folds
        From `make_folds`.
    target
        The equation.
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
