"""What dimensional analysis says of relations: which exponents leave a factor without a unit, or with a known one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from commonlaw.array_types import Bools, Floats

_NO_UNIT, _CONSTANT = np.log(10.0), np.log(3.0)
"""How much more probable exponents are that leave a factor without a unit, or with that of a known constant."""

_SAME = 1e-9
"""Exponents of dimensions that differ by less are the same."""


@dataclass(frozen=True, eq=False)
class Dimensions:
    """Exponents of base dimensions (length, time, mass, ...), as far as they are known.

    Parameters
    ----------
    coefficients
        Of each coefficient, shape (dimensions,), or None where they are not known.
    properties
        Of properties by name.
    constants
        Of constants of nature and matter, shape (constants, dimensions).
    """

    coefficients: Sequence[Floats | None]
    properties: Mapping[str, Floats]
    constants: Floats

    def log_odds(self, index: int, names: Sequence[str], exponents: Floats) -> Floats:
        """Return the logarithms of how much more probable sets of exponents of these properties are, shape (sets,)."""
        own = self.coefficients[index]
        if own is None:
            return np.zeros(len(exponents))
        known = np.array([name in self.properties for name in names], dtype=np.bool_)
        used = np.array([self.properties.get(name, np.zeros_like(own)) for name in names]).reshape(len(names), len(own))
        left = own - exponents @ used
        constant = np.any([_same(left, each) for each in self.constants], axis=0) if len(self.constants) else False
        odds = np.where(_same(left, np.zeros_like(own)), _NO_UNIT, np.where(constant, _CONSTANT, 0.0))
        return np.where((exponents[:, ~known] != 0).any(axis=1), 0.0, odds)


def _same(left: Floats, right: Floats) -> Bools:
    return np.asarray(abs(left - right).max(axis=1, initial=0.0) < _SAME)
