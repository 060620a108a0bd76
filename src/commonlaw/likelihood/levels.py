"""Levels of errors about a fit, of either scheme: bounds, first values, and those of largest restricted likelihood.

With residuals r = h - y of covariance R and slopes J of fitted values by k unknowns, minus twice the restricted
log-likelihood (Patterson and Thompson 1971) is, but for constants,

    min_d (r + J d)' R^-1 (r + J d) + log det R + log det J' R^-1 J;

without the last part it is the likelihood.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, combinations_with_replacement
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.differentiation.noise import rounding_noise, within_trial_std
from commonlaw.errors import CommonlawError
from commonlaw.likelihood.errors import ERRORS, AbstractErrors, ErrorModel, Scales
from commonlaw.likelihood.mesh import MIN_NOISE
from commonlaw.likelihood.observation_model import transition
from commonlaw.trials import Trial, Trials
from commonlaw.trials.trial import with_typical

MOVED = 1e-4
"""Change of the unknowns, in standard errors, at which rounds of levels of errors and unknowns end."""
_MAX_STEPS = 30
"""Newton steps of a minimization."""
_SAME_LOGARITHM = 1e-6
"""Change of logarithms of levels at which it ends, and the smallest eigenvalue of a Hessian relative to the largest."""
_NO_WEIGHT = 1e-9
"""Weight of an outlier that is rejected, relative to other measurements."""
_MAX_REWEIGHTINGS = 100
"""Rounds of weights of outliers and other errors."""
_TAIL = 0.25
"""Newton step of logarithms of levels above which longer ones are tried: near a minimum steps are short."""


class Whitened(NamedTuple):
    """Residuals of a trial as independent standard normal variables z, shape (n, m), NaN where nothing was measured.

    `slopes`, shape (n, m, k), are their derivatives by unknowns. Given those before them, residuals have the standard
    deviations `std`, and single measurements the white noise `white`, shape (n, m) each.
    """

    z: Floats
    slopes: Floats | None
    std: Floats
    white: Floats


class Innovations(NamedTuple):
    """What errors are off their expectation by those before them, for autocorrelated errors with white noise.

    With white variances w_i, an Ornstein-Uhlenbeck process of variance c^2, and ``f_i = exp(-(t_(i+1) - t_i) / T)``,
    errors r_i have the innovations ``e_i = r_i - m_i`` of variance ``s_i = p_i + w_i``; with the gain ``g_i = p_i /
    s_i``, ``m_(i+1) = f_i (m_i + g_i e_i)`` and ``p_(i+1) = f_i^2 (1 - g_i) p_i + (1 - f_i^2) c^2``, from ``m_0 = 0``
    and ``p_0 = c^2`` (Kalman 1960). For a Wiener process of variance ``c^2 t``, ``f_i = 1``, ``p_0 = c^2 t_0`` and
    ``p_(i+1) = (1 - g_i) p_i + c^2 (t_(i+1) - t_i)``. `carried` is ``f_i (1 - g_i)``, `gained` is ``f_i g_i``, and
    `std` the root of s_i.
    """

    carried: Floats
    gained: Floats
    std: Floats

    @classmethod
    def of(cls, times: Floats, white: Floats, level: float, memory: float) -> "Innovations":
        """Return those of errors at times, of white standard deviations, shape (n,) each, and a level and time.

        Times are those since the first sample of the trial; with infinite memory errors are a Wiener process.
        """
        kept, added = transition(np.diff(times, append=times[-1:]), memory)
        predicted = level**2 * (float(times[0]) if np.isinf(memory) and len(times) else 1.0)
        gains, variances = list[float](), list[float]()
        for w, f, q in zip((white**2).tolist(), kept.tolist(), (level**2 * added).tolist(), strict=True):
            variances.append(predicted + w)
            gains.append(predicted / variances[-1])
            predicted = f * f * (1 - gains[-1]) * predicted + q
        return cls(kept * (1 - np.array(gains)), kept * np.array(gains), np.sqrt(variances))

    def of_errors(self, errors: Floats) -> Floats:
        """Return the innovations of errors, or of columns of them, shape (n, ...)."""
        from scipy.linalg import lapack

        if len(errors) < 2:
            return errors
        bands, right = np.ones((2, len(errors))), np.zeros_like(errors)
        bands[1] = -self.carried
        right[1:] = (errors.T * self.gained).T[:-1]
        expected = lapack.dtbtrs(bands, right.reshape(len(errors), -1), uplo="L", diag="U")[0]
        return np.asarray(errors - np.asarray(expected).reshape(errors.shape))

    def transposed(self, innovations: Floats) -> Floats:
        """Return the transposed map of `of_errors` of values, shape (n,)."""
        from scipy.linalg import lapack

        if len(innovations) < 2:
            return innovations
        bands = np.ones((2, len(innovations)))
        bands[1] = -self.carried
        expected = np.asarray(lapack.dtbtrs(bands, innovations[:, np.newaxis], uplo="L", trans="T", diag="U")[0])[:, 0]
        return np.asarray(innovations - self.gained * np.append(expected[1:], 0.0))


class DriftInnovations(NamedTuple):
    """What errors are off their expectation by those before them, for a drift with white noise.

    With white variances w_i and rows ``u_i = (offset, slope t_i)``, errors r_i have the innovations ``e_i = r_i - u_i'
    m_i`` of variance ``s_i = w_i + u_i' P_i u_i``, where ``P_i = (1 + sum_(j < i) u_j u_j' / w_j)^-1`` and ``m_i = P_i
    sum_(j < i) u_j r_j / w_j`` (recursive least squares). `weighted` are ``u_i / w_i`` and `gained` ``P_i u_i``, shape
    (n, 2), and `std` is the root of s_i.
    """

    weighted: Floats
    gained: Floats
    std: Floats

    @classmethod
    def of(cls, elapsed: Floats, white: Floats, offset: float, slope: float) -> "DriftInnovations":
        """Return those of errors at times since the first sample, of white standard deviations, shape (n,) each."""
        rows = np.column_stack([np.full(len(elapsed), offset), slope * elapsed])
        weighted = rows / white[:, np.newaxis] ** 2
        information = np.eye(2) + _before(rows[:, :, np.newaxis] * weighted[:, np.newaxis])
        gained = np.linalg.solve(information, rows[:, :, np.newaxis])[:, :, 0]
        return cls(weighted, gained, np.sqrt(white**2 + np.sum(rows * gained, axis=1)))

    def of_errors(self, errors: Floats) -> Floats:
        """Return the innovations of errors, or of columns of them, shape (n, ...)."""
        columns = errors.reshape(len(errors), 1, math.prod(errors.shape[1:]))
        expected = np.einsum("nk,nkc->nc", self.gained, _before(self.weighted[:, :, np.newaxis] * columns))
        return np.asarray(errors - expected.reshape(errors.shape))

    def transposed(self, innovations: Floats) -> Floats:
        """Return the transposed map of `of_errors` of values, shape (n,)."""
        after = _before((self.gained * innovations[:, np.newaxis])[::-1])[::-1]
        return np.asarray(innovations - np.sum(self.weighted * after, axis=1))


def _before(values: Floats) -> Floats:
    """Return the sums of the values before each, shape (n, ...)."""
    sums = np.zeros_like(values)
    np.cumsum(values[:-1], axis=0, out=sums[1:])
    return sums


@dataclass(frozen=True, eq=False)
class Deviations:
    """Measurements of a trial about the values h of a fit, shape (n, m), with derivatives of these, shape (n, m, k).

    Heteroscedastic noise is that at `reference` values of an earlier fit, and outliers are left out, shape (n, m) each.
    Variances of white noise are divided by `weights`, shape (n, m), None for equal ones, see `reweighted`.
    """

    trial: Trial
    values: Floats
    slopes: Floats | None
    reference: Floats
    outliers: Bools
    weights: Floats | None = None

    @property
    def jacobian(self) -> Floats:
        """The derivatives of values that have them."""
        assert self.slopes is not None
        return self.slopes

    @property
    def seen(self) -> Bools:
        """Which measurements there are, shape (n, m)."""
        return np.isfinite(self.trial.states) & ~self.outliers

    def whitened(self, noise: Floats, errors: ErrorModel) -> Whitened:
        """Return the residuals under white noise, shape (m,), and other errors."""
        trial = self.trial
        typical = with_typical(trial.noise, errors.noise_of_trial(trial, noise))
        white = errors.white_std(self.reference, typical) * trial.averaging
        std = white if self.weights is None else white / np.sqrt(self.weights)
        z, slopes = self.values + errors.mean(trial.elapsed) - trial.states, self.slopes
        if errors.latent.are_measured:
            slopes, std = None if slopes is None else slopes.copy(), std.copy()
            for k, innovations in enumerate(self._innovations(std, errors)):
                seen = self.seen[:, k]
                z[seen, k], std[seen, k] = innovations.of_errors(z[seen, k]), innovations.std
                if slopes is not None:
                    slopes[seen, k] = innovations.of_errors(slopes[seen, k])
        return Whitened(z / std, None if slopes is None else slopes / std[:, :, np.newaxis], std, white)

    def _innovations(self, white: Floats, errors: ErrorModel) -> Sequence[Innovations | DriftInnovations]:
        """Return the innovations of each quantity under white standard deviations, shape (n, m)."""
        elapsed, latent = self.trial.elapsed, errors.latent
        seen = [(elapsed[column], std[column]) for column, std in zip(self.seen.T, white.T, strict=True)]
        if latent.correlated is not None:
            levels = zip(seen, latent.correlated.tolist(), strict=True)
            return [Innovations.of(*inside, level, latent.memory) for inside, level in levels]
        if latent.offset is None or latent.slope is None:
            return ()
        pairs = zip(seen, latent.offset.tolist(), latent.slope.tolist(), strict=True)
        return [DriftInnovations.of(*inside, *levels) for inside, *levels in pairs]

    def reweighted(self, noise: Floats, errors: ErrorModel, threshold: float, *, rejects: bool = False) -> "Deviations":
        """Return the same with the weights of the Huber loss of white noise, where other errors have theirs.

        With residuals r of covariance R, which has the variances ``s^2 / w``, white noise is ``e = s^2 / w R^-1 r``,
        and the weights are ``w = min(1, c s / |e|)`` for the threshold c (Huber 1964): at their fixed point the loss of
        e and the squares of the other errors, autocorrelated or a drift, have the least sum. If outliers are rejected,
        their weights are next to nothing.
        """
        if not np.isfinite(threshold):
            return replace(self, weights=None)
        result = self if self.weights is not None else replace(self, weights=np.ones(self.values.shape))
        for _ in range(_MAX_REWEIGHTINGS):
            z, _, std, white = result.whitened(noise, errors)
            weights = np.ones_like(z) if result.weights is None else result.weights
            precise = z / std
            for k, innovations in enumerate(result._innovations(white / np.sqrt(weights), errors)):
                seen = self.seen[:, k]
                precise[seen, k] = innovations.transposed(precise[seen, k])
            with np.errstate(divide="ignore", invalid="ignore"):
                after = np.nan_to_num(np.minimum(1.0, threshold * weights / np.abs(white * precise)), nan=1.0)
                after = np.where(after < 1, _NO_WEIGHT, 1.0) if rejects else after
            result = replace(result, weights=after)
            if np.allclose(after, weights, rtol=_SAME_LOGARITHM, atol=0.0):
                break
        return result

    def deviance(self, whitened: Whitened) -> float:
        """Return minus twice the log-likelihood beyond the squares of z, without constants.

        Repeated measurements vary about their means, and values below limits are in the tails. Weights do not change
        the density of white noise.
        """
        from scipy.special import log_ndtr

        trial, (_, _, std, white) = self.trial, whitened
        seen, under = self.seen, np.isfinite(trial.below)
        result = 2 * float(np.log(std[seen]).sum() - log_ndtr(((trial.below - self.values) / std)[under]).sum())
        if self.weights is not None:
            result += float(np.log(self.weights[seen]).sum())
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

    @property
    def orthogonal(self) -> "LinearizedFit":
        """The fit whose unknowns are orthogonal combinations of those that the rows determine."""
        parts = [
            np.where(trial.seen[:, :, np.newaxis], np.nan_to_num(trial.slopes), 0.0)
            for trial in self.trials
            if trial.slopes is not None
        ]
        rows = np.concatenate([*(part.reshape(-1, part.shape[2]) for part in parts), self.prior[1]])
        norms = np.linalg.norm(rows, axis=0)
        basis, sizes, _ = np.linalg.svd(rows / np.where(norms > 0, norms, 1.0), full_matrices=False)
        basis = basis[:, sizes > np.finfo(float).eps * len(rows) * sizes.max(initial=0.0)]
        pieces = np.split(basis, np.cumsum([part.shape[0] * part.shape[1] for part in parts]))
        changed = [
            replace(trial, slopes=piece.reshape(*part.shape[:2], -1))
            for trial, part, piece in zip(self.trials, parts, pieces[:-1], strict=True)
        ]
        return LinearizedFit(changed, (self.prior[0], pieces[-1]))

    def deviance(self, noise: Floats, errors: ErrorModel, restricted: bool = True) -> float:
        """Return minus twice the (restricted) log-likelihood, without constants; the likelihood keeps the unknowns."""
        rows, target, total = self._whitened(noise, errors)
        if not restricted:
            return total + float(target @ target)
        triangle = np.asarray(np.linalg.qr(np.column_stack([rows, target]), mode="r"))
        diagonal = np.abs(np.diagonal(triangle))
        k = triangle.shape[1] - 1
        rest = float(diagonal[k] ** 2) if len(diagonal) > k else 0.0
        return total + rest + 2 * float(np.log(diagonal[:k]).sum())

    def moved(self, noise: Floats, errors: ErrorModel) -> Floats:
        """Return how the unknowns of largest likelihood at levels of errors are off those of the fit, shape (k,)."""
        rows, target, _ = self._whitened(noise, errors)
        norms = np.linalg.norm(rows, axis=0)
        norms = np.where(norms > 0, norms, 1.0)
        return -np.asarray(np.linalg.lstsq(rows / norms, target, rcond=None)[0]) / norms

    def _whitened(self, noise: Floats, errors: ErrorModel) -> tuple[Floats, Floats, float]:
        """Return the slopes of all residuals, whitened, shape (r, k), these, shape (r,), and `Deviations.deviance`."""
        residuals, rows, total = [self.prior[0]], [self.prior[1]], 0.0
        for trial in self.trials:
            whitened = trial.whitened(noise, errors)
            total += trial.deviance(whitened)
            residuals.append(whitened.z[trial.seen])
            assert whitened.slopes is not None
            rows.append(whitened.slopes[trial.seen])
        return np.concatenate(rows), np.concatenate(residuals), total


def autocorrelation(squares: Floats, products: Floats) -> float:
    """Return the autocorrelation r of standardized residuals, zero unless the evidence is for it.

    It has squares of n residuals and products of m neighbouring ones; ``-m log(1 - r^2) > 2 log n`` (BIC).
    """
    if len(products) < 2 or not squares.any():
        return 0.0
    memory = float(np.clip(products.mean() / squares.mean(), -0.99, 0.99))
    is_evident = memory > 0 and -len(products) * np.log1p(-(memory**2)) > 2 * np.log(max(len(squares), 2))
    return memory if is_evident else 0.0


def likeliest_levels(
    model: AbstractErrors,
    fits: Sequence[LinearizedFit],
    noise: Floats,
    known: Bools,
    floor: Floats,
    scales: Scales,
    first: Floats | None = None,
    restricted: bool = True,
) -> Floats:
    """Return the noise, of m quantities, other levels, and times of largest likelihood of fits without common unknowns.

    Known noise stays; otherwise it is at least a floor, shape (m,). The first values are those of `level_starts` by
    default.
    """
    m = len(noise)

    def value(logs: Floats) -> float:
        levels = np.exp(logs)
        with np.errstate(all="ignore"):
            errors = model.model(levels[m:])
            total = sum(fit.deviance(levels[:m], errors, restricted) for fit in fits)
        return total if np.isfinite(total) else 1e12

    bounds = level_bounds(model, scales, floor, np.where(known, noise, np.nan))
    starts = level_starts(model, noise, *bounds) if first is None else [np.clip(np.log(first), *bounds)]
    return np.asarray(
        np.exp(
            least(value, model, starts, *bounds, m, sum(int(trial.seen.sum()) for fit in fits for trial in fit.trials))
        )
    )


def covariance_by_levels(
    model: AbstractErrors,
    fits: Sequence[LinearizedFit],
    levels: Floats,
    known: Bools,
    floor: Floats,
    scales: Scales,
) -> list[Floats]:
    """Return what errors of levels of largest restricted likelihood add to covariances of unknowns, (k, k) of each fit.

    With the slopes D of estimates by the logarithms of levels, whose covariance is W, it is ``D' W D`` (Kackar and
    Harville 1984); W is twice the inverse Hessian of minus twice the restricted log-likelihood. Levels at their bounds,
    and known ones, are fixed.
    """
    m, logs, spacing = len(known), np.log(levels), 0.05
    low, high = level_bounds(model, scales, floor, np.where(known, levels[:m], np.nan))
    moves = spacing * np.eye(len(logs))[(logs > low + spacing) & (logs < high - spacing)]

    def at(place: Floats) -> tuple[Floats, ErrorModel]:
        return np.exp(place[:m]), model.model(np.exp(place[m:]))

    hessian, determined = np.zeros((len(moves),) * 2), [fit.orthogonal for fit in fits]
    for i, j in combinations_with_replacement(range(len(moves)), 2):
        both, apart = moves[i] + moves[j], moves[i] - moves[j]
        for sign, place in ((1, both), (1, -both), (-1, apart), (-1, -apart)):
            hessian[i, j] += sign * sum(fit.deviance(*at(logs + place)) for fit in determined) / (2 * spacing) ** 2
        hessian[j, i] = hessian[i, j]
    sizes, directions = np.linalg.eigh(hessian)
    if not len(sizes) or sizes[-1] <= 0:
        return [np.zeros((fit.prior[1].shape[1],) * 2) for fit in fits]
    root = directions * np.sqrt(2 / np.maximum(sizes, _SAME_LOGARITHM * sizes[-1]))
    result = list[Floats]()
    for fit in fits:
        changes = [fit.moved(*at(logs + move)) - fit.moved(*at(logs - move)) for move in moves]
        slopes = root.T @ np.array(changes) / (2 * spacing)
        result.append(slopes.T @ slopes)
    return result


def over_decades(trials: Trials) -> tuple[str, ...]:
    """Return the measured states above zero of which values are below the smallest noise of a fit, `MIN_NOISE`.

    They would count for nothing in it. First measurements of trials, to which free initial values fit, do not decide;
    states of known noise are left out.
    """
    schema, listed = trials.schema, list[str]()
    floor = np.maximum(MIN_NOISE * within_trial_std(trials), rounding_noise(trials))
    for j, name in enumerate(schema.states):
        columns = [np.fmin(trial.states[:, j], trial.below[:, j]) for trial in trials]
        seen = [column[np.isfinite(column)] for column in columns]
        is_taken = name in schema.logarithmic or name in schema.noise_columns or name in schema.initial_values
        if is_taken or not all((values > 0).all() for values in seen):
            continue
        if any((values[1:] < floor[j]).any() for values in seen):
            listed.append(name)
    return tuple(listed)


def states_of_open_scale(
    trials: Trials, *, errors: str, noise: object, log_states: Sequence[str] | None, is_first_order: bool
) -> tuple[str, ...]:
    """Return the states of many decades whose scale is a choice: that of laws of first order, where nothing is given.

    Neither the kind of errors, the noise, nor the states on a logarithmic scale, which are None if they are not given.

    Raises `CommonlawError` for proportional errors of such states: unless it is given, noise is at least `MIN_NOISE`.
    """
    if noise is not None or log_states or errors not in ("auto", "proportional"):
        return ()
    states = over_decades(trials)
    if states and errors == "proportional":
        raise CommonlawError("proportional-over-decades", states=[*states])
    return states if is_first_order and log_states is None else ()


def scales_of(std: Floats, trials: Sequence[Trial]) -> Scales:
    """Return the scales of errors of measurements, by the standard deviations of the measured, shape (m,)."""
    steps = np.concatenate([np.diff(trial.times) for trial in trials])
    step = float(np.median(steps)) if len(steps) else 1.0
    duration = max(step, *(float(np.ptp(trial.times)) for trial in trials))
    return Scales(std, np.zeros(len(std)), step, duration, MIN_NOISE, 0.0, len(trials))


def free_levels(errors: ErrorModel, scales: Scales) -> Bools:
    """Return which levels of errors are above their lower bounds, which stand for no such errors, and times of those.

    Shape (levels and times,).
    """
    values, model = errors.levels, ERRORS[errors.kind]
    levels = len(values) - model.correlation_times
    result = np.zeros(len(values), dtype=np.bool_)
    if levels > 0:
        result[:levels] = values[:levels] > 1.001 * model.bounds(scales)[0][:levels]
        result[levels:] = result.any()
    return result


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


def least(
    value: Callable[[Floats], float],
    model: AbstractErrors,
    starts: Sequence[Floats],
    low: Floats,
    high: Floats,
    m: int,
    count: int,
) -> Floats:
    """Return the logarithms of m levels of noise and of others of least value within bounds, from the best start.

    Levels that are means stay at their bounds unless they gain log n, for so many measurements as are counted.
    """

    def reached(start: Floats) -> Floats:
        return minimum(value, start, low, np.append(high[:m], model.highest(start[m:], low[m:], high[m:])))

    optimum = reached(min(starts, key=value))
    for k in model.means(len(low) - m):
        if optimum[m + k] > low[m + k]:
            without = optimum.copy()
            without[m + k] = low[m + k]
            without = reached(without)
            optimum = without if value(without) < value(optimum) + np.log(max(count, 2)) else optimum
    return optimum


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
        reached, least = tried, value_there
        # Where levels hardly matter the function is nearly linear in variances, and steps of logarithms are one half
        while length > _TAIL:
            share *= 4
            tried = np.clip(optimum + share * step, low, high)
            if np.array_equal(tried, reached) or (value_there := value(tried)) >= least:
                break
            reached, least = tried, value_there
        optimum = reached
    return optimum


def _step(
    value: Callable[[Floats], float], at: Floats, known: float, low: Floats, high: Floats, spacing: float = 0.02
) -> Floats:
    """Return Newton's step, by central differences, in the variables that no bound is active for.

    Their spacing suits functions known to some ten digits, of variables of order one.
    """
    changes = spacing * np.eye(len(at))
    free, inward = high - low > 2 * spacing, np.where(at <= low, 1.0, -1.0)
    for k in np.flatnonzero(free & ((at <= low) | (at >= high))).tolist():
        free[k] = value(at + inward[k] * changes[k]) < known
    inner, moves = np.flatnonzero(free), changes[free]
    # Near a bound, differences are taken on its inner side
    center = np.where(free, np.clip(at, np.minimum(low + spacing, high), np.maximum(high - spacing, low)), at)
    middle = known if np.array_equal(center, at) else value(center)
    after, before = (np.array([value(center + sign * move) for move in moves]) for sign in (1, -1))
    gradient, curvature = (after - before) / (2 * spacing), np.diag(after + before - 2 * middle)
    for i, j in combinations(range(len(inner)), 2):
        both = value(center + moves[j] + moves[i]) + value(center - moves[j] - moves[i])
        curvature[i, j] = curvature[j, i] = (both - after[j] - after[i] - before[j] - before[i] + 2 * middle) / 2
    step = np.zeros(len(at))
    if len(inner):
        sizes, directions = np.linalg.eigh(curvature / spacing**2)
        sizes = np.maximum(np.abs(sizes), _SAME_LOGARITHM * np.abs(sizes).max())
        if sizes.max() > 0:
            step[inner] = -directions @ ((directions.T @ gradient) / sizes)
    return step
