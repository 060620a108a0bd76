"""How often the terms of a known law are found again."""

from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest

from commonlaw.array_types import Bools
from commonlaw.law import Law
from commonlaw.law.law import object_index


@dataclass(frozen=True)
class Recovery:
    """In how many of some independent tries, at least one, the right terms were found.

    Examples
    --------
    >>> Recovery(45, 50).share
    0.9
    >>> low, high = Recovery(45, 50).interval()
    >>> print(f"{low:.3f} to {high:.3f}")
    0.786 to 0.957
    """

    found: int
    tried: int

    @property
    def share(self) -> float:
        """Share of the tries in which the right terms were found."""
        return self.found / self.tried

    def interval(self) -> tuple[float, float]:
        """Return the 95 % interval (Wilson 1927) of the probability of finding them."""
        ends = binomtest(self.found, self.tried).proportion_ci(0.95, method="wilson")
        return float(ends.low), float(ends.high)


def recovered(law: Law, truth: Law) -> Bools:
    """Return which objects of a law have exactly the terms of the true law, by name, shape (objects,)."""
    return np.array([_terms(law, name) == _terms(truth, name) for name in law.objects])


def _terms(law: Law, name: str) -> set[tuple[int, str]]:
    """Return the equation and name of each term of an object."""
    return {(int(j), law.terms.names[k]) for j, k in np.argwhere(law.coefficients[object_index(law, name)])}
