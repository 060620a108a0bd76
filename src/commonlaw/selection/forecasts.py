"""Errors of forecasts of trials that were held out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.law import Law
from commonlaw.selection.cross_validation import CrossValidationScore, Fold
from commonlaw.trials import Trials


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
