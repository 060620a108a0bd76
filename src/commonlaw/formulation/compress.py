"""Trials compressed, object by object, as they come."""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.ending import end_with_parent
from commonlaw.errors import CommonlawError
from commonlaw.formulation.base import AbstractFormulation
from commonlaw.formulation.least_squares_problem import LeastSquaresProblem, merge
from commonlaw.library import Terms
from commonlaw.trials import Schema, Trial, Trials

MOST_GROUPS = 32
"""Trials of an object that are kept apart; further ones join them in turn, so that memory does not grow with trials."""


_SMALLEST = 1e-50
"""Of the largest value of a state: the square of its cube is still a number."""


@dataclass(frozen=True, eq=False)
class CompressedTrials:
    """Problems by object, by trial, and by segment of time.

    Parameters
    ----------
    objects
        Names, in order of first appearance.
    groups
        For each object, for each of its trials (or of 32 groups of trials, if there are more), the problems of
        segments that follow each other in time.
    """

    objects: tuple[str, ...]
    groups: tuple[tuple[tuple[LeastSquaresProblem, ...], ...], ...]

    def subtract(self, coefficients: Floats) -> "CompressedTrials":
        """Return the problems with targets that coefficients, shape (objects, equations, terms), do not explain."""
        pairs = zip(self.groups, coefficients, strict=True)
        groups = tuple(tuple(tuple(block.subtract(own) for block in trial) for trial in each) for each, own in pairs)
        return CompressedTrials(self.objects, groups)

    @cached_property
    def problems(self) -> tuple[LeastSquaresProblem, ...]:
        """One problem for each object."""
        return tuple(merge(problem for trial in trials for problem in trial) for trials in self.groups)


def compress(
    trials: Iterable[Trial],
    schema: Schema,
    form: AbstractFormulation,
    terms: Terms,
    *,
    segments: int = 1,
    n_jobs: int = 1,
) -> CompressedTrials:
    """Compress trials one by one; they may come from a stream that is larger than memory.

    Parameters
    ----------
    trials
        In any order of objects.
    schema
        Names of the states.
    form
        How a trial becomes rows.
    terms
        The library.
    segments
        Segments of time into which a trial is cut.
    n_jobs
        Processes that share the work; 1 stays in this one.

    Raises
    ------
    CommonlawError
        If a trial cannot be used, or a state of an object never changes.
    """
    found: dict[str, list[list[LeastSquaresProblem]]] = {}
    counts: Counter[str] = Counter()
    extremes: dict[str, Floats] = {}
    for trial, problems in _with_problems(trials, form, terms, segments, n_jobs):
        groups = found.setdefault(trial.object, [])
        index = counts[trial.object] % MOST_GROUPS
        if index < len(groups):
            groups[index] = [one + other for one, other in zip(groups[index], problems, strict=True)]
        else:
            groups.append(problems)
        counts[trial.object] += 1
        ends = np.array([[each.min() for each in trial.states.T], [each.max() for each in trial.states.T]])
        before = extremes.get(trial.object, ends)
        extremes[trial.object] = np.stack([np.minimum(before[0], ends[0]), np.maximum(before[1], ends[1])])
    refuse_constant_states(extremes, schema)
    return CompressedTrials(tuple(found), tuple(tuple(map(tuple, groups)) for groups in found.values()))


def _with_problems(
    trials: Iterable[Trial], form: AbstractFormulation, terms: Terms, segments: int, n_jobs: int
) -> Iterator[tuple[Trial, list[LeastSquaresProblem]]]:
    def work(trial: Trial) -> tuple[Trial, list[LeastSquaresProblem]]:
        return trial, form.problems(trial, terms, segments)

    if n_jobs == 1:
        return map(work, trials)
    from joblib import Parallel, cpu_count, delayed

    parallel = Parallel(n_jobs=min(n_jobs, cpu_count()), return_as="generator", initializer=end_with_parent)
    return iter(parallel(delayed(work)(trial) for trial in trials))


def refuse_vanishing_states(trials: Trials) -> None:
    """Refuse states that are so small that their powers vanish."""
    sizes = np.fmax.reduce([np.fmax.reduce(np.abs(trial.states)) for trial in trials])
    for state, size in zip(trials.schema.states, sizes, strict=True):
        if 0 < size < _SMALLEST:
            raise CommonlawError(
                f"the state {state!r} is {size:.3g} at most, and its powers are beyond what can be computed with: give "
                "it in another unit, so that its values are nearer to 1"
            )


def refuse_constant_states(extremes: dict[str, Floats], schema: Schema) -> None:
    """Refuse objects with a state that never changes: its rate is zero, its terms cannot be told from the constant.

    Parameters
    ----------
    extremes
        The least and the largest value of every state by object, shape (2, states).
    schema
        Names of the states.

    Raises
    ------
    CommonlawError
        If the two are the same.
    """
    for name, (least, most) in extremes.items():
        for state, still in zip(schema.states, least == most, strict=True):
            if still:
                raise CommonlawError(
                    f"the state {state!r} of {name} never changes: nothing can be learned from it; "
                    "leave the object out, or take the column as a property instead of a state"
                )
