"""Tests of residuals: which patterns are significant, and what these usually mean."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.discrepancy.patterns import FALSE_DISCOVERY_RATE, Pattern
from commonlaw.discrepancy.residual_sums import StateSums, Trend, ranks

_MOST_SPENT = 0.9
"""Share of the residuals that fits take, at most."""

_LEAST = 20
"""Fewer residuals are not tested."""


class Tested(NamedTuple):
    """A pattern with its statistic and p-value, and what it means if it is significant."""

    pattern: str
    statistic: float
    p_value: float
    meaning: str


def patterns(
    names: Sequence[str], residuals: Sequence[Floats], against: Mapping[str, Floats], time: str, spent: Sequence[float]
) -> tuple[Pattern, ...]:
    """Return what tests say of residuals over noise.

    Parameters
    ----------
    names
        Of the states.
    residuals
        Of each trial, shape (n, states), NaN where nothing was measured.
    against
        What they are held against, by name, at all samples of all trials.
    time
        The name of time among these.
    spent
        How many numbers of each state's residuals initial states and coefficients have taken, if the law was learned
        from these trials.
    """
    sums = [StateSums.of(j, residuals, against, name) for j, name in enumerate(names)]
    return patterns_of(names, sums, time, spent)


def patterns_of(
    names: Sequence[str], sums: Sequence[StateSums | None], time: str, spent: Sequence[float]
) -> tuple[Pattern, ...]:
    """Return what tests say of residuals over noise, of which sums are known for each state that has some."""
    from scipy.stats import false_discovery_control

    found = [
        (name, each)
        for name, own, taken in zip(names, sums, spent, strict=True)
        if own is not None and own.count >= _LEAST
        for each in _of_state(names, name, own, time, taken)
    ]
    if not found:
        return ()
    adjusted = false_discovery_control([each.p_value for _, each in found], method="by")
    return tuple(
        Pattern(name, *each[:3], share, each.meaning if share < FALSE_DISCOVERY_RATE else "")
        for (name, each), share in zip(found, adjusted.tolist(), strict=True)
    )


def size_over_noise(count: int, squares: float, spent: float) -> tuple[float, float]:
    """Return the ratio of residuals to the noise, which was estimated from as many, and its p-value (F test)."""
    from scipy.stats import f

    free = max(count - spent, 1)
    ratio = squares / free
    p_value = 2 * min(f.sf(ratio, free, count), f.cdf(ratio, free, count))
    return float(np.sqrt(ratio)), float(min(p_value, 1.0))


def _of_state(names: Sequence[str], name: str, sums: StateSums, time: str, spent: float) -> Iterator[Tested]:
    yield _level(sums, spent)
    for variable, trend in sums.trends.items():
        yield _trend(trend, sums.count, variable, time)
    for other, (count, factor) in zip(names, sums.together, strict=False):
        yield _together(count, factor, other)
    yield _memory(sums, spent / sums.count)
    yield _growth(sums, name, spent / sums.count)
    yield _normal(sums)


def _level(sums: StateSums, spent: float) -> Tested:
    ratio, p_value = size_over_noise(sums.count, float(sums.powers[1]), spent)
    larger = "the law lacks something, or the noise is larger than it says"
    smaller = "the noise is smaller than the law says"
    return Tested("size over noise", ratio, p_value, larger if ratio > 1 else smaller)


def _trend(trend: Trend, count: int, name: str, time: str) -> Tested:
    """Compare with a polynomial (F test); the statistic is the share of the variance that it explains."""
    from scipy.stats import f

    powers, left, total = trend.explained()
    free = count - powers - 1
    share = 1 - left / total if total > 0 else 0.0
    p_value = float(f.sf((total - left) / powers / (left / free), powers, free)) if powers and left > 0 else 1.0
    if name == time:
        meaning = "something changes with time that the law does not know, or its first moments differ"
    else:
        meaning = f"the law lacks a term in {name}, or in what changes along with it; discrepancy shows it"
    return Tested(f"trend with {name}", share, p_value, meaning)


def _together(count: int, factor: Floats, name: str) -> Tested:
    """Correlate with the residuals of another state (Pearson)."""
    from scipy.stats import beta

    across, rest = factor[1:, 2].tolist()
    total = np.hypot(across, rest)
    if count < _LEAST or not (factor[1, 1] and total):
        return Tested(f"correlation with residuals of {name}", 0.0, 1.0, "")
    found = float(np.sign(factor[1, 1]) * across / total)
    p_value = 2 * float(beta.sf(abs(found), count / 2 - 1, count / 2 - 1, loc=-1, scale=2))
    meaning = "both are disturbed, or measured, by the same thing"
    return Tested(f"correlation with residuals of {name}", found, p_value, meaning)


def _memory(sums: StateSums, spent: float) -> Tested:
    """Test the correlation of neighbours (Ljung and Box 1978).

    What was fitted takes the slowest courses out of white noise, about that share of all frequencies, and so leaves
    neighbours a correlation below zero.
    """
    from scipy.stats import chi2

    pairs, *_, trials = sums.pairs.tolist()
    share = min(spent, _MOST_SPENT)
    found = sums.correlation_of_neighbours + share / (1 - share) * np.sinc(share)
    size = pairs + trials
    total = size * (size + 2) * found**2 / pairs if pairs > 1 else 0.0
    alike = "neighbours err alike: a force that the law lacks, or errors with a memory (`errors='correlated'`)"
    unlike = "neighbours err to opposite sides: samples were rounded or differenced, or steps are too coarse"
    return Tested("correlation of neighbours", float(found), float(chi2.sf(total, 1)), alike if found > 0 else unlike)


def _growth(sums: StateSums, name: str, spent: float) -> Tested:
    """Rank the sizes of residuals by those of the states (Spearman); very many by cells of sizes.

    What was fitted takes that share of the squares of white noise, and half of it of their sizes, more of it at some
    states than at others: as much growth is none.
    """
    from scipy.stats import t

    if sums.kept is None:
        cells, counts = sums.cells, sums.counts
    else:
        cells, counts = np.abs(sums.kept), np.ones(sums.count)
    first, second = (ranks(each, counts) - (sums.count + 1) / 2 for each in cells.T)
    scale = np.sqrt((counts @ first**2) * (counts @ second**2))
    if not scale:
        return Tested("scatter with size", 0.0, 1.0, "")
    found = float(np.clip(counts @ (first * second) / scale, -1.0, 1.0))
    free = sums.count - 2
    odds = free / ((1 + found) * (1 - found)) if abs(found) < 1 else np.inf
    meaning = f"noise changes with {name}: `errors='proportional'`, or a logarithmic scale if it is above zero"
    beyond = max(abs(found) - spent / 2, 0.0)
    return Tested("scatter with size", found, float(2 * t.sf(beyond * np.sqrt(odds), free)), meaning)


def _normal(sums: StateSums) -> Tested:
    """Test by Shapiro and Wilk, or very many by skewness and kurtosis; the statistic is the excess kurtosis."""
    from scipy.stats import chi2, shapiro

    mean, *powers = sums.powers / sums.count
    second, third, fourth = powers
    variance = max(second - mean**2, 0.0)
    lean = (third - 3 * mean * second + 2 * mean**3) / variance**1.5 if variance else 0.0
    tails = (fourth - 4 * mean * third + 6 * mean**2 * second - 3 * mean**4) / variance**2 - 3 if variance else 0.0
    if not variance or (sums.kept is not None and not np.ptp(sums.kept[:, 0])):
        p_value = 1.0
    elif sums.kept is None:
        p_value = float(chi2.sf(sums.count * (lean**2 / 6 + tails**2 / 24), 2))
    else:
        p_value = float(shapiro(sums.kept[:, 0]).pvalue)
    if tails > 2 * abs(lean):
        meaning = "tails are heavy: there are outliers, or noise differs between trials"
    elif abs(lean) > 0.5:
        meaning = "errors lean to one side: values are cut off, or a logarithmic scale fits better"
    else:
        meaning = "errors are not normal: values were rounded, or come from a mixture"
    return Tested("normality (excess kurtosis)", tails, p_value, meaning)
