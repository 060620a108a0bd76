"""Tests of residuals for patterns, from sums over parts of them."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.runtime.forking import cached_property
from commonlaw.runtime.notebooks import ShownInNotebooks
from commonlaw.trials import Trials

if TYPE_CHECKING:
    import pandas as pd

FALSE_DISCOVERY_RATE = 0.01
"""Share of false alarms among the patterns that count as significant."""


@dataclass(frozen=True)
class Pattern:
    """The result of one test of the residuals of a state.

    Parameters
    ----------
    state, pattern
        Whose residuals, and what was tested, in words.
    statistic
        The effect size that the pattern names.
    p_value, adjusted
        Under white noise, alone and adjusted for all patterns of the table (false discovery rate).
    meaning
        The usual cause; empty where it is not significant.
    """

    state: str
    pattern: str
    statistic: float
    p_value: float
    adjusted: float
    meaning: str

    @property
    def significant(self) -> bool:
        """Whether it is more than chance, by `adjusted`."""
        return self.adjusted < FALSE_DISCOVERY_RATE


class AbstractPatterns(ShownInNotebooks):
    """What tests say of residuals; it prints as sentences."""

    patterns: tuple[Pattern, ...]

    @property
    def significant(self) -> tuple[Pattern, ...]:
        """The patterns that are significant."""
        return tuple(pattern for pattern in self.patterns if pattern.significant)

    def tests(self) -> "pd.DataFrame":
        """Return a table of all patterns that were looked for: statistic, p-values, what the significant ones mean."""
        import pandas as pd

        columns = ["state", "pattern", "statistic", "p-value", "adjusted", "meaning"]
        rows = [(p.state, p.pattern, p.statistic, p.p_value, p.adjusted, p.meaning) for p in self.patterns]
        return pd.DataFrame(rows, columns=columns)

    def __str__(self) -> str:
        if not self.patterns:
            return "There are too few residuals to test."
        if not self.significant:
            return "The residuals look like white noise: no pattern is significant."
        return "\n".join(f"Residuals of {p.state}, {p.pattern}: {p.meaning}." for p in self.significant)


@dataclass(frozen=True, eq=False)
class Residuals(AbstractPatterns):
    """Measured minus fitted states of trials in standard deviations of the noise; it prints as sentences.

    Parameters
    ----------
    trials
        The measurements, log-scaled states by their logarithms.
    fitted
        States of each trial, and the rates of those of second order, shape (n, D); measured quantities, and then the
        other states, of a law with observation equations.
    standardized
        Residuals over noise, shape (n, states); NaN where nothing was measured.
    rates
        Units of the rates, or of the other states, by name.
    patterns
        The tests of the residuals.
    """

    trials: Trials
    fitted: tuple[Floats, ...]
    standardized: tuple[Floats, ...]
    rates: Mapping[str, str]
    patterns: tuple[Pattern, ...]

    @cached_property
    def columns(self) -> dict[str, Floats]:
        """What residuals are held against, at all samples, shape (n,): time since the start, states, rates, inputs."""
        schema = self.trials.schema
        since = np.concatenate([trial.times - trial.times[0] for trial in self.trials])
        states = np.concatenate(self.fitted).T
        inputs = np.concatenate([trial.inputs for trial in self.trials]).T
        names = (*schema.states, *self.rates, *schema.inputs)
        return {schema.time: since, **dict(zip(names, (*states, *inputs), strict=True))}

    def to_frame(self) -> "pd.DataFrame":
        """Return a long table: object, trial, time, and of each state the fitted value and the residual over noise."""
        import pandas as pd

        schema, parts = self.trials.schema, []
        for trial, fitted, residuals in zip(self.trials, self.fitted, self.standardized, strict=True):
            part = {schema.object: trial.object, schema.trial: trial.name, schema.time: trial.times}
            for j, name in enumerate(schema.states):
                part[name], part[f"{name} fitted"] = trial.states[:, j], fitted[:, j]
                part[f"{name} residual/noise"] = residuals[:, j]
            parts.append(pd.DataFrame(part))
        return pd.concat(parts, ignore_index=True)

    def __repr__(self) -> str:
        among = f"{len(self.significant)} of {len(self.patterns)} patterns are significant"
        return f"<Residuals of {len(self.trials)} trials: {among}>"

    def correlations(self, state: int, lags: int = 20) -> Floats:
        """Return the correlation of a state's residuals with those so many samples later, shape (lags,), in trials."""
        return correlations([residuals[:, state] for residuals in self.standardized], lags)[0]


def correlations(series: Sequence[Floats], lags: int) -> tuple[Floats, Floats]:
    """Return autocorrelations at lags from 1 on, and the number of pairs of each, shape (lags,); NaN makes no pair."""
    level = np.concatenate(series)
    mean, variance = np.nanmean(level), np.nanvar(level)
    result, counts = np.zeros(lags), np.zeros(lags)
    for k in range(1, lags + 1):
        pairs = [(values[k:] - mean) * (values[:-k] - mean) for values in series if len(values) > k]
        products = np.concatenate([np.empty(0), *pairs])
        products = products[np.isfinite(products)]
        counts[k - 1] = len(products)
        result[k - 1] = products.mean() / variance if len(products) and variance > 0 else 0.0
    return result, counts


MAX_KEPT = 5000
"""Residuals that are kept themselves; of more there are sums only."""

_LARGEST = 1e70
"""Of a residual over its noise: sums of fourth powers of larger ones are infinite."""

_POWERS = 3
"""Residuals are held against polynomials of this degree."""


_NODES = np.polynomial.legendre.leggauss(_POWERS + 1)[0]


@dataclass(frozen=True, eq=False)
class Trend:
    """Residuals against a polynomial of a variable.

    `factor` is the triangular factor of ``[Legendre polynomials over low..high | residuals]``, `values` distinct values
    of the variable, as many as the polynomial has coefficients at most.
    """

    low: float
    high: float
    values: Floats
    factor: Floats

    @classmethod
    def of(cls, values: Floats, residuals: Floats) -> "Trend":
        """Return that of some samples, at least one."""
        low, high = float(values.min()), float(values.max())
        span = high - low
        scaled = 2 * (values - low) / span - 1 if span > 0 else np.zeros_like(values)
        design = np.polynomial.legendre.legvander(scaled, _POWERS)
        return cls(low, high, _first_of(values), triangular(np.column_stack([design, residuals])))

    def __add__(self, other: "Trend") -> "Trend":
        low, high = min(self.low, other.low), max(self.high, other.high)
        factors = [trend._over(low, high) for trend in (self, other)]
        return Trend(low, high, _first_of(np.concatenate([self.values, other.values])), triangular(np.vstack(factors)))

    def explained(self) -> tuple[int, float, float]:
        """Return the degree of the polynomial, the squares that it leaves, and those that a constant leaves."""
        powers = len(self.values) - 1
        factor = triangular(self.factor[:, [*range(powers + 1), -1]])
        return powers, float(factor[-1, -1] ** 2), float(np.sum(factor[1:, -1] ** 2))

    def _over(self, low: float, high: float) -> Floats:
        """Return the factor with the polynomials over a wider range."""
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        nodes = middle + half * _NODES
        scaled = 2 * (nodes - low) / (high - low) - 1 if high > low else np.zeros_like(nodes)
        vander = np.polynomial.legendre.legvander
        changed = np.linalg.solve(vander(_NODES, _POWERS), vander(scaled, _POWERS))
        return np.column_stack([self.factor[:, :-1] @ changed, self.factor[:, -1]])


@dataclass(frozen=True, eq=False)
class StateSums:
    """Sums over the residuals of a state, which merge over parts of the data.

    `powers` are sums of the first four powers, `trends` regressions on variables by name, and `together` triangular
    factors of ``[1 | residuals of an earlier state | residuals]`` with their counts. `pairs` counts neighbours, sums of
    their products and of both, and trials. `cells`, shape (k, 2), and `counts`, shape (k,), are a histogram of the
    sizes of residuals and states; `kept` has both of at most `MAX_KEPT` samples, shape (count, 2).
    """

    count: int
    powers: Floats
    trends: Mapping[str, Trend]
    together: tuple[tuple[int, Floats], ...]
    pairs: Floats
    cells: Floats
    counts: Floats
    kept: Floats | None

    @classmethod
    def of(cls, j: int, residuals: Sequence[Floats], against: Mapping[str, Floats], state: str) -> "StateSums | None":
        """Return those of a state in some trials, see `patterns`; None if it has no residual."""
        residuals = [np.clip(part, -_LARGEST, _LARGEST) for part in residuals]
        whole = np.concatenate(residuals)
        seen = np.isfinite(whole[:, j])
        if not seen.any():
            return None
        numbers, sizes = whole[seen, j], np.abs(against[state][seen])
        cells, counts = np.unique(np.column_stack([_cell(np.abs(numbers)), _cell(sizes)]), axis=0, return_counts=True)
        return cls(
            len(numbers),
            np.array([np.sum(numbers**k) for k in (1, 2, 3, 4)]),
            {name: Trend.of(values[seen], numbers) for name, values in against.items()},
            tuple(_both(whole[:, earlier], whole[:, j]) for earlier in range(j)),
            sum((neighbours(residual[:, j]) for residual in residuals), np.zeros(4)),
            cells,
            np.asarray(counts, dtype=np.float64),
            np.column_stack([numbers, sizes]) if len(numbers) <= MAX_KEPT else None,
        )

    def __add__(self, other: "StateSums") -> "StateSums":
        cells, where = np.unique(np.concatenate([self.cells, other.cells]), axis=0, return_inverse=True)
        kept = None
        if self.kept is not None and other.kept is not None and self.count + other.count <= MAX_KEPT:
            kept = np.concatenate([self.kept, other.kept])
        return StateSums(
            self.count + other.count,
            self.powers + other.powers,
            {name: trend + other.trends[name] for name, trend in self.trends.items()},
            tuple(
                (a + b, triangular(np.vstack([one, two])))
                for (a, one), (b, two) in zip(self.together, other.together, strict=True)
            ),
            self.pairs + other.pairs,
            cells,
            np.bincount(where.ravel(), np.concatenate([self.counts, other.counts])).astype(np.float64),
            kept,
        )

    @property
    def correlation_of_neighbours(self) -> float:
        """The correlation of residuals with the next in the same trial."""
        return float(correlation_of_neighbours(self.count, *self.powers[:2], *self.pairs[:3]))


def correlation_of_neighbours(count: Any, total: Any, squares: Any, pairs: Any, products: Any, sums: Any) -> Any:
    """Return the correlation of neighbours from sums of residuals and their squares, and of pairs; zero of none."""
    mean = total / count
    variance = squares / count - mean**2
    known = (pairs > 0) & (variance > 0)
    covariance = (products - mean * sums) / np.where(known, pairs, 1) + mean**2
    return np.where(known, covariance / np.where(known, variance, 1), 0.0)


def neighbours(own: Floats) -> Floats:
    """Return how many pairs of neighbours a series has, sums of their products and of both, and one."""
    first, second = own[:-1], own[1:]
    both = np.isfinite(first) & np.isfinite(second)
    first, second = first[both], second[both]
    return np.array([len(first), first @ second, first.sum() + second.sum(), 1.0])


def triangular(rows: Floats) -> Floats:
    """Return the square triangular factor of rows."""
    factor = np.linalg.qr(rows, mode="r")
    return np.pad(factor, ((0, rows.shape[1] - len(factor)), (0, 0)))


def ranks(cells: Floats, counts: Floats) -> Floats:
    """Return the mean rank of what is in each cell, whose order is that of numbers, shape (k,)."""
    _, where = np.unique(cells, return_inverse=True)
    inside = np.bincount(where, counts)
    return np.asarray((np.cumsum(inside) - (inside - 1) / 2)[where])


def _first_of(values: Floats) -> Floats:
    return np.unique(values)[: _POWERS + 1]


def _cell(sizes: Floats) -> Floats:
    with np.errstate(divide="ignore"):
        # Cells for each factor of two
        return np.asarray(np.maximum(np.floor(np.log2(sizes) * 16), (-(1 << 14))), dtype=np.int16)


def _both(other: Floats, own: Floats) -> tuple[int, Floats]:
    both = np.isfinite(other) & np.isfinite(own)
    rows = np.column_stack([np.ones(both.sum()), other[both], own[both]])
    return int(both.sum()), triangular(rows) if len(rows) else np.zeros((3, 3))


_MIN_RESIDUALS = 20
"""Fewer residuals are not tested."""


Tested = tuple[str, float, float, str]
"""A pattern with its statistic and p-value, and what it means if it is significant."""


def patterns(
    names: Sequence[str], residuals: Sequence[Floats], against: Mapping[str, Floats], time: str, spent: Sequence[float]
) -> tuple[Pattern, ...]:
    """Return the tests of residuals over noise.

    `residuals` have the shape (n, states) for each trial, NaN where nothing was measured; `against` are regressors by
    name at all samples of all trials, `time` is one of these, and `spent` the degrees of freedom that the fit took from
    each state.
    """
    sums = [StateSums.of(j, residuals, against, name) for j, name in enumerate(names)]
    return patterns_of(names, sums, time, spent)


def patterns_of(
    names: Sequence[str], sums: Sequence[StateSums | None], time: str, spent: Sequence[float]
) -> tuple[Pattern, ...]:
    """Return what tests say of residuals over noise, of which sums are known for each state that has some."""
    from scipy.stats import false_discovery_control

    tested = [
        (name, *test)
        for name, state_sums, taken in zip(names, sums, spent, strict=True)
        if state_sums is not None and state_sums.count >= _MIN_RESIDUALS
        for test in _of_state(names, name, state_sums, time, taken)
    ]
    if not tested:
        return ()
    adjusted = false_discovery_control([p_value for *_, p_value, _ in tested], method="by")
    return tuple(
        Pattern(name, pattern, statistic, p_value, share, meaning if share < FALSE_DISCOVERY_RATE else "")
        for (name, pattern, statistic, p_value, meaning), share in zip(tested, adjusted.tolist(), strict=True)
    )


def size_over_noise(count: int, squares: float, spent: float) -> tuple[float, float]:
    """Return the ratio of residuals to the noise, which was estimated from as many, and its p-value (F test)."""
    from scipy.special import fdtr, fdtrc

    free = max(count - spent, 1)
    ratio = squares / free
    p_value = 2 * min(fdtrc(free, count, ratio), fdtr(free, count, ratio))
    return float(np.sqrt(ratio)), float(min(p_value, 1.0))


def _of_state(names: Sequence[str], name: str, sums: StateSums, time: str, spent: float) -> Iterator[Tested]:
    ratio, p_value = size_over_noise(sums.count, float(sums.powers[1]), spent)
    larger = "lack of fit, or the noise is underestimated"
    yield ("RMS over noise", ratio, p_value, larger if ratio > 1 else "the noise is overestimated")
    for variable, trend in sums.trends.items():
        yield _trend(trend, sums.count, variable, time)
    for earlier, (count, factor) in zip(names, sums.together, strict=False):
        yield _together(count, factor, earlier)
    from scipy.special import chdtrc

    pairs, *_, trials = sums.pairs.tolist()
    share = min(spent / sums.count, 0.9)  # Finite below if parameters outnumber residuals
    correlation = sums.correlation_of_neighbours + share / (1 - share) * np.sinc(share)
    size = pairs + trials
    total = size * (size + 2) * correlation**2 / pairs if pairs > 1 else 0.0
    positive = "autocorrelated: an unmodelled force, or autocorrelated errors (`errors='autocorrelated'`)"
    negative = "negatively autocorrelated: rounded or differenced samples, or too coarse steps"
    yield ("autocorrelation", float(correlation), float(chdtrc(1, total)), positive if correlation > 0 else negative)
    yield _growth(sums, name, spent / sums.count)
    yield _normal(sums)


def _trend(trend: Trend, count: int, name: str, time: str) -> Tested:
    """Compare with a polynomial (F test); the statistic is the share of the variance that it explains."""
    from scipy.special import fdtrc

    powers, rest, total = trend.explained()
    free = count - powers - 1
    share = 1 - rest / total if total > 0 else 0.0
    p_value = float(fdtrc(powers, free, (total - rest) / powers / (rest / free))) if powers and rest > 0 else 1.0
    if name == time:
        meaning = "an unmodelled change with time, or a transient at the start"
    else:
        meaning = f"a term in {name}, or in a collinear variable, is missing; estimate it with discrepancy"
    return (f"trend with {name}", share, p_value, meaning)


def _together(count: int, factor: Floats, name: str) -> Tested:
    """Correlate with the residuals of another state (Pearson)."""
    from scipy.special import betaincc

    across, rest = factor[1:, 2].tolist()
    total = np.hypot(across, rest)
    if count < _MIN_RESIDUALS or not (factor[1, 1] and total):
        return (f"correlation with residuals of {name}", 0.0, 1.0, "")
    correlation = float(np.sign(factor[1, 1]) * across / total)
    p_value = 2 * float(betaincc(count / 2 - 1, count / 2 - 1, (1 + abs(correlation)) / 2))
    meaning = "a common disturbance or a common measurement error"
    return (f"correlation with residuals of {name}", correlation, p_value, meaning)


def _growth(sums: StateSums, name: str, spent: float) -> Tested:
    """Rank the sizes of residuals by those of the states (Spearman); very many by cells of sizes.

    A fit removes that share of the squares of white noise, unevenly over states: as much growth is not significant.
    """
    from scipy.special import stdtr

    if sums.kept is None:
        cells, counts = sums.cells, sums.counts
    else:
        cells, counts = np.abs(sums.kept), np.ones(sums.count)
    first, second = (ranks(column, counts) - (sums.count + 1) / 2 for column in cells.T)
    scale = np.sqrt((counts @ first**2) * (counts @ second**2))
    if not scale:
        return ("heteroscedasticity", 0.0, 1.0, "")
    correlation = float(np.clip(counts @ (first * second) / scale, -1.0, 1.0))
    free = sums.count - 2
    odds = free / ((1 + correlation) * (1 - correlation)) if abs(correlation) < 1 else np.inf
    meaning = f"noise changes with {name}: `errors='proportional'`, or a logarithmic scale if it is above zero"
    beyond = max(abs(correlation) - spent / 2, 0.0)
    return ("heteroscedasticity", correlation, float(2 * stdtr(free, -beyond * np.sqrt(odds))), meaning)


def _normal(sums: StateSums) -> Tested:
    """Test by Shapiro and Wilk, or very many by skewness and kurtosis; the statistic is the excess kurtosis."""
    from scipy.special import chdtrc

    mean, *powers = sums.powers / sums.count
    second, third, fourth = powers
    variance = max(second - mean**2, 0.0)
    lean = (third - 3 * mean * second + 2 * mean**3) / variance**1.5 if variance else 0.0
    tails = (fourth - 4 * mean * third + 6 * mean**2 * second - 3 * mean**4) / variance**2 - 3 if variance else 0.0
    if not variance or (sums.kept is not None and not np.ptp(sums.kept[:, 0])):
        p_value = 1.0
    elif sums.kept is None:
        p_value = float(chdtrc(2, sums.count * (lean**2 / 6 + tails**2 / 24)))
    else:
        from scipy.stats import shapiro

        p_value = float(shapiro(sums.kept[:, 0]).pvalue)
    if tails > 2 * abs(lean):
        meaning = "tails are heavy: there are outliers, or noise differs between trials"
    elif abs(lean) > 0.5:
        meaning = "errors lean to one side: values are cut off, or a logarithmic scale fits better"
    else:
        meaning = "errors are not normal: values were rounded, or come from a mixture"
    return ("normality (excess kurtosis)", tails, p_value, meaning)
