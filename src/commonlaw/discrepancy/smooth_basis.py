"""Smooth functions of one coordinate as sums of terms: bumps at even knots and a straight line."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library import Term, Variables, parse_term

_PARTS = 6
"""Bumps in the range that was visited: what is narrower is no smooth function."""


@dataclass(frozen=True)
class SmoothBasis:
    """Functions whose sums are the smooth functions of a coordinate.

    Parameters
    ----------
    coordinate
        An expression over the variables of a law.
    times
        What the function is multiplied with, a term; ``"1"`` for nothing.
    low, high
        The range of the coordinate that was visited.
    """

    coordinate: str
    times: str
    low: float
    high: float

    @property
    def range(self) -> float:
        """How far the visited values reach."""
        return self.high - self.low

    @property
    def width(self) -> float:
        """The standard deviation of a bump."""
        return self.range / _PARTS

    @cached_property
    def knots(self) -> Floats:
        """Where the bumps are: in the visited range, and as far beyond it on both sides, shape (bumps,)."""
        return np.linspace(self.low - self.range, self.high + self.range, 3 * _PARTS + 1)

    @property
    def centre(self) -> float:
        """The middle of the range."""
        return (self.low + self.high) / 2

    def __len__(self) -> int:
        return len(self.knots) + 1

    def terms(self, variables: Variables) -> tuple[Term, ...]:
        """Return the functions, times what they are multiplied with: the line, then the bumps."""
        own = f"({self.coordinate})"
        bumps = (f"exp(-(({own} - ({knot!r}))/{self.width!r})**2/2)" for knot in self.knots.tolist())
        texts = (f"({own} - ({self.centre!r}))", *bumps)
        return tuple(parse_term(f"({self.times})*{each}", variables) for each in texts)

    def values(self, coordinate: Floats) -> Floats:
        """Return the functions, without what they are multiplied with, shape (n, functions)."""
        bumps = np.exp(-(((coordinate[:, np.newaxis] - self.knots) / self.width) ** 2) / 2)
        return np.column_stack([coordinate - self.centre, bumps])
