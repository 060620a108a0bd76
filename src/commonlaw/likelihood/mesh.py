"""The points in time at which the states of an object are sought, and what was measured there."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.trials import Trial

_POINTS = 4000
"""Points that are worked on together; longer stretches would leave the cache and fill memory."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Points of one or several stretches of trials, one stretch behind the other.

    Parameters
    ----------
    times
        Shape (n,), increasing within a stretch.
    measured
        States as measured, shape (n, d); NaN where they were not.
    inputs
        Inputs at the points, shape (n, inputs).
    linked
        Whether a point and the next one belong to one stretch, shape (n - 1,).
    """

    times: Floats
    measured: Floats
    inputs: Floats
    linked: Bools

    def __len__(self) -> int:
        return len(self.times)

    @cached_property
    def steps(self) -> Floats:
        """Steps in time from each point to the next, 0 between stretches, shape (n - 1,)."""
        return np.where(self.linked, np.diff(self.times), 0.0)

    @cached_property
    def shares(self) -> Floats:
        """Steps relative to the median step, 1 between stretches, shape (n - 1,)."""
        return np.where(self.linked, self.steps / np.median(self.steps[self.linked]), 1.0)

    @cached_property
    def seen(self) -> Bools:
        """Which states were measured, shape (n, d)."""
        return np.isfinite(self.measured)


def meshes(trials: Sequence[Trial], points: int = 1) -> list[Mesh]:
    """Return the meshes of an object's trials.

    Parameters
    ----------
    trials
        Of one object, none of them with fewer than two samples.
    points
        Points for each step from sample to sample: 1 for the samples alone, 2 for one more between any two, ...
    """
    return [
        _mesh([(trials[i], part) for i, part in group], points) for group in _groups([len(each) for each in trials])
    ]


def spread(values: Sequence[Floats], points: int = 1) -> list[Floats]:
    """Return values at the samples of trials, each of shape (samples, columns), on the meshes of these trials.

    Between samples they lie on straight lines.
    """
    groups = _groups([len(each) for each in values])
    return [np.concatenate([_between(values[i][part], points) for i, part in group]) for group in groups]


def _groups(lengths: Sequence[int]) -> Iterator[list[tuple[int, slice]]]:
    """Yield trials, by their place, in groups of at most so many samples; long trials are cut into even stretches."""
    group: list[tuple[int, slice]] = []
    size = 0
    for index, length in enumerate(lengths):
        pieces = -(-length // _POINTS)
        cuts = [length * i // pieces for i in range(pieces + 1)]
        for start, stop in pairwise(cuts):
            if group and size + stop - start > _POINTS:
                yield group
                group, size = [], 0
            group.append((index, slice(start, stop)))
            size += stop - start
    yield group


def _mesh(group: Sequence[tuple[Trial, slice]], points: int) -> Mesh:
    times = [_between(trial.times[part, np.newaxis], points)[:, 0] for trial, part in group]
    measured = []
    for (trial, part), grid in zip(group, times, strict=True):
        values = np.full((len(grid), trial.states.shape[1]), np.nan)
        values[::points] = trial.states[part]
        measured.append(values)
    inputs = [_between(trial.inputs[part], points) for trial, part in group]
    linked = np.ones(sum(map(len, times)) - 1, dtype=bool)
    linked[np.cumsum([len(each) for each in times])[:-1] - 1] = False
    return Mesh(np.concatenate(times), np.concatenate(measured), np.concatenate(inputs), linked)


def _between(values: Floats, points: int) -> Floats:
    """Return values, shape (n, columns), with `points` - 1 more rows between any two, on straight lines."""
    if points == 1:
        return values
    samples = np.arange(len(values))
    grid = np.arange((len(values) - 1) * points + 1) / points
    between = np.empty((len(grid), values.shape[1]))
    for j, column in enumerate(values.T):
        between[:, j] = np.interp(grid, samples, column)
    return between
