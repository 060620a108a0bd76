"""The parameters of a law: what its names stand for, in the coefficients of terms."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from commonlaw.array_types import Floats


class Part(NamedTuple):
    """A power of a coefficient of the law, divided by a number, as it stands in what a name means."""

    equation: int
    term: int
    factor: float = 1.0
    power: int = 1


class Coefficient(NamedTuple):
    """A coefficient by the name that a user knows it by, as a product of powers of coefficients of terms.

    In ``x'' = -2 x/m`` it is -2 over that of x. In ``T' = -k (T - a)``, multiplied out ``-k T + k a``, a is the
    coefficient of 1 over minus that of T. A constant inside of terms is the coefficient of its own, see
    `Terms.constants`.
    """

    name: str
    parts: tuple[Part, ...]

    @property
    def equation(self) -> int:
        """The equation where it stands first."""
        return self.parts[0].equation

    @property
    def term(self) -> int:
        """The term that it stands before first."""
        return self.parts[0].term

    def value(self, wholes: Sequence[Floats]) -> Floats:
        """Return what the name stands for, from the whole number before each of its terms; infinite over 0."""
        found = np.ones_like(wholes[0])
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for part, whole in zip(self.parts, wholes, strict=True):
                found = found * (whole / part.factor) ** np.float64(part.power)
        return np.asarray(found)

    def of(self, coefficients: Floats) -> Floats:
        """Return what it stands for, from coefficients whose last axes are equations and terms."""
        return self.value([coefficients[..., each.equation, each.term] for each in self.parts])

    def gradient(self, coefficients: Floats) -> Floats:
        """Return its derivatives by the coefficients of its parts, shape (objects, parts)."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            wholes = [coefficients[:, each.equation, each.term] for each in self.parts]
            shares = [part.power / whole for part, whole in zip(self.parts, wholes, strict=True)]
            return np.asarray(self.value(wholes)[:, np.newaxis] * np.stack(shares, axis=1))


class Product(NamedTuple):
    """What stands before a term: a number and coefficients with their powers of 1 or -1, by name."""

    equation: int
    term: int
    factor: float
    coefficients: tuple[tuple[str, int], ...]

    def value(self, values: Mapping[str, Floats]) -> Floats:
        """Return it, from values by name."""
        found = np.asarray(self.factor, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            for name, power in self.coefficients:
                found = found * np.asarray(values[name], dtype=np.float64) ** power
        return np.asarray(found)
