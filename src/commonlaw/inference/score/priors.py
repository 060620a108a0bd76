"""The prior of supports: beta-binomial, with a description length of terms."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import lgamma

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference.settings import GENERIC_POINTS, ROUNDING
from commonlaw.library import Terms


@dataclass(frozen=True, eq=False)
class StructurePrior:
    """The prior of the support of one equation.

    A support S of s out of N terms has minus twice the log prior

        -2 log [B(1 + s, 2 N - s) / B(1, N)] + sum of w_k over S + c z(S).

    The first part is beta-binomial: each term is included with a probability that has the beta distribution of
    parameters 1 and N, so that one term is expected (Castillo, Schmidt-Hieber and van der Vaart 2015). w_k is the
    description length of term k, one bit (2 log 2) for each factor, and z(S) counts the states with an arbitrary origin
    of which S fixes the origin.

    The penalties w_k of terms have shape (terms,); `zero` is the penalty c of a fixed origin, that of one fitted
    number. `shifted` has for each state with an arbitrary origin which terms each term needs to be invariant to a shift
    of the origin, shape (terms, terms). N includes `excluded_terms`, those that were screened out before.
    """

    terms: Floats
    shifted: Sequence[Bools] = ()
    zero: float = 0.0
    excluded_terms: int = 0

    def of(self, support: Bools) -> float:
        """Return minus twice the log prior of a support, shape (terms,)."""
        count, size = len(support) + self.excluded_terms, int(support.sum())
        log_prior = _betaln(1 + size, 2 * count - size) - _betaln(1, count)
        fixed_origins = sum(bool((needed[support] & ~support).any()) for needed in self.shifted)
        return -2 * log_prior + float(self.terms[support].sum()) + fixed_origins * self.zero


def shifted(terms: Terms, column: int) -> Bools:
    """Return which other terms each term needs to be invariant to a shift of a variable, shape (terms, terms).

    They are the terms of its derivative by the variable; all, if that is not in the span of the terms.
    """
    points = np.random.default_rng(0).uniform(0.5, 2.0, (4 * len(terms) + GENERIC_POINTS, len(terms.variables.names)))
    with np.errstate(all="ignore"):
        values, slopes = terms.evaluate(points), terms.jacobian(points)[:, :, column]
    if not (np.isfinite(values).all() and np.isfinite(slopes).all()):
        return np.zeros((len(terms), len(terms)), dtype=bool)
    mixtures = np.linalg.lstsq(values, slopes, rcond=1e-12)[0].T
    wrong = np.abs(values @ mixtures.T - slopes).max(axis=0) > ROUNDING * np.maximum(1.0, np.abs(slopes).max(axis=0))
    return np.where(wrong[:, np.newaxis], True, np.abs(mixtures) > ROUNDING)


def _betaln(a: float, b: float) -> float:
    return lgamma(a) + lgamma(b) - lgamma(a + b)
