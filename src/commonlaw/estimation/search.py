"""Maximum likelihood: from likely values to the best ones, by nonlinear least squares from several first values.

Starts are drawn about likely sizes (a Sobol sequence), ranked by their likelihood, and the best are improved on a
logarithmic scale, on which parameters of all sizes move alike, then as they are, within their bounds (Raue et al. 2013,
PLOS ONE 8, e74335).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.differentiation.noise import rounding_noise, within_trial_std
from commonlaw.errors import CommonlawError
from commonlaw.estimation.problem import Problem, TrialData
from commonlaw.likelihood import ERRORS, WHITE_NOISE, ByGroup, ErrorModel, Scales, by_group
from commonlaw.likelihood.levels import MOVED, covariance_by_levels, likeliest_levels, scales_of
from commonlaw.likelihood.mesh import MIN_NOISE
from commonlaw.likelihood.outliers import capped, likelier_loss, median_noise
from commonlaw.runtime.fit_options import ErrorKind
from commonlaw.runtime.time_limit import check
from commonlaw.text import counted

DRAWS = 128
"""First values whose likelihood is computed, and at most so many that are tried for one number, or drawn about it."""
TRIED = 16
"""Of these for each sample of the longest trial, as events between the same samples are alike."""
IMPROVED, FINISHED = 12, 4
"""Of these, at most how many are improved roughly (half as many with events, which take longer), and how many then to
the end."""
UNSEEN = 0.1
"""Expected share of first values that lead to maxima not seen so far, at which no more are improved."""
ALIKE = 1e-3
"""Of sums of squares, between which they are of one maximum."""
GROWING_SHARES = (0.2, 0.5, 1.0)
EVENT_SHARES = (1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2, 1.0)
"""Of the duration of trials, see `maximize`; the latter for models with events, the first of which may be early."""
SPREAD = 2.0
"""Standard deviation of the logarithm of a first value, and of values about an estimate in its standard errors."""
REACH = 16.0
"""How far from its likely size the logarithm of a parameter is looked for."""
STEPS_PER_SAMPLE, ROUGH_SHARE = 500, 5
"""Steps of a solution for each sample of the longest trial, and how many times fewer a rough one may take: what
oscillates, or has events, so often between samples is not estimated by these."""
LACK_OF_FIT = 3.0
"""Times the noise that residuals are where solutions do not fit."""
MAX_SLOPE_ERROR = 0.1
"""Relative error of the slope of solutions along a direction of the unknowns that measurements determine."""
_TINY = float(np.finfo(np.float64).tiny)
"""In place of zero, whose logarithm and inverse are infinite."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """Lowest and highest values of the unknowns, shape (p,) each."""

    low: Floats
    high: Floats

    def of(self, indices: Indices) -> "Bounds":
        """Return those of some unknowns."""
        return Bounds(self.low[indices], self.high[indices])


@dataclass(frozen=True, eq=False)
class Optimum:
    """Where the likelihood is largest.

    Parameters
    ----------
    unknowns
        Shape (p,).
    noise, degrees_of_freedom
        Standard deviation of each observable, of restricted maximum likelihood where it is estimated, and the degrees
        of freedom of that estimate, infinite where it is known, shape (m,) each.
    log_likelihood
        With the noise of maximum likelihood.
    covariance
        Of the unknowns, zero for those at a bound, shape (p, p).
    at_bound
        Which unknowns are at a bound, and `beyond` where they would be without it with its standard error.
    starts_alike
        How many of the best first values lead there; 0 if no others were tried.
    """

    unknowns: Floats
    noise: Floats
    degrees_of_freedom: Floats
    log_likelihood: float
    covariance: Floats
    at_bound: Bools
    beyond: tuple[Floats, Floats]
    starts_alike: int


class Objective:
    """Standardized residuals and their derivatives by the unknowns, kept for those that were asked for last."""

    def __init__(self, problem: Problem, noise: Floats) -> None:
        self.problem, self.noise = problem, noise
        self.last: Floats | None = None

    def _compute(self, unknowns: Floats) -> None:
        if self.last is None or not np.array_equal(unknowns, self.last):
            with np.errstate(all="ignore"):
                self.values, self.slopes = self.problem.residuals(unknowns, self.noise)
            self.last = unknowns.copy()

    def residuals(self, unknowns: Floats) -> Floats:
        self._compute(unknowns)
        return self.values

    def jacobian(self, unknowns: Floats) -> Floats:
        self._compute(unknowns)
        assert self.slopes is not None
        return np.asarray(np.nan_to_num(self.slopes))


def minimum(
    objective: Objective,
    start: Floats,
    free: Bools,
    bounds: Bounds | None = None,
    *,
    scale: Floats | None = None,
    tolerance: float,
    steps: int,
) -> tuple[Floats, float]:
    """Return the unknowns of least squares that are reached from a start, changing those that are free, and the sum.

    Within bounds it is sought by trust regions (Branch, Coleman and Li 1999), otherwise by the method of Levenberg and
    Marquardt. With a scale, variables and bounds are ``log(unknowns / scale)``. The sum is infinite where the search
    fails, or residuals are not finite at the start.
    """
    check()
    from scipy.optimize import least_squares

    def whole(point: Floats) -> Floats:
        result = start.copy()
        with np.errstate(over="ignore"):
            result[free] = point if scale is None else scale[free] * np.exp(point)
        return result

    def residuals(point: Floats) -> Floats:
        return np.nan_to_num(objective.residuals(whole(point)), nan=1e30, posinf=1e30, neginf=-1e30)

    def jacobian(point: Floats) -> Floats:
        unknowns = whole(point)
        slopes = objective.jacobian(unknowns)[:, free]
        return np.asarray(slopes if scale is None else np.nan_to_num(slopes * unknowns[free]))

    first = start[free] if scale is None else np.log(start[free] / scale[free])
    low, high = (np.full(len(first), -np.inf), np.full(len(first), np.inf))
    if bounds is not None:
        low, high = bounds.low[free], bounds.high[free]
        gap = 1e-10 * np.minimum(np.maximum(1.0, np.abs(first)), high - low)
        first = np.clip(first, low + gap, high - gap)
    values = objective.residuals(whole(first))
    if not np.isfinite(values).all():
        return whole(first), np.inf
    if not free.any():
        return start, float(values @ values)
    try:
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # Squares of large and tiny steps
            optimum = least_squares(
                residuals,
                first,
                jacobian,
                (low, high),
                method="lm" if bounds is None and len(values) >= len(first) else "trf",
                x_scale="jac",
                ftol=tolerance,
                xtol=tolerance,
                gtol=tolerance,
                max_nfev=steps,
            )
    except (ValueError, np.linalg.LinAlgError):  # Derivatives that overflow
        return whole(first), np.inf
    end = whole(optimum.x)
    return (end, float(2 * optimum.cost)) if np.isfinite(end).all() else (whole(first), np.inf)


def _polished(problem: Problem, unknowns: Floats, noise: Floats, bounds: Bounds, is_near: bool = False) -> Floats:
    """Return the same after Levenberg-Marquardt searches of what is inside of the bounds, the others held at theirs.

    A bounded search approaches bounds from inside, and slowly; here what the gradient pulls out is set to its bound.
    First each number is searched by its logarithm, in which valleys of the likelihood are straighter, unless it is near
    its best value, then as it is, and so each time that others are held.
    """
    objective = Objective(problem, noise)
    held = np.zeros(len(unknowns), dtype=np.bool_)
    for round_ in range(2 * len(unknowns) + 1):
        gaps = np.stack([unknowns - bounds.low, bounds.high - unknowns])
        gradient = objective.jacobian(unknowns).T @ objective.residuals(unknowns)
        size = np.minimum(np.abs(unknowns), bounds.high - bounds.low)
        with np.errstate(divide="ignore"):  # So near to a bound there is no difference to the residuals
            reach = np.minimum(1e-3 / np.sqrt(np.sum(objective.jacobian(unknowns) ** 2, axis=0)), 1e300)
        near = gaps <= np.maximum(1e-3 * size, reach)
        held |= (near[0] & (gradient > 0)) | (near[1] & (gradient < 0))
        start = np.where(held, np.where(gaps[0] <= gaps[1], bounds.low, bounds.high), unknowns)
        free = ~held
        at_bounds = float(np.sum(objective.residuals(start) ** 2))
        if not np.isfinite(at_bounds):
            break
        if at_bounds > 1 + 2 * float(np.sum(objective.residuals(unknowns) ** 2)):  # It jumps, as x/(K + x) at K = 0
            start = unknowns
        point = start
        if not is_near and round_ == 0:
            point = _by_levenberg_marquardt(objective, start, free & (start != 0), logarithms=True)
        # Steps of the next search are at first of the size of the values
        point = np.where(np.abs(point) < np.exp(-REACH) * np.abs(start), 0.0, point)
        point = _by_levenberg_marquardt(objective, point, free)
        outside = (point < bounds.low) | (point > bounds.high)
        gradient = objective.jacobian(point).T @ objective.residuals(point)
        inward = held & np.where(point == bounds.low, gradient < 0, gradient > 0)
        if not (outside | inward).any():
            return point
        # What a search held wrongly is let go once no other leaves its bounds
        held = held | outside if outside.any() else held & ~inward
        unknowns = np.clip(point, bounds.low, bounds.high)
    return unknowns


def _by_levenberg_marquardt(objective: Objective, start: Floats, free: Bools, logarithms: bool = False) -> Floats:
    scale, steps = (start, 200) if logarithms else (None, 40)
    return minimum(objective, start, free, scale=scale, tolerance=1e-13, steps=steps)[0]


def first_values(sizes: Floats, guessed: Bools, bounds: Bounds, seed: int, likely: Floats | None = None) -> Floats:
    """Return first values, shape (draws, p), the sizes first; those that were guessed are the same in all.

    Others scatter about the sizes or, every other pair of them, about likely ones, if these differ. Sizes that are out
    of bounds are at these, unless they would be zero.
    """
    from scipy.special import ndtri
    from scipy.stats import qmc

    count = len(sizes)
    draws = qmc.Sobol(2 * count, seed=seed).random(DRAWS) if count else np.zeros((DRAWS, 0))
    spread = np.exp(SPREAD * ndtri(np.clip(draws[:, :count], 1e-6, 1 - 1e-6)))
    negative = (bounds.low < 0) & (draws[:, count:] < 0.2) & (np.arange(DRAWS) % 2 == 1)[:, np.newaxis]
    centers = np.tile(sizes, (DRAWS, 1))
    centers[2::4] = centers[3::4] = sizes if likely is None else likely
    starts = np.where(guessed, sizes, centers * spread * np.where(negative, -1.0, 1.0))
    starts[0] = sizes
    low, high = bounds.low, bounds.high
    both = np.isfinite(low) & np.isfinite(high)
    outside = (starts < low) | (starts > high)
    inner = np.where(both, low + draws[:, :count] * np.where(both, high - low, 0.0), starts)
    one = np.where(np.isfinite(low), low + np.abs(starts), high - np.abs(starts))
    inside = np.where(outside, np.where(both, inner, one), starts)
    nearest = np.clip(sizes, low, high)
    inside[0] = np.where(nearest == 0, inside[0], nearest)
    return np.asarray(inside)


def rough_noise(problem: Problem, share: float = 0.1) -> Floats:
    """Return noise to begin with where it is not known: a share of how measurements scatter, shape (m,)."""
    values = np.concatenate([trial.trial.states for trial in problem.trials])
    result = np.ones(values.shape[1])
    for k, column in enumerate(values.T):
        seen = column[np.isfinite(column)]
        spread = float(np.std(seen)) if len(seen) > 1 else 0.0
        result[k] = share * (spread or float(np.max(np.abs(seen), initial=0.0)) or 1.0)
    return result


def is_solved(problem: Problem, unknowns: Floats) -> bool:
    """Return whether the solutions of all trials are finite."""
    return bool(np.isfinite(_cost(_rough(problem), unknowns, rough_noise(problem))))


def _rough(problem: Problem) -> Problem:
    """Return the problem with rough solutions."""
    return replace(problem, tolerance=1e-4, max_steps=problem.max_steps // ROUGH_SHARE)


def with_step_limit(problem: Problem, first: Floats) -> Problem:
    """Return the problem with so many steps of a solution as samples may need, or more if that of first values does."""
    steps = STEPS_PER_SAMPLE * max(len(data.times) for data in problem.trials)
    limited = replace(problem, max_steps=min(steps, problem.max_steps))
    return problem if is_solved(problem, first) and not is_solved(limited, first) else limited


def maximize(
    problem: Problem,
    sizes: Floats,
    guessed: Bools,
    bounds: Bounds,
    noise: Floats | None,
    seed: int,
    progress: Callable[[str], None],
    draws: int = DRAWS,
    shares: Sequence[float] = (1.0,),
    likely: Floats | None = None,
) -> Optimum:
    """Return where the likelihood is largest, from the given first values and as many more as make up the draws.

    These scatter about the first ones and likely ones, if there are others, see `first_values`.

    Trials that have no unknowns in common have starts of their own, of which the best are combined. Starts are improved
    on first parts of the trials, of these shares of their duration, one after the other. Over many
    cycles the likelihood of an oscillation has as many local maxima; over the first one it has few.

    Times and thresholds of events are even over what trials cover in half of the starts, of which the first are
    improved on whole trials, too: the likelihood has a maximum in most intervals between samples, and over a first part
    an early event may stand for the wrong value of another parameter.

    Raises
    ------
    CommonlawError
        If the solution is finite from none of the first values.
    """
    from scipy.stats import qmc

    given = noise is not None
    noise = rough_noise(problem) if noise is None else noise
    starts = first_values(sizes, guessed, bounds, seed, likely)[: draws if problem.unknowns else 1]
    spread = [*problem.event_ranges] if draws > 1 else []
    if spread:
        low, high = np.transpose([*problem.event_ranges.values()])
        even = low + (high - low) * qmc.Sobol(len(spread), seed=seed).random(len(starts) // 2)
        starts[1::2, spread] = np.clip(even, bounds.low[spread], bounds.high[spread])
    unsolved = CommonlawError("no-finite-start", draws=len(starts))
    if problem.model.events:
        unsolved = CommonlawError("no-finite-start-with-events", draws=len(starts))
    if problem.model.steady:
        names = [problem.model.variables.states[j] for j in problem.model.steady]
        unsolved = CommonlawError("no-steady-state", states=names, draws=len(starts))
    random, attempts = np.random.default_rng(seed), list[list[tuple[float, Floats]]]()
    parts = problem.apart() if draws > 1 else [(np.arange(problem.unknowns), problem)]
    for indices, part in parts:
        within, first = bounds.of(indices), starts[:, indices]
        rough = _improved(part, first, sizes[indices], within, noise, shares, random, progress)
        if not rough:
            raise unsolved
        attempts.append(rough)
    best = np.zeros((min(FINISHED, max(map(len, attempts))), problem.unknowns))
    for (indices, _), rough in zip(parts, attempts, strict=True):
        best[:, indices] = [rough[min(rank, len(rough) - 1)][1] for rank in range(len(best))]
    progress("fitting parameters")
    score, unknowns, ends = np.inf, best[0], list[float]()
    first = noise
    for start in best:
        end, values, levels = _finished(problem, start, first, bounds, given, score + 1.0)
        ends.append(end)
        if end < score or not np.isfinite(score):
            score, unknowns, noise = end, values, levels
    if not np.isfinite(score):
        raise unsolved
    for _ in range(FINISHED if problem.events_move else 0):
        start = _resampled(problem, unknowns, noise, bounds, random)
        end, values, levels = _finished(problem, start, noise, bounds, given, np.inf)
        if end < score:
            score, unknowns, noise = end, values, levels
    alike = sum(end - score < 0.01 for end in ends) if draws > 1 else 0
    if not given and not problem.censored.any() and _noise_matters(problem):
        unknowns, noise = _under_restricted_noise(problem, unknowns, noise, bounds)
    return _summary(problem, unknowns, noise, bounds, given, alike)


def _improved(
    problem: Problem,
    starts: Floats,
    sizes: Floats,
    bounds: Bounds,
    noise: Floats,
    shares: Sequence[float],
    random: np.random.Generator,
    progress: Callable[[str], None],
) -> list[tuple[float, Floats]]:
    """Return the best of some first values, roughly improved, by their sums of squares; see `maximize`."""
    progress(f"computing the likelihood of {counted(len(starts), 'first value')}")
    coarse = _rough(problem)
    parts = _growing(coarse, shares)
    costs = np.array([_cost(parts[0], start, noise) for start in starts])
    improved = IMPROVED // 2 if problem.events_move else IMPROVED
    ranked = [0, *(int(i) for i in np.argsort(costs) if i)][: improved if problem.unknowns else 1]
    rough = list[tuple[float, Floats]]()
    for i in ranked:
        inside = [cost for cost, point in rough if not _ran_away(point, sizes)]
        if not problem.events_move and expected_unseen(inside) <= UNSEEN:
            break
        progress(f"improving parameters, start {len(rough) + 1} of {len(ranked)}")
        if not np.isfinite(costs[i]):
            continue
        point = starts[i]
        if len(starts) == 1:
            return [(costs[i], point)]
        for part in parts:
            if not problem.events_move:
                cost, point = _roughly(part, point, noise, bounds, sizes)
                continue
            cost, point = _roughly(part, _scanned(part, point, noise, bounds, sizes), noise, bounds, sizes)
            near = _resampled(part, point, noise, bounds, random)
            cost, point = min((cost, point), _roughly(part, near, noise, bounds, sizes), key=lambda scored: scored[0])
        rough.append((cost, point))
    with_even = starts[1 : DRAWS // 4 : 2] if problem.event_ranges and np.isfinite(costs).any() else ()
    for i, start in enumerate(with_even):
        progress(f"improving values of events, start {i + 1} of {len(with_even)}")
        rough.append(_roughly(coarse, start, noise, bounds, sizes))
    return sorted((attempt for attempt in rough if np.isfinite(attempt[0])), key=lambda attempt: attempt[0])


def _ran_away(point: Floats, sizes: Floats) -> bool:
    """Return whether a number is as far from its likely size as it is looked for, where there is no maximum."""
    with np.errstate(divide="ignore"):
        return bool(np.any(np.abs(np.log(np.abs(point / sizes))) > 0.99 * REACH))


def expected_unseen(costs: Sequence[float]) -> float:
    """Return the expected share of first values that lead to maxima not seen so far, from sums of squares of some.

    Of n first values that led to w maxima it is ``w (w + 1)/(n (n - 1))`` (Boender and Rinnooy Kan 1987, Math. Program.
    37, 59).
    """
    ends, n = np.sort(costs), len(costs)
    maxima = 1 + int(np.sum(np.diff(ends) > ALIKE * ends[1:]))
    return maxima * (maxima + 1) / (n * (n - 1)) if n > 1 else 1.0


def _growing(problem: Problem, shares: Sequence[float]) -> list[Problem]:
    """Return the problems of first parts of the trials, the last of which is whole.

    Each part has more times than the one before, and the first one has some after the initial ones.
    """
    parts = [_first(problem, share) for share in shares[:-1]]
    sizes = [sum(len(data.times) for data in part.trials) for part in (*parts, problem)]
    growing = zip(parts, sizes, sizes[1:], strict=False)
    return [*(part for part, size, later in growing if len(problem.trials) < size < later), problem]


def _first(problem: Problem, share: float) -> Problem:
    """Return the problem of the first parts of the trials."""
    changed = list[TrialData]()
    for data in problem.trials:
        begin, end = data.times[[0, -1]]
        last = begin + share * (end - begin)
        kept = data.trial.times <= max(last, data.trial.times[0])
        changed.append(replace(data.seen(kept), times=data.times[data.times <= max(last, data.trial.times[0])]))
    return replace(problem, trials=tuple(changed))


def _cost(problem: Problem, unknowns: Floats, noise: Floats) -> float:
    residuals, _ = problem.residuals(unknowns, noise, False)
    with np.errstate(all="ignore"):
        # A few measurements that a first value misses by far do not rank it
        total = float(np.log1p(residuals**2).sum())
    return total if np.isfinite(residuals).all() else np.inf


def _roughly(problem: Problem, start: Floats, noise: Floats, bounds: Bounds, sizes: Floats) -> tuple[float, Floats]:
    """Return the sum of squares and the values after a search on a logarithmic scale, signs as they are."""
    signs = np.where(start < 0, -1.0, 1.0)
    start = signs * np.maximum(np.abs(start), 1e-12 * np.abs(sizes) + _TINY)
    middle, near = np.log(np.abs(start)), np.log(np.abs(sizes) + _TINY)
    low = np.minimum(near - REACH, middle - 1)
    high = np.maximum(near + REACH, middle + 1)
    least = np.where(signs > 0, bounds.low, -bounds.high)
    most = np.where(signs > 0, bounds.high, -bounds.low)
    low = np.where(least > 0, np.log(np.maximum(least, _TINY)), low)
    high = np.where(np.isfinite(most) & (most > 0), np.log(np.maximum(most, _TINY)), high)
    within, free = Bounds(np.minimum(low, high - 1e-6), high), np.ones(len(start), dtype=np.bool_)
    objective = Objective(problem, noise)
    unknowns, squares = minimum(objective, start, free, within, scale=signs, tolerance=1e-6, steps=60)
    return squares, unknowns


def _tried(problem: Problem) -> int:
    """Return how many values are tried where the times of events matter."""
    return min(DRAWS, TRIED * max(len(data.rows) for data in problem.trials))


def _scanned(problem: Problem, start: Floats, noise: Floats, bounds: Bounds, sizes: Floats) -> Floats:
    """Return values of which those in events are the best of many about their sizes, one after the other.

    Where an event moves over a sample the likelihood jumps, and searches along its slope end there.
    """
    from scipy.special import ndtri

    point, quantiles = start, (np.arange(_tried(problem) // 2) + 0.5) / (_tried(problem) // 2)
    for k in problem.event_unknowns:
        concerned = replace(problem, trials=tuple(data for data in problem.trials if k in data.parameter))
        least = _cost(concerned, point, noise)
        values = np.abs(sizes[k]) * np.exp(SPREAD * ndtri(quantiles))
        values = np.append(values, -values)
        for value in values[(values >= bounds.low[k]) & (values <= bounds.high[k])]:
            moved = np.where(np.arange(len(point)) == k, value, point)
            cost = _cost(concerned, moved, noise)
            if cost < least:
                least, point = cost, moved
    return point


def _resampled(problem: Problem, point: Floats, noise: Floats, bounds: Bounds, random: np.random.Generator) -> Floats:
    """Return the best of values that are drawn about an estimate, with a multiple of its standard errors."""
    rows = problem.information(point, noise)
    if not np.isfinite(rows).all():
        return point
    scale = np.sqrt(np.sum(rows**2, axis=0)) + _TINY
    root = SPREAD * np.linalg.pinv(rows / scale, rcond=1e-8).T / scale
    near = np.clip(point + random.standard_normal((_tried(problem), len(rows))) @ root, bounds.low, bounds.high)
    return np.asarray(min(near, key=lambda drawn: _cost(problem, drawn, noise)))


def _finished(
    problem: Problem, start: Floats, noise: Floats, bounds: Bounds, given: bool, hopeless: float
) -> tuple[float, Floats, Floats]:
    """Return the negative log-likelihood (with priors), values and noise where the likelihood is largest.

    It is infinite where the first round leads to one that is larger than a hopeless one.
    """
    unknowns, middling = start, replace(problem, tolerance=1e-6)
    free = np.ones(len(start), dtype=np.bool_)
    unknown = ~problem.known_noise & (problem.counts > 0)
    fixed = given or not unknown.any()
    once = (given or not _noise_matters(problem)) and not problem.censored.any()
    for round_ in range(60):
        objective = Objective(middling, noise)
        if round_ == 0:
            unknowns, _ = minimum(objective, unknowns, free, bounds, tolerance=1e-10, steps=100)
            if _score(problem, unknowns, noise, fixed)[0] > hopeless:
                return np.inf, unknowns, noise
        unknowns = _polished(problem, unknowns, noise, bounds, is_near=round_ > 0)
        score, levels = _score(problem, unknowns, noise, fixed)
        done = once or np.allclose(levels, noise, rtol=1e-6)
        noise = levels
        if done:
            break
    return score, unknowns, noise


def _noise_matters(problem: Problem) -> bool:
    """Return whether estimates depend on noise that is estimated: the least squares of one quantity do not."""
    unknown = int((~problem.known_noise & (problem.counts > 0)).sum())
    return unknown > 1 or (unknown == 1 and (bool(problem.known_noise.any()) or bool(problem.priors)))


def _under_restricted_noise(problem: Problem, unknowns: Floats, noise: Floats, bounds: Bounds) -> tuple[Floats, Floats]:
    """Return estimates under the noise of restricted maximum likelihood, and this, by fixed-point iteration.

    That of maximum likelihood is too small, the more so the more unknowns an observable determines, whose measurements
    would then weigh too much (Harville 1977, J. Am. Stat. Assoc. 72, 320).
    """
    for _ in range(60):
        free = (unknowns != bounds.low) & (unknowns != bounds.high)
        levels = problem.noise_levels(unknowns, noise, problem.leverage(unknowns, noise, free).sum(axis=0))
        noise, before = _not_zero(levels, problem), noise
        unknowns = _polished(problem, unknowns, noise, bounds, is_near=True)
        if np.allclose(noise, before, rtol=1e-6):
            break
    return unknowns, noise


def _score(problem: Problem, unknowns: Floats, noise: Floats, fixed: bool) -> tuple[float, Floats]:
    """Return the negative log-likelihood with priors, and the noise of maximum likelihood."""
    levels = noise if fixed else problem.noise_levels(unknowns, noise)
    levels = _not_zero(levels, problem)
    priors = sum(0.5 * float(np.sum(prior.residuals(unknowns) ** 2)) for prior in problem.priors)
    score = priors - problem.log_likelihood(unknowns, levels)
    return (float(score) if np.isfinite(score) else np.inf), levels


def _not_zero(levels: Floats, problem: Problem) -> Floats:
    """Return the noise, at least at the size of rounding errors, of exact measurements."""
    return np.maximum(levels, rough_noise(problem, 1e-13))


def without_outliers(
    problem: Problem, threshold: float, optimum: Optimum, first: Floats, bounds: Bounds
) -> tuple[Problem, Optimum]:
    """Return the problem that rejects outliers, and its optimum, if the evidence for these is very strong.

    The search begins from the optimum of least squares and from first values, with the noise of median residuals there,
    under the Huber loss. The evidence is that of likelihoods in which outliers are as likely as a measurement at the
    threshold.
    """
    robust = replace(problem, huber_threshold=threshold)

    def under_loss(start: Floats) -> Iterator[tuple[Problem, Optimum]]:
        noise = _median_noise(problem, start)
        if noise is None or not any(far.any() for far in robust.outliers(start, noise)):
            return
        unknowns, noise = _under_restricted_noise(robust, start, noise, bounds)
        rejecting = replace(robust, rejects=True)
        unknowns, noise = _under_restricted_noise(rejecting, unknowns, noise, bounds)
        yield rejecting, _summary(rejecting, unknowns, noise, bounds, given=False, alike=optimum.starts_alike)

    fits = (fit for start in (optimum.unknowns, first) for fit in under_loss(start))
    return likelier_loss((problem, optimum), fits, _capped_deviance)


def _median_noise(problem: Problem, unknowns: Floats) -> Floats | None:
    """Return the noise of median residuals, where it is not known; None where there is no solution."""
    residuals = [
        (problem.predicted(data, unknowns, False).values - data.trial.states) / data.trial.averaging
        for data in problem.trials
    ]
    whole = np.concatenate(residuals)
    if np.isinf(whole).any() or not np.isfinite(whole).any(axis=0).all():
        return None
    # Residuals of exact measurements are errors of solutions, which are not normal
    return np.maximum(median_noise(whole), rough_noise(problem, MIN_NOISE))


def _capped_deviance(fit: tuple[Problem, Optimum]) -> float:
    """Return minus twice the log-likelihood of a fit, see `capped`."""
    problem, optimum = fit
    parts = problem.standardized(optimum.unknowns, optimum.noise, False)
    return sum(part.deviance + float(capped(part.z[part.seen], problem.huber_threshold).sum()) for part in parts)


def under_errors(problem: Problem, kind: ErrorKind, optimum: Optimum, bounds: Bounds) -> tuple[Problem, Optimum]:
    """Return the problem under an error model, and its optimum, from that under white noise.

    Unless the problem has levels of errors, they alternate with the unknowns: levels are those of restricted maximum
    likelihood about the solutions. The log-likelihood is then that of the levels of maximum likelihood.
    """
    unknowns, noise, errors, is_known = optimum.unknowns, optimum.noise, problem.errors, bool(problem.errors)
    levels, m, model = None, len(noise), ERRORS[kind]
    problem = replace(problem, rejects=problem.rejects and model.is_independent)
    for _ in range(20):
        if isinstance(model, ByGroup) and not is_known:
            noise, errors = _noise_by_group(problem, kind, unknowns, noise, bounds)
            if not errors:
                return problem, optimum
        elif not is_known:
            levels = _levels(problem, kind, unknowns, noise, bounds, levels)
            noise, errors = levels[:m], model.model(levels[m:])
        problem, before = problem.about(unknowns, noise, errors), unknowns
        unknowns = _polished(problem, before, noise, bounds, is_near=True)
        if np.linalg.norm(problem.information(unknowns, noise) @ (unknowns - before)) < MOVED:
            break
    optimum = _summary(problem, unknowns, noise, bounds, given=False, alike=optimum.starts_alike)
    if is_known:
        return problem, optimum
    if model.is_of_trials:
        covariance, free = optimum.covariance.copy(), ~optimum.at_bound
        fit, every = problem.linearized(unknowns, noise, free), np.concatenate([noise, errors.levels])
        limits = _bounds_of_levels(problem)
        covariance[np.ix_(free, free)] += covariance_by_levels(model, [fit], every, problem.known_noise, *limits)[0]
        optimum = replace(optimum, covariance=covariance)
    if isinstance(model, ByGroup):
        noise, errors = _noise_by_group(problem, kind, unknowns, noise, bounds, restricted=False)
    else:
        levels = _levels(problem, kind, unknowns, noise, bounds, levels, restricted=False)
        noise, errors = levels[:m], model.model(levels[m:])
    at_levels = problem.about(unknowns, noise, errors)
    return problem, replace(optimum, log_likelihood=at_levels.log_likelihood(unknowns, noise))


def _noise_by_group(
    problem: Problem, kind: ErrorKind, unknowns: Floats, noise: Floats, bounds: Bounds, restricted: bool = True
) -> tuple[Floats, ErrorModel]:
    """Return the noise of all objects, and that of each group of quantities for which the evidence is for scatter."""
    free = (unknowns != bounds.low) & (unknowns != bounds.high)
    residuals = problem.noise_by_group(kind, unknowns, noise, free, restricted)
    scatters = (problem.scatters if problem.errors else residuals.evidence > 0) & ~problem.known_noise
    levels, factors = residuals.levels(scatters)
    if not scatters.any():
        return noise, WHITE_NOISE
    errors = by_group(kind).of_factors([data.trial for data in problem.trials], factors)
    return np.where(problem.known_noise, noise, levels), errors


def _levels(
    problem: Problem,
    kind: ErrorKind,
    unknowns: Floats,
    noise: Floats,
    bounds: Bounds,
    first: Floats | None,
    restricted: bool = True,
) -> Floats:
    """Return the noise, other levels and times of largest (restricted) likelihood at unknowns, from first values."""
    known, (floor, scales) = problem.known_noise, _bounds_of_levels(problem)
    fit = problem.linearized(unknowns, noise, (unknowns != bounds.low) & (unknowns != bounds.high))
    return likeliest_levels(ERRORS[kind], [fit.orthogonal], noise, known, floor, scales, first, restricted)


def _bounds_of_levels(problem: Problem) -> tuple[Floats, Scales]:
    """Return the floor of the noise, shape (m,), and the scales of errors."""
    trials = [data.trial for data in problem.trials]
    std = np.maximum(within_trial_std(trials), rough_noise(problem, MIN_NOISE))
    return np.maximum(MIN_NOISE * std, rounding_noise(trials)), scales_of(std, trials)


def summarized(
    problem: Problem, unknowns: Floats, noise: Floats, bounds: Bounds, alike: int, held: Sequence[int] = ()
) -> Optimum:
    """Return the optimum at given unknowns, near a noise that is not known.

    The covariance is that given the unknowns that are held, whose variances are zero.
    """
    return _summary(problem, unknowns, noise, bounds, given=False, alike=alike, held=held)


def _summary(
    problem: Problem,
    unknowns: Floats,
    noise: Floats,
    bounds: Bounds,
    given: bool,
    alike: int,
    held: Sequence[int] = (),
) -> Optimum:
    """Return what is known where the likelihood is largest; what `_polished` left at a bound is exactly there."""
    at_bound = (unknowns == bounds.low) | (unknowns == bounds.high)
    unbiased, degrees = noise, np.full(len(noise), np.inf)
    if not given:
        unbiased, degrees = problem.restricted_noise(unknowns, _not_zero(noise, problem), ~at_bound)
    unbiased = _not_zero(unbiased, problem)
    likeliest = noise if given else _not_zero(problem.noise_levels(unknowns, unbiased), problem)
    covariance = np.zeros((len(unknowns), len(unknowns)))
    inner = np.setdiff1d(np.flatnonzero(~at_bound), held)
    covariance[np.ix_(inner, inner)] = _covariance(problem, unknowns, unbiased, inner)
    beyond, errors = unknowns.copy(), np.zeros(len(unknowns))
    if at_bound.any():
        free = np.ones(len(unknowns), dtype=np.bool_)
        beyond = _by_levenberg_marquardt(Objective(problem, unbiased), unknowns, free)
        levels = noise if given else problem.restricted_noise(beyond, unbiased, free)[0]
        whole = _covariance(problem, beyond, _not_zero(levels, problem), np.arange(len(unknowns)))
        errors = np.sqrt(np.maximum(np.diagonal(whole), 0.0))
    log_likelihood = problem.log_likelihood(unknowns, likeliest)
    return Optimum(unknowns, unbiased, degrees, log_likelihood, covariance, at_bound, (beyond, errors), alike)


def _covariance(problem: Problem, unknowns: Floats, noise: Floats, inner: Indices) -> Floats:
    """Return the covariance of some unknowns given the others, infinite for those that are not determined.

    With the rows R of the information and their errors E, by solutions of a hundredth of the tolerance, a direction v
    of scaled unknowns is not determined if ``|R v|`` is rounding, or ``|E v|`` more than a tenth of it. At switches,
    where rows jump, E is not estimated.
    """
    if not len(inner):
        return np.zeros((0, 0))
    rows, errors = (columns[:, inner] for columns in _information(problem, unknowns, noise))
    return _inverse(rows, errors)


def confounded(problem: Problem, optimum: Optimum) -> Indices:
    """Return the unknowns that measurements determine each given all others, but not together, by index.

    Such are the terms of a sum and the factors of a product, also where one of them is at a bound, which then limits
    the others.
    """
    if not optimum.at_bound.any() and np.isfinite(np.diagonal(optimum.covariance)).all():
        return np.zeros(0, dtype=np.intp)
    rows, errors = _information(problem, optimum.unknowns, optimum.noise)
    alone = np.flatnonzero(np.linalg.norm(errors, axis=0) < MAX_SLOPE_ERROR * np.linalg.norm(rows, axis=0))
    if not len(alone):
        return alone
    return alone[~np.isfinite(np.diagonal(_inverse(rows[:, alone], errors[:, alone])))]


def _information(problem: Problem, unknowns: Floats, noise: Floats) -> tuple[Floats, Floats]:
    """Return the rows of the information, and their errors, zero where these are not estimated."""
    rows = problem.information(unknowns, noise)
    squares = replace(problem, huber_threshold=np.inf)  # Without weights, which depend on errors of residuals
    finer, errors = replace(squares, tolerance=problem.tolerance / 100), np.zeros_like(rows)
    has_switches = len(problem.model.switched.outputs) > problem.model.width
    if not has_switches and np.isfinite(finer.residuals(unknowns, noise)[0]).all():
        errors = finer.information(unknowns, noise) - squares.information(unknowns, noise)
    return rows, errors


def _inverse(rows: Floats, errors: Floats) -> Floats:
    """Return the covariance of unknowns by the rows of their information and errors of these, see `_covariance`."""
    scale = np.sqrt(np.sum(rows**2, axis=0))
    scale = np.where(scale == 0, 1.0, scale)
    missing = max(0, len(scale) - len(rows))
    _, sizes, turned = np.linalg.svd(np.pad(rows / scale, ((0, missing), (0, 0))), full_matrices=False)
    directions, rounding = turned.T, np.finfo(float).eps * len(rows) * 10 * sizes.max(initial=0.0)
    errors = np.linalg.norm(errors / scale @ directions, axis=0)
    finite = sizes > np.maximum(rounding, errors / MAX_SLOPE_ERROR)
    result = (directions[:, finite] / sizes[finite] ** 2) @ directions[:, finite].T
    shares = np.sum(directions[:, ~finite] ** 2, axis=1)
    # Errors turn directions by their share of the least size of the determined ones
    turn = np.linalg.norm(errors) / np.min(sizes[finite], initial=np.inf)
    lost = shares > min(max(1e-6, turn**2), 0.1 * shares.max())
    result = result / scale / scale[:, np.newaxis]
    result[lost, lost] = np.inf
    return np.asarray(result)
