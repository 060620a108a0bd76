"""What it costs to say which terms an equation has: the prior of supports, in minus twice its logarithm."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import lgamma

import numpy as np

from commonlaw.array_types import Bools, Floats
from commonlaw.inference.settings import GENERIC_POINTS, ROUNDING
from commonlaw.library import Terms


@dataclass(frozen=True, eq=False)
class Prices:
    """The prices of supports of one equation.

    Parameters
    ----------
    terms
        Of each term for what it is written with, shape (terms,).
    shifted
        For each state whose zero nothing measured, which terms each term takes to keep its form where the state is
        counted from elsewhere, shape (terms, terms).
    zero
        Of a law that says where such a zero is: it is right by chance, and a number that is fitted would cost as much.
    besides
        Terms that were to choose from and are not among these.
    """

    terms: Floats
    shifted: Sequence[Bools] = ()
    zero: float = 0.0
    besides: int = 0

    def of(self, support: Bools) -> float:
        """Return the price of a support, shape (terms,).

        Terms are in it with a probability that is not known, of which one of a library is expected: it has the beta
        distribution of the parameters 1 and the number of terms (Castillo, Schmidt-Hieber and van der Vaart 2015).
        """
        count, size = len(support) + self.besides, int(support.sum())
        likely = _betaln(1 + size, 2 * count - size) - _betaln(1, count)
        zeros = sum(bool((each[support] & ~support).any()) for each in self.shifted)
        return -2 * likely + float(self.terms[support].sum()) + zeros * self.zero


def complexity_prices(terms: Terms) -> Floats:
    """Return what terms cost, shape (terms,): each factor one bit, by which a text tells whether a term goes on."""
    return np.asarray(2 * np.log(2) * terms.complexities)


def shifted(terms: Terms, column: int) -> Bools:
    """Return which other terms each term takes where a variable is counted from elsewhere, shape (terms, terms).

    They are those of its derivative by the variable; all, where that is no sum of terms.
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
    """Return the logarithm of the beta function."""
    return lgamma(a) + lgamma(b) - lgamma(a + b)
