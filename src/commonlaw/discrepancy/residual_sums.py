"""Sums over residuals that their tests follow from: those of several parts of the trials add up to those of all."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from commonlaw.array_types import Floats

MOST = 5000
"""Residuals that are kept themselves; of more there are sums only."""

_POWERS = 3
"""Residuals are held against polynomials of this degree."""

_CELLS = 16
"""Cells of sizes for each factor of two, in which more residuals are ranked."""

_NODES = np.polynomial.legendre.leggauss(_POWERS + 1)[0]

_NO_SIZE = -(1 << 14)
"""The cell of zero."""


@dataclass(frozen=True, eq=False)
class Trend:
    """Residuals against a polynomial of a variable.

    Parameters
    ----------
    low, high
        The range of the variable.
    values
        Different values of it, as many as a polynomial has coefficients at most.
    factor
        Triangular factor of ``[Legendre polynomials over the range | residuals]``.
    """

    low: float
    high: float
    values: Floats
    factor: Floats

    @classmethod
    def of(cls, values: Floats, residuals: Floats) -> "Trend":
        """Return that of some samples, at least one."""
        low, high = float(values.min()), float(values.max())
        span = high - low
        scaled = 2 * (values - low) / span - 1 if span > 0 else np.zeros_like(values)
        design = np.polynomial.legendre.legvander(scaled, _POWERS)
        return cls(low, high, _first_of(values), triangular(np.column_stack([design, residuals])))

    def __add__(self, other: "Trend") -> "Trend":
        low, high = min(self.low, other.low), max(self.high, other.high)
        factors = [each._over(low, high) for each in (self, other)]
        return Trend(low, high, _first_of(np.concatenate([self.values, other.values])), triangular(np.vstack(factors)))

    def explained(self) -> tuple[int, float, float]:
        """Return the degree of the polynomial, the squares that it leaves, and those that a constant leaves."""
        powers = len(self.values) - 1
        factor = triangular(self.factor[:, [*range(powers + 1), -1]])
        return powers, float(factor[-1, -1] ** 2), float(np.sum(factor[1:, -1] ** 2))

    def _over(self, low: float, high: float) -> Floats:
        """Return the factor with the polynomials over a wider range."""
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        nodes = middle + half * _NODES
        scaled = 2 * (nodes - low) / (high - low) - 1 if high > low else np.zeros_like(nodes)
        vander = np.polynomial.legendre.legvander
        changed = np.linalg.solve(vander(_NODES, _POWERS), vander(scaled, _POWERS))
        return np.column_stack([self.factor[:, :-1] @ changed, self.factor[:, -1]])


@dataclass(frozen=True, eq=False)
class StateSums:
    """Sums over the residuals of a state.

    Parameters
    ----------
    powers
        Sums of the residuals, their squares, third and fourth powers.
    trends
        By the name of the variable.
    together
        Triangular factors of ``[1 | residuals of an earlier state | residuals]``, and how many samples have both.
    pairs
        Of neighbours: how many, sums of their products and of both; and how many trials have residuals.
    cells, counts
        Which cells of the sizes of residuals and states samples are in, shape (k, 2), and how many, shape (k,).
    kept
        Residuals and states, shape (count, 2), of at most `MOST`.
    """

    count: int
    powers: Floats
    trends: Mapping[str, Trend]
    together: tuple[tuple[int, Floats], ...]
    pairs: Floats
    cells: Floats
    counts: Floats
    kept: Floats | None

    @classmethod
    def of(cls, j: int, residuals: Sequence[Floats], against: Mapping[str, Floats], state: str) -> "StateSums | None":
        """Return those of a state in some trials, see `patterns`; None if it has no residual."""
        whole = np.concatenate(residuals)
        seen = np.isfinite(whole[:, j])
        if not seen.any():
            return None
        own, sizes = whole[seen, j], np.abs(against[state][seen])
        cells, counts = np.unique(np.column_stack([_cell(np.abs(own)), _cell(sizes)]), axis=0, return_counts=True)
        return cls(
            len(own),
            np.array([np.sum(own**k) for k in (1, 2, 3, 4)]),
            {name: Trend.of(values[seen], own) for name, values in against.items()},
            tuple(_both(whole[:, other], whole[:, j]) for other in range(j)),
            sum((neighbours(each[:, j]) for each in residuals), np.zeros(4)),
            cells,
            np.asarray(counts, dtype=np.float64),
            np.column_stack([own, sizes]) if len(own) <= MOST else None,
        )

    def __add__(self, other: "StateSums") -> "StateSums":
        cells, where = np.unique(np.concatenate([self.cells, other.cells]), axis=0, return_inverse=True)
        kept = None
        if self.kept is not None and other.kept is not None and self.count + other.count <= MOST:
            kept = np.concatenate([self.kept, other.kept])
        return StateSums(
            self.count + other.count,
            self.powers + other.powers,
            {name: own + other.trends[name] for name, own in self.trends.items()},
            tuple(
                (a + b, triangular(np.vstack([one, two])))
                for (a, one), (b, two) in zip(self.together, other.together, strict=True)
            ),
            self.pairs + other.pairs,
            cells,
            np.bincount(where.ravel(), np.concatenate([self.counts, other.counts])).astype(np.float64),
            kept,
        )

    @property
    def correlation_of_neighbours(self) -> float:
        """The correlation of residuals with the next in the same trial."""
        return float(correlation_of_neighbours(self.count, *self.powers[:2], *self.pairs[:3]))


def correlation_of_neighbours(count: Any, total: Any, squares: Any, pairs: Any, products: Any, sums: Any) -> Any:
    """Return the correlation of neighbours from sums of residuals and their squares, and of pairs; zero of none."""
    mean = total / count
    variance = squares / count - mean**2
    known = (pairs > 0) & (variance > 0)
    covariance = (products - mean * sums) / np.where(known, pairs, 1) + mean**2
    return np.where(known, covariance / np.where(known, variance, 1), 0.0)


def neighbours(own: Floats) -> Floats:
    """Return how many pairs of neighbours a series has, sums of their products and of both, and one."""
    first, second = own[:-1], own[1:]
    both = np.isfinite(first) & np.isfinite(second)
    first, second = first[both], second[both]
    return np.array([len(first), first @ second, first.sum() + second.sum(), 1.0])


def triangular(rows: Floats) -> Floats:
    """Return the square triangular factor of rows."""
    factor = np.linalg.qr(rows, mode="r")
    return np.pad(factor, ((0, rows.shape[1] - len(factor)), (0, 0)))


def ranks(cells: Floats, counts: Floats) -> Floats:
    """Return the mean rank of what is in each cell, whose order is that of numbers, shape (k,)."""
    _, where = np.unique(cells, return_inverse=True)
    inside = np.bincount(where, counts)
    return np.asarray((np.cumsum(inside) - (inside - 1) / 2)[where])


def _first_of(values: Floats) -> Floats:
    return np.unique(values)[: _POWERS + 1]


def _cell(sizes: Floats) -> Floats:
    """Return the cell of each size."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.maximum(np.floor(np.log2(sizes) * _CELLS), _NO_SIZE), dtype=np.int16)


def _both(other: Floats, own: Floats) -> tuple[int, Floats]:
    both = np.isfinite(other) & np.isfinite(own)
    rows = np.column_stack([np.ones(both.sum()), other[both], own[both]])
    return int(both.sum()), triangular(rows) if len(rows) else np.zeros((3, 3))
