"""Meshes: the points in time of the estimated states of an object, with the measurements there."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from operator import attrgetter

import numpy as np
from numpy.typing import NDArray

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.integration import Inputs
from commonlaw.library import Order
from commonlaw.runtime.forking import cached_property
from commonlaw.trials import Trial

MIN_NOISE = 1e-4
"""Smallest noise, in standard deviations of a state, at the size of discretization errors; that of absent states, in
the noise of others."""

MAX_MESH_SAMPLES = 4000
"""Points of a mesh; longer segments exceed the cache."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Points of segments of trials, concatenated; `contiguous` points and the next one belong to one segment, (n - 1,).

    Times, shape (n,), increase within a segment; measured states, shape (n, d), are NaN where missing; inputs, shape
    (n, inputs), are those after jumps. Standard deviations of measurements relative to the noise of their states,
    `scale`, given ones of single measurements, `noise`, NaN for others, and factors by which averaging lowers the
    noise, see `Trial.averaging`, have shape (n, d). Inputs in the `middle` of each step, shape (n - 1, inputs), are
    interpolated linearly by default; they may be held from each point to the next (zero-order hold).
    """

    times: Floats
    measured: Floats
    inputs: Floats
    contiguous: Bools
    scale: Floats | float = 1.0
    noise: Floats | float = np.nan
    averaging: Floats | float = 1.0
    middle: Floats | None = None
    held: bool = False

    @cached_property
    def first(self) -> Bools:
        """Which points are the first of their segments, shape (n,)."""
        return np.append(True, ~self.contiguous)

    @cached_property
    def jumps(self) -> Bools:
        """Where a held input jumps within a segment, shape (n,)."""
        changes = np.append(False, self.contiguous & np.any(np.diff(self.inputs, axis=0) != 0, axis=1))
        return changes & self.held

    @cached_property
    def still(self) -> Bools:
        """Which measurements are of a state that is constant in its segment, shape (n, d)."""
        first = np.flatnonzero(self.first)
        same = np.fmin.reduceat(self.measured, first) == np.fmax.reduceat(self.measured, first)
        return np.asarray(np.repeat(same, np.diff(first, append=len(self)), axis=0))

    @cached_property
    def absent(self) -> Bools:
        """Which of these are exactly zero, as of an absent species, shape (n, d)."""
        first = np.flatnonzero(self.first)
        seen = np.add.reduceat(self.observed.astype(np.intp), first)
        twice = np.repeat(seen > 1, np.diff(first, append=len(self)), axis=0)
        return np.asarray(self.still & twice & (np.nan_to_num(self.measured) == 0))

    def indices_on(self, stride: int) -> Floats:
        """Return the indices of the points on a mesh with `stride` steps for each one, shape (n,)."""
        return np.concatenate([[0], np.cumsum(np.where(self.contiguous, stride, 1))])

    def halfway(self, values: Floats) -> Floats:
        """Return values at the points, shape (n, columns), interpolated linearly to the mesh of half steps."""
        indices = self.indices_on(2)
        return np.column_stack([np.interp(np.arange(indices[-1] + 1), indices, column) for column in values.T])

    def with_inputs(self, inputs: Inputs) -> "Mesh":
        """Return the mesh of one segment with inputs as functions of time."""
        return replace(self, inputs=inputs.at(self.times), middle=_in_middle(inputs, self.times)[:-1], held=inputs.held)

    def with_scale(self, scale: Floats) -> "Mesh":
        """Return the mesh with other standard deviations, keeping cached properties."""
        scaled, rest = replace(self, scale=scale), ("still", "moving", "observed", "steps", "elapsed", "walk", "grid")
        scaled.__dict__.update({name: getattr(self, name) for name in (*rest, "typical_step")})
        return scaled

    def __len__(self) -> int:
        return len(self.times)

    def degrees_of_freedom(self, order: Order) -> int:
        """Return the number of measurements less initial states, without states constant in a segment."""
        return int(np.sum(np.maximum(self.moving - np.array(order), 0)))

    @cached_property
    def moving(self) -> Indices:
        """Number of measurements of each state that varies in a segment, shape (segments, d)."""
        return np.add.reduceat((self.observed & ~self.still).astype(int), np.flatnonzero(self.first))

    @cached_property
    def steps(self) -> Floats:
        """Steps in time from each point to the next, 0 between segments, shape (n - 1,)."""
        return np.where(self.contiguous, np.diff(self.times), 0.0)

    @cached_property
    def elapsed(self) -> Floats:
        """Times since the first points of segments, shape (n,)."""
        first = np.flatnonzero(self.first)
        return self.times - np.repeat(self.times[first], np.diff(first, append=len(self)))

    @cached_property
    def walk(self) -> Floats:
        """The variance of a random walk of each state in each step, shape (n - 1, d).

        It is in units of that in the median step, 1 between segments. An absent state wanders as little as it is noisy.
        """
        relative = np.where(self.contiguous, self.steps / self.typical_step, 1.0)
        return relative[:, np.newaxis] * np.where(self.absent[1:], MIN_NOISE**2, 1.0)

    @cached_property
    def typical_step(self) -> float:
        """The median step in time."""
        return float(np.median(self.steps[self.contiguous]))

    @cached_property
    def grid(self) -> "Grid":
        """The arrays of the kernel that do not depend on standard deviations."""
        middle = (self.inputs[:-1] + self.inputs[1:]) / 2 if self.middle is None else self.middle
        middle_times = (self.times[:-1] + self.times[1:]) / 2
        listed = (self.times, middle_times, self.steps, self.walk, self.measured, self.inputs, middle)
        arrays = tuple(np.ascontiguousarray(array, dtype=np.float64) for array in listed)
        return Grid(arrays, np.ascontiguousarray(self.contiguous, dtype=np.uint8))

    @cached_property
    def observed(self) -> Bools:
        """Which states were measured, shape (n, d)."""
        return np.isfinite(self.measured)


@dataclass(frozen=True, eq=False)
class Grid:
    """Times, steps, measurements and inputs of a mesh as one array; contiguity as bytes."""

    arrays: tuple[Floats, ...]
    contiguous: NDArray[np.uint8]


def concatenated(parts: Sequence[Mesh]) -> Mesh:
    """Return the concatenation of meshes, without standard deviations."""
    times, measured, inputs = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("times", "measured", "inputs")
    )
    contiguous = np.concatenate([np.append(part.contiguous, False) for part in parts])[:-1]
    return Mesh(times, measured, inputs, contiguous)


def meshes(
    trials: Sequence[Trial], points: int = 1, most: int = MAX_MESH_SAMPLES, input_interpolation: str = "linear"
) -> list[Mesh]:
    """Return the meshes of an object's trials, each of at least two samples.

    A sampling step has `points` points; trials with more than `most` samples are cut into segments. For the
    interpolation of inputs see `Inputs`.
    """
    return [
        _mesh([(trials[i], segment) for i, segment in group], points, input_interpolation)
        for group in _groups([len(trial) for trial in trials], most)
    ]


def interpolate(values: Sequence[Floats], points: int = 1, most: int = MAX_MESH_SAMPLES) -> list[Floats]:
    """Return values at the samples of trials, shape (samples, columns) each, interpolated linearly to their meshes."""
    groups = _groups([len(value) for value in values], most)
    return [np.concatenate([_between(values[i][segment], points) for i, segment in group]) for group in groups]


def segments(trials: Sequence[Trial]) -> list[list[Trial]]:
    """Return the segments of an object's trials that are in each of its meshes."""
    groups = _groups([len(trial) for trial in trials], MAX_MESH_SAMPLES)
    return [[trials[i].rows(segment) for i, segment in group] for group in groups]


def _groups(lengths: Sequence[int], most: int) -> Iterator[list[tuple[int, slice]]]:
    """Yield groups of at most `most` samples, each of trial indices with slices; longer trials are cut evenly."""
    group: list[tuple[int, slice]] = []
    size = 0
    for index, length in enumerate(lengths):
        count = -(-length // most)
        cuts = [length * i // count for i in range(count + 1)]
        for start, stop in pairwise(cuts):
            if group and size + stop - start > most:
                yield group
                group, size = [], 0
            group.append((index, slice(start, stop)))
            size += stop - start
    yield group


def _mesh(group: Sequence[tuple[Trial, slice]], points: int, input_interpolation: str) -> Mesh:
    times = [_between(trial.times[segment, np.newaxis], points)[:, 0] for trial, segment in group]
    measured, noise = (
        np.concatenate([_spaced(values_of(trial)[segment], points) for trial, segment in group])
        for values_of in (attrgetter("states"), attrgetter("noise"))
    )
    averaging: Floats | float = 1.0
    if any(trial.repeats is not None for trial, _ in group):
        parts = [np.broadcast_to(trial.averaging, trial.states.shape)[segment] for trial, segment in group]
        averaging = np.nan_to_num(np.concatenate([_spaced(part, points) for part in parts]), nan=1.0)
    functions = [Inputs.of(trial.times, trial.inputs, input_interpolation) for trial, _ in group]
    inputs, middle = (
        np.concatenate([values_of(function, grid) for function, grid in zip(functions, times, strict=True)])
        for values_of in (Inputs.at, _in_middle)
    )
    contiguous = np.ones(sum(map(len, times)) - 1, dtype=bool)
    contiguous[np.cumsum([len(time) for time in times])[:-1] - 1] = False
    held = any(function.held for function in functions)
    return Mesh(
        np.concatenate(times),
        measured,
        inputs,
        contiguous,
        noise=noise,
        averaging=averaging,
        middle=middle[:-1],
        held=held,
    )


def _in_middle(inputs: Inputs, times: Floats) -> Floats:
    """Return inputs at the midpoints of steps, and at the last time, shape (n, inputs)."""
    return inputs.at(np.append((times[:-1] + times[1:]) / 2, times[-1]))


def _spaced(values: Floats, points: int) -> Floats:
    """Return values, shape (n, columns), with `points` - 1 rows of NaN between any two."""
    spaced = np.full(((len(values) - 1) * points + 1, values.shape[1]), np.nan)
    spaced[::points] = values
    return spaced


def _between(values: Floats, points: int) -> Floats:
    """Return values, shape (n, columns), with `points` - 1 linearly interpolated rows between any two."""
    if points == 1:
        return values
    samples = np.arange(len(values))
    grid = np.arange((len(values) - 1) * points + 1) / points
    between = np.empty((len(grid), values.shape[1]))
    for j, column in enumerate(values.T):
        between[:, j] = np.interp(grid, samples, column)
    return between
