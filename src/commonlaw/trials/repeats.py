"""Several measurements of a state at one time of a trial: their mean, how many they are, and how they scatter about it.

With white noise of standard deviation s the mean of n measurements has s / sqrt(n), and

    sum_i (y_i - x)^2 = n (mean - x)^2 + sum_i (y_i - mean)^2,

so that weighted least squares of the means are those of all measurements, and the second sum, which no law changes,
estimates s^2 with n - 1 degrees of freedom (pure error; Draper and Smith 1998, section 2.1).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from commonlaw.array_types import Floats, Indices


@dataclass(frozen=True, eq=False)
class Repeats:
    """Counts of measurements averaged in each sample, and sums of their squared deviations, shape (n, states)."""

    counts: Floats
    squares: Floats

    def taken(self, rows: Any) -> "Repeats":
        """Return those of some samples, by whatever chooses rows of an array."""
        return Repeats(self.counts[rows], self.squares[rows])

    def placed(self, rows: Indices, count: int) -> "Repeats":
        """Return those of so many samples, of which these are at some rows; each other has one measurement."""
        counts, squares = np.ones((count, self.counts.shape[1])), np.zeros((count, self.counts.shape[1]))
        counts[rows], squares[rows] = self.counts, self.squares
        return Repeats(counts, squares)

    def wider(self, states: int) -> "Repeats":
        """Return those of trials with so many further states, each with one measurement."""
        columns = ((0, 0), (0, states))
        return Repeats(np.pad(self.counts, columns, constant_values=1.0), np.pad(self.squares, columns))

    def scaled(self, factors: Floats) -> "Repeats":
        """Return those of states that are multiplied with factors, of a shape that fits."""
        return Repeats(self.counts, self.squares * np.square(factors))

    @property
    def freedom(self) -> Floats:
        """The degrees of freedom of the squares of each state, shape (states,)."""
        return np.asarray(np.sum(self.counts - 1, axis=0))

    @property
    def most(self) -> int:
        """The largest number of measurements."""
        return int(self.counts.max())


def merged(
    first: Indices, states: Floats, noise: Floats, repeats: Repeats | None
) -> tuple[Floats, Floats, Repeats | None]:
    """Return states, noise and repeats with one sample for each time, given the first row of each, shape (times,).

    Measurements with standard deviations are weighted by their inverse squares.
    """
    seen = np.isfinite(states)
    counts = np.where(seen, 1.0 if repeats is None else repeats.counts, 0.0)
    squares = np.where(seen & (repeats is not None), 0.0 if repeats is None else repeats.squares, 0.0)
    values = np.where(seen, states, 0.0)
    known = np.isfinite(noise) & seen
    weights = np.where(known, 1 / np.where(known, noise, 1.0) ** 2, counts)
    total, number = (np.add.reduceat(each, first) for each in (weights, counts))
    rows = np.repeat(np.arange(len(first)), np.diff(first, append=len(states)))
    with np.errstate(divide="ignore", invalid="ignore"):
        means = np.add.reduceat(weights * values, first) / total
        deviations = np.where(seen, counts * (values - means[rows]) ** 2, 0.0)
        std = np.where(np.add.reduceat(known, first), np.sqrt(1 / total), np.nan)
    found = Repeats(np.maximum(number, 1.0), np.add.reduceat(squares + deviations, first))
    return means, std, found if found.most > 1 else None


def joined(parts: Sequence[tuple[Repeats | None, tuple[int, ...]]]) -> Repeats | None:
    """Return those of samples of several parts, one behind the other, each with the shape of its states."""
    if all(repeats is None for repeats, _ in parts):
        return None
    whole = [repeats or Repeats(np.ones(shape), np.zeros(shape)) for repeats, shape in parts]
    return Repeats(*(np.concatenate(each) for each in zip(*((own.counts, own.squares) for own in whole), strict=True)))


def pure_error(repeats: Sequence[Repeats | None], states: int) -> tuple[Floats, Floats]:
    """Return the sum of squares of repeated measurements of each state and its degrees of freedom, shape (states,)."""
    found = [repeat for repeat in repeats if repeat is not None]
    squares = sum((each.squares.sum(axis=0) for each in found), np.zeros(states))
    return squares, sum((each.freedom for each in found), np.zeros(states))
