"""Measures of how much a term matters over all objects: the R of algorithm 1 (de Silva et al. 2020, section 2.3.2)."""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError


class AbstractImportance(ABC):
    """From the magnitudes of a term's coefficients to one number."""

    @abstractmethod
    def measure(self, magnitudes: Floats) -> Floats:
        """Reduce magnitudes, shape (objects, ...), over the objects."""


@dataclass(frozen=True)
class L1(AbstractImportance):
    """The sum of the magnitudes: the founding paper's choice."""

    def measure(self, magnitudes: Floats) -> Floats:
        return np.asarray(magnitudes.sum(axis=0))


@dataclass(frozen=True)
class L2(AbstractImportance):
    """The root of the sum of squares."""

    def measure(self, magnitudes: Floats) -> Floats:
        return np.asarray(np.linalg.norm(magnitudes, axis=0))


@dataclass(frozen=True)
class Mean(AbstractImportance):
    """The mean of the magnitudes; does not grow with the number of objects."""

    def measure(self, magnitudes: Floats) -> Floats:
        return np.asarray(magnitudes.mean(axis=0))


@dataclass(frozen=True)
class Median(AbstractImportance):
    """The median of the magnitudes: one object that goes astray does not matter."""

    def measure(self, magnitudes: Floats) -> Floats:
        return np.asarray(np.median(magnitudes, axis=0))


@dataclass(frozen=True)
class Quantile(AbstractImportance):
    """A quantile of the magnitudes; a low one keeps only terms that nearly all objects need.

    Parameters
    ----------
    level
        Between 0 and 1.

    Raises
    ------
    CommonlawError
        If it is not.
    """

    level: float = 0.25

    def __post_init__(self) -> None:
        if isinstance(self.level, str) or not 0 <= self.level <= 1:
            raise CommonlawError("quantile-level", level=self.level)

    def measure(self, magnitudes: Floats) -> Floats:
        return np.asarray(np.quantile(magnitudes, self.level, axis=0))


@dataclass(frozen=True)
class Count(AbstractImportance):
    """The number of objects whose coefficient has at least a given magnitude: a vote.

    Parameters
    ----------
    magnitude
        A coefficient of at least this magnitude is one vote for its term.

    Raises
    ------
    CommonlawError
        If the magnitude is not positive.
    """

    magnitude: float = 0.1

    def __post_init__(self) -> None:
        if isinstance(self.magnitude, str) or not self.magnitude > 0:
            raise CommonlawError("vote-magnitude", magnitude=self.magnitude)

    def measure(self, magnitudes: Floats) -> Floats:
        return np.asarray(np.sum(magnitudes >= self.magnitude, axis=0), dtype=np.float64)
