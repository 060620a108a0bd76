"""How noisy measured states are."""

from collections.abc import Iterable, Iterator
from math import comb, sqrt
from statistics import NormalDist

import numpy as np
from numpy.typing import ArrayLike

from commonlaw.array_types import Bools, Floats, Indices
from commonlaw.differentiation.base import need_samples
from commonlaw.errors import CommonlawError
from commonlaw.trials import Trial

MIN_SAMPLES = 8
"""Samples of a trial whose differences estimate the noise."""
_MAX_ORDER = 10
"""The highest order of differences."""
OUTLIER_THRESHOLD = 4.0
"""Standard deviations beyond which a value, or a difference that it is in, is an outlier."""
_WINDOW = 11
"""Values of a series among which one is an outlier."""

MEDIAN_SIZE = NormalDist().inv_cdf(0.75)
"""The median size of a standard normal variable."""
_MEDIAN_ERROR = 1 / (4 * MEDIAN_SIZE * NormalDist().pdf(MEDIAN_SIZE))
"""The standard error of the median size of n such variables, relative to it and times the root of n."""


def noise_level(times: ArrayLike, states: ArrayLike) -> Floats:
    """Return the standard deviation of the measurement noise on each state.

    Differences of order k, each over k + 1 neighbouring samples on any grid, take polynomials of degree below k away;
    with weights of unit length they keep the standard deviation of white noise, which is then their root mean square.
    Outliers show as peaks beyond four standard deviations, found from the median size on and with a margin for its own
    error; all differences that a peak's sample is in are left out.

    What a state itself leaves in its differences makes the estimates of low orders too large; that falls with the order
    if the state is smooth, while the sampling error grows. Chosen is the smallest of the orders 1 to 10 (to n // 4 in
    short trials) whose estimate is not larger than that of any higher order by more than three standard errors of their
    difference (the principle of Lepski 1990; differences of the same samples are correlated, so these errors are much
    smaller than those of the estimates). The estimate of 150 samples has a standard error of about a tenth.

    Assumes noise that is white, of one level over the trial, and measured at 20 samples or more for each period of the
    fastest oscillation. Noise that is correlated from sample to sample passes for a part of the state.

    Raises `CommonlawError` if there are fewer than 8 samples, the shapes disagree, a value is not finite, or the times
    do not increase.

    Parameters
    ----------
    times
        Strictly increasing sample times, shape (n,).
    states
        Measured states, shape (n, d).

    Returns
    -------
    ndarray
        Standard deviations in the units of the states, shape (d,).

    Examples
    --------
    >>> t = np.linspace(0, 10, 500)
    >>> noise = 0.1 * np.random.default_rng(0).standard_normal(500)
    >>> noise_level(t, np.column_stack([np.sin(t) + noise, np.sin(t)])).round(3).tolist()
    [0.103, 0.0]
    """
    t, x = np.asarray(times, dtype=np.float64), np.asarray(states, dtype=np.float64)
    if t.ndim != 1 or x.ndim != 2 or len(x) != len(t):
        raise CommonlawError("shapes-of-times-and-states", times=t.shape, states=x.shape)
    need_samples(len(t), MIN_SAMPLES, "estimates of the noise")
    wrong = np.flatnonzero(~(np.isfinite(t) & np.isfinite(x).all(axis=1)))
    if len(wrong):
        raise CommonlawError("value-not-finite", sample=wrong[0] + 1)
    late = np.flatnonzero(np.diff(t) <= 0)
    if len(late):
        raise CommonlawError("times-not-increasing", sample=late[0] + 2)
    highest = min(_MAX_ORDER, len(t) // 4)
    by_order = enumerate(differences(t, x, highest), start=1)
    estimates = np.array([[_scale(column, order) for column in of_order.T] for order, of_order in by_order])
    orders = _smallest_that_agrees(estimates, len(t) - highest)
    return estimates[orders - 1, range(len(orders))]


def noise_order(times: Floats, values: Floats) -> int | None:
    """Return the order of differences of one state, shape (n,), that show its noise, of any level and with outliers.

    That is the smallest one that agrees with all higher ones, see `noise_level`, with and without outliers, as far as
    squares tell that vary so; None if no two orders agree.
    """
    highest = min(_MAX_ORDER, len(times) // 4)
    listed = [difference[:, 0] for difference in differences(times, values[:, np.newaxis], highest)]
    squares = listed[-1] ** 2
    count = 3 * float(np.sum(squares) ** 2 / max(np.sum(squares**2), np.finfo(float).tiny))
    usual = [_scale(difference, order) for order, difference in enumerate(listed, start=1)]
    whole = [float(np.sqrt(np.mean(difference**2))) for difference in listed]
    orders = _smallest_that_agrees(np.column_stack([whole, usual]), max(count, 1.0))
    return int(orders.max()) if orders[0] < highest else None


def noise_correlation(order: int) -> float:
    """Return how many differences of an order, for white noise, are worth an independent one, where squares count."""
    return _covariance(order, order)


def noise_degrees_of_freedom(samples: int) -> float:
    """Return those of the estimate that `noise_level` makes of so many samples; none if they are too few.

    Of differences of second order, which most smooth states take: they are correlated, so that the estimate is worth
    half as many independent ones.
    """
    return 0.0 if samples < MIN_SAMPLES else (samples - 2) / noise_correlation(2)


def differences(times: Floats, states: Floats, highest: int) -> Iterator[Floats]:
    """Yield the differences of order 1 to `highest`, with weights of unit length; those of order k are (n - k, d)."""
    # In units of the usual step, powers of the steps neither overflow nor vanish
    t = times / np.median(np.diff(times))
    divided, weights = states - states[0], np.zeros((highest + 1, len(t)))
    weights[0] = 1
    for k in range(1, highest + 1):
        span = t[k:] - t[:-k]
        divided = np.diff(divided, axis=0) / span[:, np.newaxis]
        # Signs of neighbouring weights alternate: nothing cancels
        for j in range(k, 0, -1):
            weights[j, :-1] = (weights[j - 1, 1:] - weights[j, :-1]) / span
        weights[0, :-1] /= -span
        weights = weights[:, :-1]
        yield divided / np.sqrt(np.einsum("ji,ji->i", weights, weights))[:, np.newaxis]


def _scale(differences: Floats, order: int) -> float:
    """Return the root mean square of one state's differences, shape (m,), without those that outliers are in."""
    return sqrt(np.mean(differences[without_outliers(differences, order)] ** 2))


def without_outliers(differences: Floats, order: int) -> Bools:
    """Return in which of one state's differences, shape (m,), there are no outliers, see `noise_level`."""
    return _outliers(differences, order)[0]


def outliers_among(times: Floats, values: Floats, least: float) -> Bools:
    """Return which values of one state, shape (n,), are outliers by differences, see `noise_level`.

    These are those far from a polynomial through their neighbours, by four standard deviations of at `least` a given
    size. There are none among fewer than 8 samples, and where the state changes too fast between samples.
    """
    result = np.zeros(len(values), dtype=np.bool_)
    if len(values) < MIN_SAMPLES or not np.ptp(values) or not (order := noise_order(times, values)):
        return result
    order += order % 2  # With a value in the middle
    *_, columns = differences(times, values[:, np.newaxis], order)
    peaks = _outliers(columns[:, 0], order)[1] & (np.abs(columns[:, 0]) > OUTLIER_THRESHOLD * least)
    result[order // 2 : order // 2 + len(peaks)] = peaks
    return result


def outliers_of_window(values: Floats, least: float) -> Bools:
    """Return which values of a series, shape (n,), lie far from the median of the eleven around them (Hampel 1974).

    By four standard deviations, which are those that the median distance in this window shows, and of at `least` a
    given size. There are none among fewer than 8 values, nor where values are infinite.
    """
    if len(values) < MIN_SAMPLES:
        return np.zeros(len(values), dtype=np.bool_)
    size = min(_WINDOW, len(values))
    begins = np.clip(np.arange(len(values)) - size // 2, 0, len(values) - size)
    windows = values[begins[:, np.newaxis] + np.arange(size)]
    with np.errstate(invalid="ignore"):
        middles = np.median(windows, axis=1)
        scales = np.median(np.abs(windows - middles[:, np.newaxis]), axis=1) / MEDIAN_SIZE
        far = np.abs(values - middles) > OUTLIER_THRESHOLD * np.maximum(scales, least)
    return np.asarray(far & np.isfinite(values))


def _outliers(differences: Floats, order: int) -> tuple[Bools, Bools]:
    """Return the differences without outliers, and those with one in the middle, shape (m,) each."""
    from scipy.ndimage import maximum_filter1d

    sizes, near = np.abs(differences), 2 * ((order + 1) // 2) + 1
    margin = 2 * _MEDIAN_ERROR * sqrt(_covariance(order, order) / len(sizes))
    kept, middles = np.ones(len(sizes), dtype=np.bool_), np.zeros(len(sizes), dtype=np.bool_)
    for _ in range(20):
        # Coarse rounding of a slow state makes most differences zero, and the median with them
        scale = np.median(sizes[kept]) / MEDIAN_SIZE or sqrt(np.mean(sizes[kept] ** 2))
        far = kept & (sizes > OUTLIER_THRESHOLD * (1 + margin) * scale)
        if not far.any():
            break
        # The middle weight is the largest, so that an outlier is at the middle of the largest difference around it
        peaks = far & (sizes == maximum_filter1d(sizes * kept, near))
        clean = kept & ~maximum_filter1d(peaks, near)
        if not clean.any():
            break
        kept, middles = clean, middles | peaks
    return kept, middles


def _smallest_that_agrees(estimates: Floats, count: float) -> Indices:
    """Return for each state the smallest order whose estimate agrees with those of all higher ones, shape (d,)."""
    chosen: Indices = np.full(estimates.shape[1], len(estimates))
    for k in range(len(estimates) - 1, 0, -1):
        # Standard errors of the logarithms of the ratios of estimates, for a regular grid and normal noise
        covariances = _COVARIANCES[: len(estimates), : len(estimates)]
        variances = covariances[k - 1, k - 1] + np.diagonal(covariances)[k:] - 2 * covariances[k - 1, k:]
        agrees = estimates[k - 1] <= (1 + 3 * np.sqrt(variances / (2 * count)))[:, np.newaxis] * estimates[k:]
        chosen = np.where(agrees.all(axis=0), k, chosen)
    return chosen


def _covariance(j: int, k: int) -> float:
    """Return half the covariance of the mean squares of two orders' differences, times their number.

    By Isserlis' theorem it is the sum over all lags of the squared correlation of the differences, which has a closed
    form (Vandermonde's identity).
    """
    return comb(2 * (j + k), j + k) / (comb(2 * j, j) * comb(2 * k, k))


_COVARIANCES = np.array([[_covariance(j, k) for k in range(1, _MAX_ORDER + 1)] for j in range(1, _MAX_ORDER + 1)])
"""The covariances of all orders, shape (orders, orders)."""


def within_trial_std(trials: Iterable[Trial]) -> Floats:
    """Return the pooled within-trial standard deviation of each state, shape (states,), zero if it was not measured."""
    variances = list[list[float]]()
    for column in zip(*(trial.states.T for trial in trials), strict=True):
        seen = [values[np.isfinite(values)] for values in column]
        variances.append([float(np.var(values)) for values in seen if len(values)])
    return np.sqrt([float(np.mean(known)) if known else 0.0 for known in variances])


def rounding_noise(trials: Iterable[Trial]) -> Floats:
    """Return the standard deviation of rounding errors of each state, shape (d,), zero if there is no quantum.

    Values that are multiples of a quantum q have uniform rounding errors of standard deviation ``q / sqrt(12)``.
    """
    columns = np.concatenate([trial.states for trial in trials]).T
    quanta = np.zeros(len(columns))
    for j, column in enumerate(columns):
        distinct = np.unique(column[np.isfinite(column)])
        if len(distinct) < 3:
            continue
        quantum = float(np.diff(distinct).min())
        multiples = (distinct - distinct[0]) / quantum
        if np.all(np.abs(multiples - np.round(multiples)) < 1e-3):  # Steps, by the rounding of single precision
            quanta[j] = quantum
        else:  # Few values are seldom neighbours on their scale: take the last decimal of any
            decimals = (n for n in range(np.finfo(float).precision) if np.array_equal(distinct.round(n), distinct))
            quanta[j] = next((10.0**-n for n in decimals), 0.0)
    return np.asarray(quanta / np.sqrt(12))
