"""Samples at whole numbers, such as generations, whose law may be one in discrete time."""

from collections.abc import Iterator
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.errors import CommonlawError
from commonlaw.forecast import fitted
from commonlaw.formulation import law_variables
from commonlaw.inference.settings import VERY_STRONG
from commonlaw.law import Law
from commonlaw.law.text import left_hand_sides
from commonlaw.library import PolynomialLibrary
from commonlaw.outcomes import Outcome, note
from commonlaw.trials import Trials


def outcomes_of_generations(law: Law, trials: Trials) -> tuple[Outcome, ...]:
    """Return a hint at discrete time for each state whose next sample follows from the present one, but not by the law.

    Samples are at equally spaced whole numbers, and resolve no motion of the state between them:

    ``sum_k (x[k+1] - x[k])^2 >= sum_k (x[k+1] - mean of the object)^2``

    The next sample is regressed on polynomials of degree 2 in the present states and inputs, with an intercept of each
    object and p common coefficients. By the Bayesian information criterion (Schwarz 1978), the evidence for this is
    very strong against the means and against the solutions of the law, where S are residual sums of squares:

    ``n log(min(S_mean, S_law) / S_regression) - p log n > 10``

    Parameters
    ----------
    law
        In continuous time, learned from the trials.
    trials
        Of the objects of the law.
    """
    if not _are_at_whole_numbers(trials) or not (regressions := [*_regressions(trials)]):
        return ()
    equations = dict(zip(law.schema.states, left_hand_sides(law.schema.states, law.order), strict=True))
    solutions, found = _next_by_law(law, trials), list[Outcome]()
    for each in regressions:
        own = solutions[each.rows, law.schema.states.index(each.state)]
        squares = float(np.sum((each.target - own) ** 2)) if np.isfinite(own).all() else np.inf
        if each.evidence_against(squares) > VERY_STRONG:
            by_law, by_regression = (100 * max(0.0, 1 - left / each.about_means) for left in (squares, each.squares))
            found.append(
                note(
                    "discrete-time-plausible",
                    equations[each.state],
                    state=each.state,
                    by_law=by_law,
                    by_regression=by_regression,
                )
            )
    return tuple(found)


class _Regression(NamedTuple):
    """A regression of the next samples of a state, shape (n,), and the squares that it and means of objects leave."""

    state: str
    rows: Bools
    target: Floats
    coefficients: int
    squares: float
    about_means: float

    def evidence_against(self, squares: float) -> float:
        """Return twice the log Bayes factor for the regression against what leaves these squares."""
        count, rounding = len(self.target), np.finfo(float).eps ** 2 * self.about_means
        ratio = (squares + rounding) / (self.squares + rounding)
        return float(count * np.log(ratio) - self.coefficients * np.log(count))


def _are_at_whole_numbers(trials: Trials) -> bool:
    """Return whether the steps of all trials are the same whole number, and their times are whole numbers."""
    times = [each.times for each in trials]
    steps = np.unique(np.concatenate([np.diff(each) for each in times]))
    return len(steps) == 1 and all(np.array_equal(each, np.round(each)) for each in (steps, *times))


def _regressions(trials: Trials) -> Iterator[_Regression]:
    """Yield the regressions of states that samples do not resolve, where their evidence against means is strong."""
    terms = PolynomialLibrary(2, constant=False).bind(law_variables(trials.schema, 0))
    samples = [np.column_stack([each.states, each.inputs, each.times]) for each in trials]
    present, following = (np.concatenate([each[own] for each in samples]) for own in (slice(-1), slice(1, None)))
    objects = np.repeat([trials.objects.index(each.object) for each in trials], [len(each) - 1 for each in trials])
    for j, state in enumerate(trials.schema.states):
        rows = np.isfinite(present).all(axis=1) & np.isfinite(following[:, j])
        now, target = present[rows], following[rows, j]
        varied = _within(target[:, np.newaxis], objects[rows])[:, 0]
        about_means = float(varied @ varied)
        if len(target) <= len(terms) + len(trials.objects) or not 0 < about_means <= np.sum((target - now[:, j]) ** 2):
            continue
        matrix = _within(terms.evaluate(now), objects[rows])
        norms = np.linalg.norm(matrix, axis=0)
        matrix = matrix / np.where(norms > 0, norms, 1.0)
        coefficients, _, rank, _ = np.linalg.lstsq(matrix, varied, rcond=None)
        left = varied - matrix @ coefficients
        found = _Regression(state, rows, target, int(rank), float(left @ left), about_means)
        if found.evidence_against(about_means) > VERY_STRONG:
            yield found


def _within(values: Floats, objects: Indices) -> Floats:
    """Return values, shape (n, columns), without the means of objects."""
    counts = np.maximum(np.bincount(objects), 1)
    means = [np.bincount(objects, column) / counts for column in values.T]
    return values - np.column_stack(means)[objects]


def _next_by_law(law: Law, trials: Trials) -> Floats:
    """Return the states of all samples but the first of each trial by the law's solutions; NaN if they diverge."""
    with suppress(CommonlawError):
        return np.concatenate([each.states[1:] for each in fitted(law, trials).trajectories])
    return np.full((sum(len(each) - 1 for each in trials), len(law.schema.states)), np.nan)
