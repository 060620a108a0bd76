"""Levels of errors about a fit, of either scheme: bounds, first values, and those of largest restricted likelihood.

With residuals r = h - y of covariance R and slopes J of fitted values by k unknowns, minus twice the restricted
log-likelihood (Patterson and Thompson 1971) is, but for constants,

    min_d (r + J d)' R^-1 (r + J d) + log det R + log det J' R^-1 J;

without the last part it is the likelihood.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr

from commonlaw.array_types import Bools, Floats
from commonlaw.likelihood.errors import AbstractErrors, ErrorModel, Scales
from commonlaw.trials import Trial
from commonlaw.trials.trial import with_typical

MIN_NOISE = 1e-4
"""Smallest noise, in standard deviations of a state, at the size of discretization errors."""
_MAX_STEPS = 30
"""Newton steps of a minimization."""
_SAME_LOGARITHM = 1e-6
"""Change of logarithms of levels at which it ends, and the smallest eigenvalue of a Hessian relative to the largest."""


class Whitened(NamedTuple):
    """Residuals of a trial as independent standard normal variables z, shape (n, m), NaN where nothing was measured.

    `slopes`, shape (n, m, k), are their derivatives by unknowns. Given those before them, residuals have the standard
    deviations `std`, and single measurements the white noise `white`, shape (n, m) each.
    """

    z: Floats
    slopes: Floats | None
    std: Floats
    white: Floats


@dataclass(frozen=True, eq=False)
class Deviations:
    """Measurements of a trial about the values h of a fit, shape (n, m), with derivatives of these, shape (n, m, k).

    Heteroscedastic noise is that at `reference` values of an earlier fit, shape (n, m).
    """

    trial: Trial
    values: Floats
    slopes: Floats | None
    reference: Floats

    def whitened(self, noise: Floats, errors: ErrorModel) -> Whitened:
        """Return the residuals under white noise, shape (m,), and other errors."""
        trial = self.trial
        std = errors.white_std(self.reference, with_typical(trial.noise, noise)) * trial.averaging
        slopes = None if self.slopes is None else self.slopes / std[:, :, np.newaxis]
        return Whitened((self.values - trial.states) / std, slopes, std, std)

    def deviance(self, whitened: Whitened) -> float:
        """Return minus twice the log-likelihood beyond the squares of z, without constants.

        Repeated measurements vary about their means, and values below limits are in the tails.
        """
        trial, (_, _, std, white) = self.trial, whitened
        seen, under = np.isfinite(trial.states), np.isfinite(trial.below)
        result = 2 * float(np.log(std[seen]).sum() - log_ndtr(((trial.below - self.values) / std)[under]).sum())
        if trial.repeats is not None:
            counts, squares = trial.repeats.counts[seen], trial.repeats.squares[seen]
            single = white[seen] * np.sqrt(counts)  # The mean has the noise of one over the root of their number
            result += float((squares / single**2 + 2 * (counts - 1) * np.log(single) + np.log(counts)).sum())
        return result


@dataclass(frozen=True, eq=False)
class LinearizedFit:
    """Measurements about a fit, with the rows of priors of its unknowns: residuals, shape (r,), and slopes, (r, k)."""

    trials: Sequence[Deviations]
    prior: tuple[Floats, Floats]

    @classmethod
    def of(cls, trials: Sequence[Deviations], prior: tuple[Floats, Floats]) -> "LinearizedFit":
        """Return a fit whose unknowns are orthogonal combinations of those that the rows determine."""
        parts = [
            np.where(np.isfinite(trial.trial.states)[:, :, np.newaxis], np.nan_to_num(trial.slopes), 0.0)
            for trial in trials
            if trial.slopes is not None
        ]
        rows = np.concatenate([*(part.reshape(-1, part.shape[2]) for part in parts), prior[1]])
        norms = np.linalg.norm(rows, axis=0)
        basis, sizes, _ = np.linalg.svd(rows / np.where(norms > 0, norms, 1.0), full_matrices=False)
        basis = basis[:, sizes > np.finfo(float).eps * len(rows) * sizes.max(initial=0.0)]
        pieces = np.split(basis, np.cumsum([part.shape[0] * part.shape[1] for part in parts]))
        changed = [
            replace(trial, slopes=piece.reshape(*part.shape[:2], -1))
            for trial, part, piece in zip(trials, parts, pieces[:-1], strict=True)
        ]
        return cls(changed, (prior[0], pieces[-1]))

    def deviance(self, noise: Floats, errors: ErrorModel, restricted: bool = True) -> float:
        """Return minus twice the (restricted) log-likelihood, without constants; the likelihood keeps the unknowns."""
        residuals, rows, total = [self.prior[0]], [self.prior[1]], 0.0
        for trial in self.trials:
            whitened, seen = trial.whitened(noise, errors), np.isfinite(trial.trial.states)
            total += trial.deviance(whitened)
            residuals.append(whitened.z[seen])
            assert whitened.slopes is not None
            rows.append(whitened.slopes[seen])
        target = np.concatenate(residuals)
        if not restricted:
            return total + float(target @ target)
        triangle = np.asarray(np.linalg.qr(np.column_stack([np.concatenate(rows), target]), mode="r"))
        diagonal = np.abs(np.diagonal(triangle))
        k = triangle.shape[1] - 1
        rest = float(diagonal[k] ** 2) if len(diagonal) > k else 0.0
        return total + rest + 2 * float(np.log(diagonal[:k]).sum())


def likeliest_levels(
    model: AbstractErrors,
    fits: Sequence[LinearizedFit],
    noise: Floats,
    known: Bools,
    floor: Floats,
    scales: Scales,
    restricted: bool = True,
) -> tuple[Floats, ErrorModel]:
    """Return the noise, shape (m,), and other errors of largest likelihood of fits without common unknowns.

    Known noise stays; otherwise it is at least a floor, shape (m,).
    """
    m = len(noise)

    def value(logs: Floats) -> float:
        levels = np.exp(logs)
        with np.errstate(all="ignore"):
            errors = model.model(levels[m:])
            total = sum(fit.deviance(levels[:m], errors, restricted) for fit in fits)
        return total if np.isfinite(total) else 1e12

    bounds = level_bounds(model, scales, floor, np.where(known, noise, np.nan))
    levels = np.exp(minimum(value, min(level_starts(model, noise, *bounds), key=value), *bounds))
    return np.where(known, noise, levels[:m]), model.model(levels[m:])


def level_bounds(model: AbstractErrors, scales: Scales, floor: Floats, known: Floats) -> tuple[Floats, Floats]:
    """Return bounds of the logarithms of levels: noise, shape (m,), which may be known, other errors, times."""
    least, largest = model.bounds(scales)
    is_free = np.isnan(known)
    low = np.append(np.where(is_free, floor, known), least)
    high = np.append(np.where(is_free, np.maximum(scales.states, floor), known), largest)
    return np.log(low), np.log(high)


def level_starts(model: AbstractErrors, noise: Floats, low: Floats, high: Floats) -> list[Floats]:
    """Return first values of the same logarithms, at the present noise, shape (m,)."""
    logs, m = np.log(noise), len(noise)
    return [np.clip([*logs, *others], low, high) for others in model.starts(logs, low[m:], high[m:])]


def minimum(value: Callable[[Floats], float], start: Floats, low: Floats, high: Floats) -> Floats:
    """Return a local minimum within bounds by Newton's method (Nocedal and Wright 2006, section 3.4).

    Derivatives are central differences; negative eigenvalues of the Hessian are replaced by their absolute values.
    Arrays have the shape (variables,).
    """
    optimum, least = start, value(start)
    for _ in range(_MAX_STEPS):
        step = _step(value, optimum, least, low, high)
        length = float(np.abs(step).max(initial=0.0))
        if length < _SAME_LOGARITHM:
            return np.clip(optimum + step, low, high)
        step *= min(1.0, 1 / length)
        for share in (1, 1 / 4, 1 / 16, 1 / 64, 1 / 256):
            tried = np.clip(optimum + share * step, low, high)
            if (value_there := value(tried)) < least:
                break
        else:
            return optimum
        optimum, least = tried, value_there
    return optimum


def _step(
    value: Callable[[Floats], float], at: Floats, known: float, low: Floats, high: Floats, spacing: float = 0.02
) -> Floats:
    """Return Newton's step, by central differences, in the variables that no bound is active for.

    Their spacing suits functions known to some ten digits, of variables of order one.
    """
    # At a bound, differences are taken on its inner side
    center = np.clip(at, np.minimum(low + spacing, high), np.maximum(high - spacing, low))
    free = np.flatnonzero(high - low > 2 * spacing)
    middle = known if np.array_equal(center, at) else value(center)
    moves = spacing * np.eye(len(at))[free]
    after, before = (np.array([value(center + sign * move) for move in moves]) for sign in (1, -1))
    gradient, curvature = (after - before) / (2 * spacing), np.diag(after + before - 2 * middle)
    for i, j in combinations(range(len(free)), 2):
        both = value(center + moves[j] + moves[i]) + value(center - moves[j] - moves[i])
        curvature[i, j] = curvature[j, i] = (both - after[j] - after[i] - before[j] - before[i] + 2 * middle) / 2
    curvature /= spacing**2
    outward = np.where(gradient > 0, at[free] <= low[free], (gradient < 0) & (at[free] >= high[free]))
    step, inner = np.zeros(len(at)), free[~outward]
    if len(inner):
        sizes, directions = np.linalg.eigh(curvature[np.ix_(~outward, ~outward)])
        sizes = np.maximum(np.abs(sizes), _SAME_LOGARITHM * np.abs(sizes).max())
        if sizes.max() > 0:
            step[inner] = -directions @ ((directions.T @ gradient[~outward]) / sizes)
    return step
