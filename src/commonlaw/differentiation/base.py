"""What every differentiator and every smoother is, and what they ask of a trial's samples."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.errors import CommonlawError


@dataclass(frozen=True)
class Rates:
    """The states of one trial, smoothed or as measured, and their first, second, ... derivatives by time.

    Each has the shape (n, d).
    """

    states: Floats
    derivatives: tuple[Floats, ...]


class AbstractDifferentiator(ABC):
    """From the samples of one trial to its smoothed states and rates."""

    takes_missing: ClassVar[bool] = False
    """Whether measured states may be missing (NaN)."""

    def reach(self, order: int) -> int | None:
        """Return how many samples away on each side the derivatives up to `order` at a sample can depend on.

        None, the default, means all of them. Near the ends of a trial, where formulas are one-sided, it may be more.
        """
        return None

    def takes(self, times: Floats, states: Floats) -> bool:
        """Whether these samples of a trial meet what the method assumes."""
        try:
            return (self.takes_missing or not np.isnan(states).any()) and bool(self.differentiate(times, states, 1))
        except CommonlawError:
            return False

    @abstractmethod
    def differentiate(self, times: Floats, states: Floats, order: int) -> Rates:
        """Return smoothed states and the derivatives up to `order`.

        Raises `CommonlawError` if the trial is too short for the method, or its sampling does not meet what the method
        assumes.

        Parameters
        ----------
        times
            Strictly increasing sample times, shape (n,).
        states
            Measured states, shape (n, d).
        order
            Highest derivative wanted: 1 or 2.
        """


class AbstractSmoother(ABC):
    """From measured states to smoothed states."""

    @property
    def half_window(self) -> int | None:
        """How many samples away on each side a smoothed state can depend on; None, the default, means all of them."""
        return None

    @abstractmethod
    def smooth(self, times: Floats, states: Floats) -> Floats:
        """Return the smoothed states, shape (n, d).

        Raises `CommonlawError` if the trial is shorter than the method's window.
        """


def need_samples(count: int, needed: int, method: str) -> None:
    """Refuse a trial of fewer samples than the method's formula takes."""
    if count < needed:
        raise CommonlawError("too-few-samples", count=count, needed=needed, method=method)


def check_uniform(times: Floats, tolerance: float, method: str) -> None:
    """Refuse times with a step that differs from the median step by more than `tolerance` of it."""
    steps = np.diff(times)
    median = np.median(steps)
    far = np.flatnonzero(np.abs(steps - median) > tolerance * median)
    if len(far):
        i = int(far[0])
        raise CommonlawError(
            "uneven-sampling",
            sample=i + 1,
            next_sample=i + 2,
            step=steps[i],
            median=median,
            method=method,
            tolerance=tolerance,
        )
