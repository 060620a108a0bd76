"""Strange objects: those that contradict the law that the others share.

An object follows the shared law with probability 1 - pi, and with pi another one; pi has the beta distribution of
parameters 1 and 9, so that one object in ten is expected to be strange. With k strange ones of n objects,

    -2 log p(y) = E(S; others) + sum over strange o of E_o(S_o) - 2 log [B(1 + k, 9 + n - k) / B(1, 9)],

where E is minus twice the log-evidence with the prior of the support: a strange object pays for its own law S_o. The
evidence of a law that all share has the scatter of its coefficients over objects. So a term that one object needs costs
the others next to nothing where their measurements hardly determine its coefficient, and much where they exclude one of
comparable size. An object that reveals a term is not strange, but one that the others contradict is.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import erfc, lgamma
from typing import Literal

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.diagnostics import Outcome, note
from commonlaw.inference import settings
from commonlaw.inference.fit.fit import Fit
from commonlaw.inference.score.score import Score
from commonlaw.inference.score.supports import SupportEvidence
from commonlaw.inference.search.pool import Pool
from commonlaw.likelihood import HUBER_THRESHOLD
from commonlaw.text import shown

Reason = Literal["law", "units", "errors", "coefficients"]
"""Why an object is strange: another law, units, or kinds of errors, or coefficients or noise far from the others."""


@dataclass(frozen=True)
class StrangeObject:
    """An object that does not follow the law of the others, with a probability, and why, in words."""

    name: str
    probability: float
    reason: Reason
    words: str

    @property
    def probability_in_words(self) -> str:
        return f"{self.probability:.3g}" if self.probability < 0.9995 else "above 0.999"


@dataclass(frozen=True, eq=False)
class Apart:
    """Objects that are strange to the law of the others, and the score of that law with what explains them."""

    score: Score
    objects: tuple[StrangeObject, ...]


def most_strange(objects: int) -> int:
    """Return how many of so many objects may be strange: less than a third of four or more."""
    return (objects - 1) // 3 if objects >= settings.MIN_OBJECTS_WITH_STRANGE else 0


def partition_penalty(strange: int, objects: int) -> float:
    """Return minus twice the log prior of so many strange objects, which ones is known: beta-binomial."""

    def betaln(a: float, b: float) -> float:
        return lgamma(a) + lgamma(b) - lgamma(a + b)

    follow, stray = settings.STRANGE_ODDS
    return -2 * (betaln(stray + strange, follow + objects - strange) - betaln(stray, follow))


def poorly_fitted(residuals: Sequence[tuple[str, Floats]]) -> tuple[str, ...]:
    """Return the few objects whose residuals are autocorrelated where those of the others are not.

    Residuals of an object are those of a trial and state, shape (n,), several for each name. With n residuals and m
    pairs of neighbours, r sqrt(m) of the autocorrelation r is standard normal for white noise; the test is one-sided
    at `MISFIT_LEVEL` over all objects.
    """
    sums = dict[str, Floats]()
    for name, series in residuals:
        scale = float(np.median(np.abs(series))) / 0.6745 if len(series) else 0.0
        usual = series[np.abs(series) <= HUBER_THRESHOLD * scale] / max(scale, np.finfo(float).tiny)
        parts = usual[1:] @ usual[:-1], max(len(usual) - 1, 0), usual @ usual, len(usual)
        sums[name] = sums.get(name, np.zeros(4)) + np.array(parts, dtype=np.float64)
    level, names = settings.MISFIT_LEVEL / max(len(sums), 1), list[str]()
    for name, (products, pairs, squares, count) in sums.items():
        score = products / squares * count / np.sqrt(pairs) if squares > 0 and pairs > 0 else 0.0
        names += [name] * (erfc(score / np.sqrt(2)) / 2 < level)
    return tuple(names) if len(names) <= most_strange(len(sums)) else ()


def outcomes_of_misfit(residuals: Sequence[tuple[str, Floats]]) -> tuple[Outcome, ...]:
    """Return a note on the few objects that a law does not fit while it fits the others, see `poorly_fitted`."""
    names = poorly_fitted(residuals)
    return (note("objects-not-fitted", objects=shown(names, "object")),) if names else ()


def suspects(pool: Pool, excluded: int) -> tuple[str, ...]:
    """Return the objects without which a law of fewer terms, or without a model error, may be more probable.

    So many were `excluded` before.
    """
    best, objects = pool.best, len(pool.best.problem.models)
    most = most_strange(objects + excluded) - excluded
    if most <= 0:
        return ()
    indices = _outside(pool, most)
    if not indices and not best.has_model_error:
        indices = _contradicting(best, most, excluded)
    return tuple(best.problem.trials.objects[o] for o in indices)


def _outside(pool: Pool, most: int) -> Sequence[int]:
    """Return the few objects of which a law without a model error leaves more than noise, if it leaves others no more.

    Noise is that before any law. Sums of squares of the others are within `SIGNIFICANT` standard deviations of its.
    """
    measured, fewest, least = np.array(pool.best.problem.measured), list[int](), most + 1
    for fit in (*pool.fits, *pool.explored):
        if not fit.is_usable or fit.has_model_error:
            continue
        variance = float(np.mean((fit.problem.noise / fit.problem.noise_estimate) ** 2))
        squares = variance * np.array([estimate.deviance for estimate in fit.estimates])
        order = np.argsort(-squares / measured, kind="stable")
        for count in range(int(pool.best.has_model_error), least):
            rest = order[count:]
            expected = float(measured[rest].sum())
            if float(squares[rest].sum()) < expected + settings.SIGNIFICANT * np.sqrt(2 * expected):
                fewest, least = order[:count].tolist(), count
                break
    return fewest


def _contradicting(fit: Fit, most: int, excluded: int) -> Sequence[int]:
    """Return the objects whose own laws and a law of the others are together more probable than one law of all.

    The likelihood is linearized about the fit, with its noise.
    """
    evidence, measured, objects = fit.evidence, fit.problem.measured, range(len(fit.problem.models))
    scale = float(np.sqrt(evidence.noise_variance(fit.supports)))
    parts = dict[tuple[int, ...], SupportEvidence]()

    def value(indices: Sequence[int], supports: Bools) -> float:
        key = tuple(indices)
        if key not in parts:
            parts[key] = evidence.of_objects(key, sum(measured[o] for o in key), scale)
        return parts[key].value(supports)

    near = [fit.supports, *(alternative.supports for alternative in fit.alternatives), *_smaller(fit.supports)]
    candidates = list({supports.tobytes(): supports for supports in near}.values())
    proposed = [*candidates, *_larger(fit.supports, evidence.allowed)]
    alone = np.array([[value([o], supports) for supports in proposed] for o in objects])
    together, best = min(value(objects, supports) for supports in candidates), list[int]()
    none = partition_penalty(excluded, len(objects) + excluded)
    for i, supports in enumerate(candidates):
        is_other = np.array([bool((rival & ~supports).any()) for rival in proposed])
        apart = alone[:, is_other].min(axis=1, initial=np.inf)
        gains = np.subtract(apart, alone[:, i], where=np.isfinite(apart), out=np.full(len(apart), np.inf))
        order = np.argsort(gains, kind="stable").tolist()
        for count in range(1, most + 1):
            chosen = order[:count]
            if not apart[chosen[-1]] < alone[chosen[-1], i]:
                break
            prior = partition_penalty(excluded + count, len(objects) + excluded) - none
            rest = [o for o in objects if o not in chosen]
            total = value(rest, supports) + float(apart[chosen].sum()) + prior
            if total < together:
                together, best = total, chosen
    return best


def _smaller(supports: Bools) -> Iterator[Bools]:
    """Yield supports with one or two terms fewer in one equation; of many terms, with one fewer."""
    for j, support in enumerate(supports):
        for count in (1, 2) if support.sum() <= settings.MAX_NUMBERS else (1,):
            for leaving in combinations(np.flatnonzero(support).tolist(), count):
                smaller = supports.copy()
                smaller[j, list(leaving)] = False
                yield smaller


def _larger(supports: Bools, allowed: Bools) -> Iterator[Bools]:
    """Yield supports with one term more in one equation."""
    for j, k in np.argwhere(allowed & ~supports).tolist():
        larger = supports.copy()
        larger[j, k] = True
        yield larger
