"""Parameters that measurements limit on one side only, such as a rate too fast to be measured."""

from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.estimation.problem import Problem
from commonlaw.estimation.search import Bounds, Objective, minimum
from commonlaw.law.quantiles import two_sided

VAGUE = 0.03
"""Relative standard error from which on the likelihood of a parameter is profiled.

A rate k that leaves ``A exp(-k h)`` at the first sample h, under noise of s, has the error ``s/(A exp(-k h))/h``: where
it has no upper limit this may be as little as 0.6/(k h) of it."""

MAX_PROFILES = 20
"""Parameters whose likelihood is profiled, the least certain ones."""

_FAR = (1e3, 1e2)
"""Multiples of an estimate up to which the likelihood of a parameter without an upper limit is flat."""

_NEAR = tuple(10.0**-power for power in range(9))
"""Multiples of an estimate among which the limit is looked for, each a power of ten below the last."""

_HALVINGS = 6
"""Of the power of ten that has the limit, on a logarithmic scale: it is within 2 % then."""

_MAX_STEPS = 5000
"""Steps of a solution far from the estimate, where equations may oscillate or grow as fast as one likes."""

_MAX_EVALUATIONS = 30
"""Residuals that are computed for one value of a parameter."""


@dataclass(frozen=True, eq=False)
class OneSided:
    """A 95 % limit of a parameter whose likelihood is flat beyond it, and all unknowns in the flat part, shape (p,)."""

    limit: float
    is_lower: bool
    unknowns: Floats


def one_sided(
    problem: Problem, unknowns: Floats, noise: Floats, bounds: Bounds, index: int, degrees_of_freedom: float
) -> OneSided | None:
    """Return the limit of an unknown that has no other one, None of others.

    The deviance ``2 (log L(best) - log L(k))`` of the profile likelihood, under known noise, stays below the squared
    quantile of a one-sided 95 % interval up to a thousand times the estimate on one side of zero, and is above it at
    the limit, nearer to zero, and on the other side. That is of Student's t distribution with the degrees of freedom of
    the noise, infinite where it is known.
    """
    size = abs(float(unknowns[index]))
    if not 0 < size < np.inf:
        return None
    quantile = float(two_sided(0.90, degrees_of_freedom)) ** 2
    objective = Objective(replace(problem, max_steps=_MAX_STEPS), noise)
    free = np.arange(len(unknowns)) != index
    costs = dict[float, tuple[float, Floats]]()

    def cost(value: float, start: Floats) -> float:
        value = float(np.clip(value, bounds.low[index], bounds.high[index]))
        if value not in costs:
            start = np.where(free, start, value)
            reached, squares = minimum(objective, start, free, bounds, tolerance=1e-8, steps=_MAX_EVALUATIONS)
            costs[value] = squares, reached
        return costs[value][0]

    def is_likely(value: float, start: Floats) -> bool:
        here = cost(value, start)
        return here - min(squares for squares, _ in costs.values()) <= quantile

    best = cost(float(unknowns[index]), unknowns)
    sides = [side for side in (1.0, -1.0) if cost(side * _FAR[0] * size, unknowns) - best <= quantile]
    if len(sides) != 1:
        return None
    side = sides[0]

    def at(value: float) -> Floats:
        return costs[float(np.clip(value, bounds.low[index], bounds.high[index]))][1]

    low, high, flat = 0.0, _FAR[0] * size, at(side * _FAR[0] * size)
    for multiple in (*_FAR[1:], 10.0, *_NEAR):
        if not is_likely(side * multiple * size, flat):
            low = multiple * size
            break
        high, flat = multiple * size, at(side * multiple * size)
    if low in (0.0, _FAR[1] * size):  # It may be zero, or has a limit beyond, too
        return None
    for _ in range(_HALVINGS):
        middle = float(np.sqrt(low * high))
        if is_likely(side * middle, flat):
            high, flat = middle, at(side * middle)
        else:
            low = middle
    if any(is_likely(-side * multiple, flat) for multiple in (low, 10 * low, _FAR[1] * size)):
        return None
    inside = min(10 * high, _FAR[0] * size)
    return None if not is_likely(side * inside, flat) else OneSided(side * high, side > 0, at(side * inside))
