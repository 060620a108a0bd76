"""Powers of properties that a coefficient may follow: products with small rational exponents, simple ones first."""

from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import combinations, product

import numpy as np

from commonlaw.array_types import Floats

_MOST_PRICE = (9, 12, 10)
"""Largest price of the exponents of one, of two and of three properties together; more properties are not tried."""

_MOST_SETS = 200_000
"""Of exponents: of more properties than ten, no three are tried together, and of more than 25, no two."""

_LARGEST, _MOST_PARTS = 4, 4
"""Largest exponent, and largest denominator."""

_NEXT = 0.5
"""How probable one more property is."""


@dataclass(frozen=True, eq=False)
class ExponentSets:
    """Sets of exponents, and how probable each is before anything is measured, among all.

    Exponents have the shape (sets, properties), the logarithms of the probabilities (sets,).
    """

    exponents: Floats
    log_prior: Floats


@cache
def exponent_sets(properties: int, most: int) -> ExponentSets:
    """Return the sets of exponents of so many properties, at most so many of them not zero.

    An exponent p/q costs p + q bits, so that simple ones are more probable. Sets of the same number of properties share
    one probability, whichever the properties are: what more properties are offered, the less probable is each.
    """
    bits, values = np.array([*_priced_exponents()]).T
    norm = np.log2(np.sum(2.0**-bits))
    exponents, log_prior = [np.empty((0, properties))], [np.empty(0)]
    for size in range(1, min(most, properties, len(_MOST_PRICE)) + 1):
        limit = _MOST_PRICE[size - 1]
        few = bits <= limit - 2 * (size - 1)
        indices = np.array(list(product(np.flatnonzero(few), repeat=size)))
        price = bits[indices].sum(axis=1)
        indices, price = indices[price <= limit], price[price <= limit]
        chosen = list(combinations(range(properties), size))
        if len(chosen) * len(indices) > _MOST_SETS:
            break
        for columns in chosen:
            own = np.zeros((len(indices), properties))
            own[:, columns] = values[indices]
            exponents.append(own)
            log_prior.append(np.log(2) * -(price + size * norm) + (size - 1) * np.log(_NEXT) - np.log(len(chosen)))
    weights = np.concatenate(log_prior)
    total = np.logaddexp.reduce(weights) if len(weights) else 0.0
    return ExponentSets(np.concatenate(exponents), weights - total)


def simple_fraction(value: float) -> Fraction:
    """Return the exponent of this value."""
    return Fraction(value).limit_denominator(_MOST_PARTS)


def _priced_exponents() -> list[tuple[int, float]]:
    """Return the exponents and their prices in bits."""
    found = {Fraction(p, q) for q in range(1, _MOST_PARTS + 1) for p in range(1, _LARGEST * q + 1)}
    priced = [(each.numerator + each.denominator, float(each)) for each in sorted(found)]
    return [(bits, sign * value) for bits, value in priced if bits <= _MOST_PRICE[0] for sign in (1, -1)]
