"""What choosing by rows of rates needs: solvers that list candidates, trials that rates are judged by, forecasts."""

from collections.abc import Iterable, Sequence

from commonlaw.array_types import Bools
from commonlaw.errors import CommonlawError
from commonlaw.formulation import MOST_GROUPS, Compressed
from commonlaw.law import Law
from commonlaw.selection import ForecastError, make_folds
from commonlaw.solvers import (
    STLSQ,
    AbstractSolver,
    BestSubset,
    Constrained,
    StepwiseSelection,
)
from commonlaw.trials import Trial, Trials, TrialStream

_MANY_TERMS = 60
"""More are too many for the solvers that look closely."""

_JUDGED = 4
"""Trials of an object that the accuracy of its rates is judged by."""


def sharing(solver: AbstractSolver, universal: Sequence[tuple[int, int]]) -> AbstractSolver:
    """Return the solver with one coefficient for all objects at these equations and terms."""
    for equation in dict.fromkeys(equation for equation, _ in universal):
        solver = Constrained(solver, tuple(term for j, term in universal if j == equation), equation=equation)
    return solver


def default_solvers(terms: int) -> tuple[AbstractSolver, ...]:
    """Return the solvers whose paths list the candidates when none is named.

    Thresholding keeps what matters by size, best subset what fits best; each misses laws that the other lists. Both
    are too slow for hundreds of terms, where adding and deleting terms one by one takes their place.
    """
    if terms <= _MANY_TERMS:
        return STLSQ(), BestSubset()
    return StepwiseSelection(direction="forward"), StepwiseSelection(direction="backward")


def some_trials(trials: Iterable[Trial], objects: Sequence[str]) -> list[list[Trial]]:
    """Return the first few trials of each object, by which the accuracy of its rates is judged."""
    found: dict[str, list[Trial]] = {name: [] for name in objects}
    for trial in trials:
        if len(found[trial.object]) < _JUDGED:
            found[trial.object].append(trial)
    return list(found.values())


def forecast_scores(trials: Trials | TrialStream, data: Compressed, law: Law, free: Bools) -> list[ForecastError]:
    """Return what scores the supports of each equation on forecasts of held-out trials, the others as in `law`."""
    if not isinstance(trials, Trials) or any(len(trials.of(name)) > MOST_GROUPS for name in trials.objects):
        raise CommonlawError(
            f"forecasts judge candidates only on trials in memory, at most {MOST_GROUPS} of an object; judge on rates"
        )
    folds = make_folds(data.groups)
    return [ForecastError(folds, target, law, free, trials) for target in range(len(law.states))]
