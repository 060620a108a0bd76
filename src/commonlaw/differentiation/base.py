"""What every differentiator and every smoother is."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from commonlaw.array_types import Floats


@dataclass(frozen=True)
class Rates:
    """What a differentiator makes of the measured states of one trial.

    Parameters
    ----------
    states
        The states as the method sees them (smoothed, or as measured), shape (n, d).
    derivatives
        The first, second, ... derivatives by time, each of shape (n, d).
    """

    states: Floats
    derivatives: tuple[Floats, ...]


class AbstractDifferentiator(ABC):
    """From the samples of one trial to its smoothed states and rates."""

    takes_missing: ClassVar[bool] = False
    """Whether measured states may be missing (NaN)."""

    @abstractmethod
    def reach(self, order: int) -> int | None:
        """Return how many samples away on each side the derivatives up to `order` at a sample can depend on.

        None means all of them. Near the ends of a trial, where formulas are one-sided, it may be more.
        """

    @abstractmethod
    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        """Return smoothed states and the derivatives up to `order`.

        Parameters
        ----------
        times
            Strictly increasing sample times, shape (n,).
        states
            Measured states, shape (n, d).
        order
            Highest derivative wanted: 1 or 2.

        Raises
        ------
        CommonlawError
            If the trial is too short for the method, or its sampling does not meet what the method assumes.
        """


class AbstractSmoother(ABC):
    """From measured states to smoothed states."""

    @property
    @abstractmethod
    def half_window(self) -> int | None:
        """How many samples away on each side a smoothed state can depend on; None means all of them."""

    @abstractmethod
    def smooth(self, times: Floats, states: Floats) -> Floats:
        """Return the smoothed states, shape (n, d).

        Raises
        ------
        CommonlawError
            If the trial is shorter than the method's window.
        """
