"""Laws fitted to measurements of an experiment: coefficients, within their errors, and the start.

Where trajectories part as on a watershed, lines about the coefficients and the start that is set say that laws are told
apart which imitate each other all the same. So each law is linearised about where it is nearest to what is measured.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.experiments.gaussian import Gaussian

_CLOSE = 1.0
"""Twice the log-likelihood by which a fit may still get better; laws are told apart by several times that."""

_STEPS = 15
"""Steps of a fit at most, those that lead to nothing better and are halved among them."""


@dataclass(frozen=True, eq=False)
class Point:
    """Where a law is linearised in a trial: unknowns, shape (p,), and what is added to free starts, shape (f,)."""

    unknowns: Floats
    shifts: Floats

    def moved(self, step: Floats) -> "Point":
        """Return the point a step away, shape (p + f,)."""
        count = len(self.unknowns)
        return Point(self.unknowns + step[:count], self.shifts + step[count:])


Linearise = Callable[[Sequence[int], Sequence[Point]], Sequence[Gaussian | None]]
"""From trials, by their numbers, and points to what a law says of them about these; nothing where it diverges."""


@dataclass(frozen=True, eq=False)
class _Fit:
    """A law in a trial, fitted to its measurements, shape (n,), as far as it has come."""

    measured: Floats
    point: Point
    said: Gaussian

    @cached_property
    def _residuals(self) -> Floats:
        return self.said.white((self.measured - self.said.mean)[:, np.newaxis])[:, 0]

    @cached_property
    def deviance(self) -> float:
        """Minus twice the log-density of the measurements and of the unknowns, but for a constant."""
        return float(np.sum(self._residuals**2) + np.sum(self.point.unknowns**2))

    @cached_property
    def promise(self) -> tuple[Floats, float]:
        """The step of least squares (Gauss and Newton), shape (p + f,), and the deviance if all were linear."""
        unknowns = self.point.unknowns
        count, free = len(unknowns), len(self.point.shifts)
        slopes = self.said.white(np.column_stack([self.said.by_unknowns, self.said.by_start]))
        columns = np.vstack([slopes, np.eye(count, count + free)])
        wanted = np.concatenate([self._residuals, -unknowns])
        step = np.linalg.lstsq(columns, wanted, rcond=None)[0]
        return np.asarray(step), float(np.sum((wanted - columns @ step) ** 2))

    @property
    def is_close(self) -> bool:
        """Whether next to nothing is promised."""
        return self.deviance < self.promise[1] + _CLOSE


def refitted(
    said: Sequence[Gaussian], points: Sequence[Point], measured: Sequence[Floats], linearise: Linearise
) -> list[Gaussian]:
    """Return what a law says of trials, linearised about where it comes nearest to their measurements.

    Parameters
    ----------
    said, points
        The same where the fits begin.
    measured
        In each of the trials, shape (n,).
    linearise
        See `Linearise`.
    """
    fits = [_Fit(*each) for each in zip(measured, points, said, strict=True)]
    shares = {i: 1.0 for i, each in enumerate(fits) if not each.is_close}
    for _ in range(_STEPS):
        moved = [fits[i].point.moved(share * fits[i].promise[0]) for i, share in shares.items()]
        for i, point, found in zip([*shares], moved, linearise([*shares], moved), strict=True):
            fit = None if found is None else _Fit(measured[i], point, found)
            if fit is None or not fit.deviance < fits[i].deviance:
                shares[i] /= 2
                continue
            fits[i], shares[i] = fit, min(1.0, 2 * shares[i])
            if fit.is_close:
                del shares[i]
    # A line through what it says there
    return [replace(each.said, mean=each.said.mean - each.said.by_unknowns @ each.point.unknowns) for each in fits]
