"""How near a law comes to what another would measure, by other coefficients, within their errors, and other starts.

Where trajectories part as on a watershed, lines about the start that is set say that laws are told apart which imitate
each other all the same. So each law is linearised about where it imitates the most probable one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.experiments.gaussian import Gaussian

_CLOSE = 1.0
"""Twice the log-likelihood by which a fit may still get better; laws are told apart by several times that."""

_STEPS = 10
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
    """A law in a trial, fitted to what another law says of its measurements, shape (n,), as far as it has come."""

    target: Floats
    point: Point
    said: Gaussian

    @cached_property
    def _residuals(self) -> Floats:
        return self._turn @ (self.target - self.said.mean)

    @cached_property
    def _turn(self) -> Floats:
        return np.asarray(np.linalg.inv(self.said.root))

    @cached_property
    def deviance(self) -> float:
        """Minus twice the log-density of the measurements and of the unknowns, but for a constant."""
        return float(np.sum(self._residuals**2) + np.sum(self.point.unknowns**2))

    @cached_property
    def promise(self) -> tuple[Floats, float]:
        """The step of least squares (Gauss and Newton), shape (p + f,), and the deviance if all were linear."""
        unknowns = self.point.unknowns
        count, free = len(unknowns), len(self.point.shifts)
        slopes = self._turn @ np.column_stack([self.said.by_unknowns, self.said.by_start])
        columns = np.vstack([slopes, np.eye(count, count + free)])
        wanted = np.concatenate([self._residuals, -unknowns])
        step = np.linalg.lstsq(columns, wanted, rcond=None)[0]
        return np.asarray(step), float(np.sum((wanted - columns @ step) ** 2))

    @property
    def is_close(self) -> bool:
        """Whether next to nothing is promised."""
        return self.deviance < self.promise[1] + _CLOSE


def imitating(said: Sequence[Gaussian], targets: Sequence[Floats], linearise: Linearise, std: Floats) -> list[Gaussian]:
    """Return what a law says of trials, linearised about where it comes nearest to targets.

    Parameters
    ----------
    said
        The same about its own coefficients and the starts that are set.
    targets
        What another law expects to be measured in each of the trials, shape (n,).
    linearise
        See `Linearise`.
    std
        How far from the starts that are set the fits begin, too, shape (f,): on the other side of a watershed, perhaps;
        from those that are set alone, where these are zero.
    """
    around = [sign * each for each in np.diag(std)[std > 0] for sign in (1.0, -1.0)]
    begun = [_begun(said, targets, linearise, shifts) for shifts in (np.zeros_like(std), *around)]
    for fits in begun:
        _fit(fits, linearise)
    best = [min((each for each in own if each), key=lambda each: each.deviance) for own in zip(*begun, strict=True)]
    # A line through what it says there
    return [replace(each.said, mean=each.said.mean - each.said.by_unknowns @ each.point.unknowns) for each in best]


def _begun(
    said: Sequence[Gaussian], targets: Sequence[Floats], linearise: Linearise, shifts: Floats
) -> "list[_Fit | None]":
    points = [Point(np.zeros(each.by_unknowns.shape[1]), shifts) for each in said]
    found = linearise(range(len(said)), points) if shifts.any() else said
    triples = zip(targets, points, found, strict=True)
    return [None if own is None else _Fit(target, point, own) for target, point, own in triples]


def _fit(fits: "list[_Fit | None]", linearise: Linearise) -> None:
    """Replace fits by better ones, each until next to nothing is promised."""
    shares = {i: 1.0 for i, each in enumerate(fits) if each and not each.is_close}
    for _ in range(_STEPS):
        listed = {i: own for i in shares if (own := fits[i])}
        points = [own.point.moved(shares[i] * own.promise[0]) for i, own in listed.items()]
        for (i, own), point, found in zip(listed.items(), points, linearise(list(listed), points), strict=True):
            fit = None if found is None else _Fit(own.target, point, found)
            if fit is None or not fit.deviance < own.deviance:
                shares[i] /= 2
                continue
            fits[i], shares[i] = fit, min(1.0, 2 * shares[i])
            if fit.is_close:
                del shares[i]
