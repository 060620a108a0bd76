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
"""Multiple of an estimate up to which the likelihood of a parameter without an upper limit is flat; its share of one
without a lower limit."""

_NEAR_ERRORS = 4.0
"""Standard errors at which the deviance of most unknowns is above the quantile."""

_DECADES = (0, 1, 2, 3, 4, 5, 7, 10, 15, 20)
"""Powers of ten between the flat part and values where the limit is looked for, first; then intervals are halved."""

_PRECISION = 0.02
"""Relative, of a limit."""

_POINTS = 12
"""Values between a bound and a limit, at which the likelihood is integrated."""

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
    the noise, infinite where it is known. For an inverse, such as the time constant of a fast decay, it stays below the
    quantile down to a thousandth of the estimate, and is above it at the limit, farther from zero, and on the other
    side of zero. A deviance that is above it at four standard errors on both sides, or next to zero, as that of most
    unknowns, is not followed further.

    The bound of the unknown on its side of zero, beyond which its likelihood may well be low, does not count for the
    profile. The limit is within it: a flat part that is all beyond it has none.
    """
    indices, part = next(pair for pair in problem.apart() if index in pair[0])
    if len(indices) < len(unknowns):  # Other trials have the same likelihood everywhere
        at = int(np.searchsorted(indices, index))
        limit = one_sided(part, unknowns[indices], noise, bounds.of(indices), at, error, degrees_of_freedom)
        if limit is None:
            return None
        whole = unknowns.copy()
        whole[indices] = limit.unknowns
        return replace(limit, unknowns=whole)
    size, widest = abs(float(unknowns[index])), _FAR * 10.0 ** _DECADES[-1]
    if not widest * np.finfo(float).tiny < size < np.finfo(float).max / widest:  # Values of the profile would overflow
        return None
    quantile = float(two_sided(0.90, degrees_of_freedom)) ** 2
    objective = Objective(replace(problem, max_steps=min(problem.max_steps, _MAX_STEPS)), noise)
    free = np.arange(len(unknowns)) != index
    costs, estimate = dict[float, tuple[float, Floats]](), float(unknowns[index])
    low, high = float(bounds.low[index]), float(bounds.high[index])
    ends = (min(low, 0.0), np.inf) if estimate > 0 else (-np.inf, max(high, 0.0))

    def cost(value: float, start: Floats) -> float:
        value = float(np.clip(value, *ends))
        if value not in costs:
            start = np.where(free, start, value)
            reached, squares = minimum(objective, start, free, bounds, tolerance=1e-8, steps=_MAX_EVALUATIONS)
            costs[value] = squares, reached
        return costs[value][0]

    def is_likely(value: float, start: Floats) -> bool:
        here = cost(value, start)
        return here - min(squares for squares, _ in costs.values()) <= quantile

    def limit_from(side: float, start: float, direction: int) -> OneSided | None:
        """Return the limit from a flat part, of this sign, towards zero (-1) or away from it (1)."""

        def at(value: float) -> Floats:
            return costs[float(np.clip(side * value, *ends))][1]

        inside, outside, flat = start, np.nan, at(start)
        for power in _DECADES:
            value = start * 10.0 ** (direction * power)
            if not is_likely(side * value, flat):
                outside = value
                break
            inside, flat = value, at(value)
        if np.isnan(outside) or inside == start != size:  # There is no limit, or one on the other side, too
            return None
        while max(inside / outside, outside / inside) > 1 + _PRECISION:
            middle = float(np.sqrt(inside) * np.sqrt(outside))
            if is_likely(side * middle, flat):
                inside, flat = middle, at(middle)
            else:
                outside = middle
        if not np.isfinite(cost(side * outside, flat)):  # Too stiff to be solved, which excludes nothing
            return None
        is_lower, limit = (side > 0) == (direction < 0), float(np.clip(side * inside, low, high))
        if limit == (high if is_lower else low):
            return None
        back = 10.0**-direction
        if any(is_likely(-side * value, flat) for value in (outside, back * outside, start / back)):
            return None
        held = direction * max(direction * back * inside, direction * start)
        if not low < side * held < high:
            held = size
        return OneSided(limit, is_lower, at(held)) if is_likely(side * held, flat) else None

    def is_flat(value: float) -> bool:
        return cost(value, unknowns) - best <= quantile

    best, near, sign = cost(estimate, unknowns), min(_NEAR_ERRORS * error, _FAR * size), float(np.sign(estimate))
    if not any(is_flat(sign * value) for value in (size + near, max(size - near, size / _FAR))):
        return None
    # An estimate whose error is larger is in the flat part
    reach = 1.0 if error > _FAR * size else _FAR
    sides = [side for side in (1.0, -1.0) if is_flat(side * reach * size)]
    limit = limit_from(sides[0], reach * size, -1) if len(sides) == 1 else None
    nearest = sign * size / reach
    if limit is not None or sides not in ([], [sign]) or not is_flat(nearest) or is_flat(-nearest):
        return limit
    return limit_from(sign, size / reach, 1)


def moments_along(
    problem: Problem, unknowns: Floats, noise: Floats, bounds: Bounds, index: int, limit: OneSided
) -> Floats | None:
    """Return the second moments of unknowns about their estimates along the profile of one, shape (p, p).

    They are integrals over its values k from its bound to its limit, with the profile likelihood as weights,
    ``sum_k L(k) (u(k) - u) (u(k) - u)' / sum_k L(k)``: what a ridge adds to the covariances of others at its top.
    There are none without a bound on the side of the limit that is flat.
    """
    bound = float((bounds.high if limit.is_lower else bounds.low)[index])
    if not np.isfinite(bound):
        return None
    indices, part = next(pair for pair in problem.apart() if index in pair[0])
    start, within, at = unknowns[indices], bounds.of(indices), int(np.searchsorted(indices, index))
    objective, free = Objective(part, noise), np.arange(len(indices)) != at
    values = np.sort(bound + (limit.limit - bound) * (np.arange(_POINTS) + 0.5) / _POINTS)
    nearest = int(np.argmin(abs(values - start[at])))
    costs, moved = np.full(_POINTS, np.inf), np.zeros((_POINTS, len(start)))
    for way in (range(nearest, _POINTS), range(nearest - 1, -1, -1)):
        point = start
        for k in way:
            point = np.where(free, point, values[k])
            point, costs[k] = minimum(objective, point, free, within, tolerance=1e-8, steps=_MAX_EVALUATIONS)
            moved[k] = point - start
            point = point if np.isfinite(costs[k]) else start
    if not np.isfinite(costs).any():
        return None
    weights, seen = np.exp((np.min(costs) - costs) / 2), np.isfinite(costs)
    result = np.zeros((len(unknowns),) * 2)
    result[np.ix_(indices, indices)] = (moved[seen].T * weights[seen]) @ moved[seen] / float(weights.sum())
    return result
