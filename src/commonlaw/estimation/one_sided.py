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

_FAR = 1e3
"""Multiple of an estimate up to which the likelihood of a parameter without an upper limit is flat."""

_NEAR_ERRORS = 4.0
"""Standard errors at which the deviance of most unknowns is above the quantile."""

_DECADES = (0, 1, 2, 3, 4, 5, 7, 10, 15, 20)
"""Powers of ten by which a value is divided where the limit is looked for, first; then intervals are halved."""

_PRECISION = 0.02
"""Relative, of a limit."""

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
    problem: Problem,
    unknowns: Floats,
    noise: Floats,
    bounds: Bounds,
    index: int,
    error: float,
    degrees_of_freedom: float,
) -> OneSided | None:
    """Return the limit of an unknown that has no other one, None of others.

    The deviance ``2 (log L(best) - log L(k))`` of the profile likelihood, under known noise, stays below the squared
    quantile of a one-sided 95 % interval up to a thousand times the estimate on one side of zero, and is above it at
    the limit, nearer to zero, and on the other side. That is of Student's t distribution with the degrees of freedom of
    the noise, infinite where it is known. A deviance that is above it at four standard errors on both sides, as that of
    most unknowns, is not followed further.
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

    estimate = float(unknowns[index])
    best, near = cost(estimate, unknowns), min(_NEAR_ERRORS * error, _FAR * size)
    if all(cost(estimate + side * near, unknowns) - best > quantile for side in (1.0, -1.0)):
        return None
    # An estimate whose error is larger is in the flat part
    far = size if error > _FAR * size else _FAR * size
    sides = [side for side in (1.0, -1.0) if cost(side * far, unknowns) - best <= quantile]
    if len(sides) != 1:
        return None
    side = sides[0]

    def at(value: float) -> Floats:
        return costs[float(np.clip(side * value, bounds.low[index], bounds.high[index]))][1]

    low, high, flat = 0.0, far, at(far)
    for power in _DECADES:
        value = far * 10.0**-power
        if not is_likely(side * value, flat):
            low = value
            break
        high, flat = value, at(value)
    if low == 0 or high == far > size:  # It may be zero, or has a limit beyond, too
        return None
    while high > (1 + _PRECISION) * low:
        middle = float(np.sqrt(low * high))
        if is_likely(side * middle, flat):
            high, flat = middle, at(middle)
        else:
            low = middle
    if any(is_likely(-side * value, flat) for value in (low, 10 * low, 0.1 * far)):
        return None
    inside = min(10 * high, far)
    return OneSided(side * high, side > 0, at(inside)) if is_likely(side * inside, flat) else None
