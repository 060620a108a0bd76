"""Tests of residuals: which patterns are significant, and what these usually mean."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.discrepancy.patterns import FALSE_DISCOVERY_RATE, Pattern, correlations

_POWERS = 3
"""Residuals are held against polynomials of this degree."""

_MOST_SPENT = 0.9
"""Share of the residuals that fits take, at most."""

_LEAST = 20
"""Fewer residuals are not tested."""

_MOST = 5000
"""Residuals for which Shapiro and Wilk's test has p-values."""


class Tested(NamedTuple):
    """A pattern with its statistic and p-value, and what it means if it is significant."""

    pattern: str
    statistic: float
    p_value: float
    meaning: str


def patterns(
    names: Sequence[str], residuals: Sequence[Floats], against: Mapping[str, Floats], time: str, spent: Sequence[int]
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
    from scipy.stats import false_discovery_control

    found = [
        (name, each)
        for j, name in enumerate(names)
        if np.isfinite(np.concatenate([own[:, j] for own in residuals])).sum() >= _LEAST
        for each in _of_state(names, j, residuals, against, time, spent[j])
    ]
    if not found:
        return ()
    adjusted = false_discovery_control([each.p_value for _, each in found], method="by")
    return tuple(
        Pattern(name, *each[:3], share, each.meaning if share < FALSE_DISCOVERY_RATE else "")
        for (name, each), share in zip(found, adjusted.tolist(), strict=True)
    )


def _of_state(
    names: Sequence[str], j: int, residuals: Sequence[Floats], against: Mapping[str, Floats], time: str, spent: int
) -> Iterator[Tested]:
    whole = np.concatenate(residuals)
    seen = np.isfinite(whole[:, j])
    own = whole[seen, j]
    yield _level(own, spent)
    for name, values in against.items():
        yield _trend(own, values[seen], name, time)
    for other in range(j):
        yield _together(own, whole[seen, other], names[other])
    yield _memory([each[:, j] for each in residuals], spent / len(own))
    yield _growth(own, against[names[j]][seen], names[j])
    yield _normal(own)


def _level(own: Floats, spent: int) -> Tested:
    """Compare the residuals with the noise, which was estimated from as many measurements (F test)."""
    from scipy.stats import f

    free = max(len(own) - spent, 1)
    ratio = float(np.sum(own**2)) / free
    p_value = 2 * min(f.sf(ratio, free, len(own)), f.cdf(ratio, free, len(own)))
    larger = "the law lacks something, or the noise is larger than it says"
    smaller = "the noise is smaller than the law says"
    return Tested("size over noise", float(np.sqrt(ratio)), float(min(p_value, 1.0)), larger if ratio > 1 else smaller)


def _trend(own: Floats, values: Floats, name: str, time: str) -> Tested:
    """Compare with a polynomial (F test); the statistic is the share of the variance that it explains."""
    from scipy.stats import f

    span = np.ptp(values)
    scaled = 2 * (values - values.min()) / span - 1 if span > 0 else np.zeros_like(values)
    design = np.polynomial.legendre.legvander(scaled, min(_POWERS, len(np.unique(scaled)) - 1))
    fitted = design @ np.linalg.lstsq(design, own, rcond=None)[0]
    powers, left = design.shape[1] - 1, float(np.sum((own - fitted) ** 2))
    total = float(np.sum((own - own.mean()) ** 2))
    free = len(own) - powers - 1
    share = 1 - left / total if total > 0 else 0.0
    p_value = float(f.sf((total - left) / powers / (left / free), powers, free)) if powers and left > 0 else 1.0
    if name == time:
        meaning = "something changes with time that the law does not know, or its first moments differ"
    else:
        meaning = f"the law lacks a term in {name}, or in what changes along with it; discrepancy shows it"
    return Tested(f"trend with {name}", share, p_value, meaning)


def _together(own: Floats, other: Floats, name: str) -> Tested:
    from scipy.stats import pearsonr

    both = np.isfinite(other)
    if both.sum() < _LEAST or not (np.ptp(own[both]) and np.ptp(other[both])):
        return Tested(f"correlation with residuals of {name}", 0.0, 1.0, "")
    found = pearsonr(own[both], other[both])
    meaning = "both are disturbed, or measured, by the same thing"
    return Tested(f"correlation with residuals of {name}", float(found.statistic), float(found.pvalue), meaning)


def _memory(series: Sequence[Floats], spent: float) -> Tested:
    """Test the correlation of neighbours (Ljung and Box 1978).

    What was fitted takes the slowest courses out of white noise, about that share of all frequencies, and so leaves
    neighbours a correlation below zero.
    """
    from scipy.stats import chi2

    (found,), (pairs,) = correlations(series, 1)
    share = min(spent, _MOST_SPENT)
    found += share / (1 - share) * np.sinc(share)
    size = float(pairs + len(series))
    total = size * (size + 2) * found**2 / pairs if pairs > 1 else 0.0
    alike = (
        "neighbours err alike: a force that the law lacks, or errors of measurement with a memory (errors='correlated')"
    )
    unlike = "neighbours err to opposite sides: samples were rounded or differenced, or steps are too coarse"
    return Tested("correlation of neighbours", float(found), float(chi2.sf(total, 1)), alike if found > 0 else unlike)


def _growth(own: Floats, states: Floats, name: str) -> Tested:
    """Rank the sizes of residuals by those of the states (Spearman)."""
    from scipy.stats import spearmanr

    sizes = np.abs(states)
    if not (np.ptp(sizes) and np.ptp(np.abs(own))):
        return Tested("scatter with size", 0.0, 1.0, "")
    found = spearmanr(np.abs(own), sizes)
    meaning = f"noise changes with {name}: errors='proportional', or a logarithmic scale if it is above zero"
    return Tested("scatter with size", float(found.statistic), float(found.pvalue), meaning)


def _normal(own: Floats) -> Tested:
    """Test by Shapiro and Wilk, or for many by skewness and kurtosis; the statistic is the excess kurtosis."""
    from scipy.stats import kurtosis, normaltest, shapiro, skew

    tails, lean = float(kurtosis(own)), float(skew(own))
    p_value = 1.0 if not np.ptp(own) else float((shapiro if len(own) <= _MOST else normaltest)(own).pvalue)
    if tails > 2 * abs(lean):
        meaning = "tails are heavy: there are outliers, or noise differs between trials"
    elif abs(lean) > 0.5:
        meaning = "errors lean to one side: values are cut off, or a logarithmic scale fits better"
    else:
        meaning = "errors are not normal: values were rounded, or come from a mixture"
    return Tested("normality (excess kurtosis)", tails, p_value, meaning)
