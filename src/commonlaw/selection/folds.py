"""Folds: the data of each object in two, what is held out and the rest."""

from collections.abc import Sequence
from dataclasses import dataclass

from commonlaw.errors import CommonlawError
from commonlaw.formulation import LeastSquaresProblem, leave_one_out, merge

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
        raise CommonlawError(f"{count} folds are not enough: hold out each of at least 2 parts of the data")
    folds = []
    for index, trials in enumerate(groups):
        several = len(trials) > 1
        units = [merge(segments) for segments in trials] if several else list(trials[0])
        if len(units) < 2:
            raise CommonlawError("an object has one trial in one segment: cut it into more segments to hold some out")
        used = min(count, len(units))
        held = [merge(units[k::used]) for k in range(used)]
        for k, (own, rest) in enumerate(zip(held, leave_one_out(held), strict=True)):
            out = tuple(range(k, len(units), used)) if several else ()
            folds.append(Fold(index, own, rest, out, 1 / (used * len(groups))))
    return tuple(folds)
