"""Trials compressed, object by object, as they come."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError
from commonlaw.formulation.base import AbstractFormulation
from commonlaw.formulation.least_squares_problem import LeastSquaresProblem, merge
from commonlaw.formulation.sampled import SAMPLES
from commonlaw.library import Terms
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.shutdown import end_with_parent
from commonlaw.trials import Schema, Trial, Trials
from commonlaw.trials.trial import value_range

MAX_GROUPS = 32
"""Trials of an object that are kept apart; further ones join them in turn, so that memory does not grow with trials."""

_TRIALS_FOR_ACCURACY = 4
"""Trials of an object that the accuracy of its rows is estimated from."""


@dataclass(frozen=True, eq=False)
class ObjectRows:
    """The compressed rows of an object's trials; those of more trials are added with ``+``.

    Parameters
    ----------
    groups
        For each trial (or 32 groups of trials, if there are more) the problems of its segments in time. Consecutive
        short trials count as one where no segments are needed.
    count
        How many trials there are, counted like that.
    extremes
        Minimum and maximum of every state, shape (2, states).
    samples
        Some of the first trials, or of long ones some samples in the middle.
    """

    groups: tuple[tuple[LeastSquaresProblem, ...], ...]
    count: int
    extremes: Floats
    samples: tuple[Trial, ...] = ()

    def __add__(self, later: "ObjectRows") -> "ObjectRows":
        """Return what both come to: trial k is in group k modulo 32."""
        groups = list(self.groups)
        for index, group in enumerate(later.groups, self.count):
            if index < MAX_GROUPS:
                groups.append(group)
            else:
                slot = index % MAX_GROUPS
                groups[slot] = tuple(before + added for before, added in zip(groups[slot], group, strict=True))
        (least, most), (low, high) = self.extremes, later.extremes
        extremes = np.stack([np.minimum(least, low), np.maximum(most, high)])
        samples = (*self.samples, *later.samples)[:_TRIALS_FOR_ACCURACY]
        return ObjectRows(tuple(groups), self.count + later.count, extremes, samples)


@dataclass(frozen=True, eq=False)
class CompressedTrials:
    """Problems by object, in order of first appearance, by trial, and by segment of time."""

    objects: tuple[str, ...]
    groups: tuple[tuple[tuple[LeastSquaresProblem, ...], ...], ...]
    samples: tuple[tuple[Trial, ...], ...] = ()

    @classmethod
    def of(cls, found: dict[str, ObjectRows], schema: Schema) -> "CompressedTrials":
        """Return the rows of all objects; raises `CommonlawError` if a state of an object never changes."""
        refuse_constant_states({name: rows.extremes for name, rows in found.items()}, schema)
        listed = found.values()
        return cls(tuple(found), tuple(rows.groups for rows in listed), tuple(rows.samples for rows in listed))

    def subtract(self, coefficients: Floats) -> "CompressedTrials":
        """Return the problems with targets that coefficients, shape (objects, equations, terms), do not explain."""
        pairs = zip(self.groups, coefficients, strict=True)
        groups = (tuple(tuple(part.subtract(c) for part in trial) for trial in trials) for trials, c in pairs)
        return replace(self, groups=tuple(groups))

    @cached_property
    def problems(self) -> tuple[LeastSquaresProblem, ...]:
        """One problem for each object."""
        return tuple(merge(problem for trial in trials for problem in trial) for trials in self.groups)


def rows_by_object(
    trials: Iterable[Trial],
    form: AbstractFormulation,
    terms: Terms,
    *,
    segments: int = 1,
    sampled: bool = False,
    n_jobs: int = 1,
) -> dict[str, ObjectRows]:
    """Return the compressed rows of each object, also of a stream of trials that is larger than memory.

    Trials are cut into so many segments; `sampled` keeps some trials of each object. Raises `CommonlawError` if a trial
    cannot be used.
    """

    def work(some: tuple[Trial, ...]) -> tuple[tuple[Trial, ...], list[LeastSquaresProblem]]:
        return some, form.problems(some[0], terms, segments) if len(some) == 1 else [form.problem(some, terms)]

    pairs, result = map(work, _in_order(trials, segments)), dict[str, ObjectRows]()
    if n_jobs != 1:
        from joblib import Parallel, cpu_count, delayed

        parallel = Parallel(n_jobs=min(n_jobs, cpu_count()), return_as="generator", initializer=end_with_parent)
        pairs = parallel(delayed(work)(some) for some in _in_order(trials, segments))
    for some, problems in pairs:
        columns, kept = _columns(some), list[Trial]()
        for trial in some if sampled else ():  # Samples in the middle show how accurate the rows of a trial are
            left_out = max(0, len(trial) - SAMPLES) // 2
            kept.append(trial.rows(slice(left_out, left_out + SAMPLES)) if left_out else trial)
        extremes = np.array([[column.min() for column in columns], [column.max() for column in columns]])
        _add(result, {some[0].object: ObjectRows((tuple(problems),), 1, extremes, tuple(kept))})
    return result


def _in_order(trials: Iterable[Trial], segments: int) -> Iterator[tuple[Trial, ...]]:
    """Yield trials, those of an object that follow each other together where segments of time are not wanted."""
    held, size = list[Trial](), 0
    for trial in trials:
        if held and (segments > 1 or trial.object != held[0].object or size + len(trial) > 32_768):
            yield tuple(held)
            held, size = [], 0
        held.append(trial)
        size += len(trial)
    if held:
        yield tuple(held)


def _columns(trials: Sequence[Trial]) -> Floats:
    """Return the states of some trials together, shape (states, n): long columns go several times faster than rows."""
    return trials[0].states.T if len(trials) == 1 else np.concatenate([trial.states for trial in trials]).T


def merged_rows(parts: Iterable[dict[str, ObjectRows]]) -> dict[str, ObjectRows]:
    """Return what the rows of each object come to in several parts of the trials, in their order."""
    result = dict[str, ObjectRows]()
    for part in parts:
        _add(result, part)
    return result


def _add(found: dict[str, ObjectRows], part: dict[str, ObjectRows]) -> None:
    for name, rows in part.items():
        found[name] = found[name] + rows if name in found else rows


def some_trials(trials: Trials, objects: Sequence[str]) -> tuple[tuple[Trial, ...], ...]:
    """Return the first few trials of each object, from which the accuracy of its rows is estimated."""
    return tuple(trials.of_object(name)[:_TRIALS_FOR_ACCURACY] for name in objects)


def refuse_vanishing_states(trials: Trials) -> None:
    """Refuse states that are so small that their powers vanish."""
    parts = map(_columns, _in_order(trials, 1))
    sizes = np.fmax.reduce([[max(high, -low) for low, high in map(value_range, columns)] for columns in parts])
    for state, size in zip(trials.schema.states, sizes, strict=True):
        if 0 < size < 1e-50:  # The square of the cube of what is larger is still a number
            raise CommonlawError("state-too-large", state=state, size=size)


def refuse_constant_states(extremes: dict[str, Floats], schema: Schema) -> None:
    """Refuse objects with a state that never changes: its terms cannot be distinguished from the constant.

    `extremes` are minimum and maximum of every state by object, shape (2, states).
    """
    for name, (least, most) in extremes.items():
        for state, still in zip(schema.states, least == most, strict=True):
            if still:
                ways = ["leave the object out"] if len(extremes) > 1 else []
                ways += ["take the column as a property instead of a state"] if len(schema.states) > 1 else []
                ways = ways or ["measure it while it changes"]
                raise CommonlawError("state-constant-of-object", state=state, name=name, remedies=ways)
