"""Products of powers of variables."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library.naming import powered, quoted
from commonlaw.library.term import AbstractTerm


@dataclass(frozen=True)
class Monomial(AbstractTerm):
    """A product of powers of variables, such as ``x^2 v``; without any it is the constant 1.

    Parameters
    ----------
    exponents
        The power of each variable, none negative, shape (number of variables).
    """

    exponents: tuple[int, ...]

    @property
    def degree(self) -> int:
        """The sum of the exponents."""
        return sum(self.exponents)

    @cached_property
    def _factors(self) -> tuple[int, ...]:
        """The column of each factor, repeated for powers."""
        return tuple(i for i, power in enumerate(self.exponents) for _ in range(power))

    def evaluate(self, values: Floats) -> Floats:
        if not self._factors:
            return np.ones(len(values))
        first, *others = self._factors
        result = values[:, first].copy()
        if others:
            with np.errstate(all="ignore"):
                for i in others:
                    result *= values[:, i]
        return result

    def gradient(self, values: Floats) -> Floats:
        result = np.zeros(values.shape)
        with np.errstate(all="ignore"):
            for i in self.columns():
                result[:, i] = self.exponents[i] * self._lowered(i).evaluate(values)
        return result

    def parts(self) -> tuple[np.ufunc, AbstractTerm, AbstractTerm] | None:
        """Return the monomial of one degree less, and the last variable."""
        if self.degree < 2:
            return None
        last = max(self.columns())
        return np.multiply, self._lowered(last), variable(last, len(self.exponents))

    def columns(self) -> frozenset[int]:
        return self._columns

    @cached_property
    def _columns(self) -> frozenset[int]:
        return frozenset(self._factors)

    def complexity(self) -> float:
        return self.degree

    def text(self, names: Sequence[str]) -> str:
        """Return ``x^2 v``."""
        return " ".join(self.powers(names, "^")) or "1"

    def expression(self, names: Sequence[str]) -> str:
        """Return ``x**2*v``."""
        return "*".join(self.powers([quoted(name) for name in names], "**")) or "1"

    def powers(self, names: Sequence[str], sign: str) -> list[str]:
        """Return the powers that it is the product of, written with that sign: ``x^2`` and ``v``."""
        return [powered(name, power, sign) for name, power in zip(names, self.exponents, strict=True) if power]

    def _lowered(self, column: int) -> "Monomial":
        return Monomial(tuple(power - (i == column) for i, power in enumerate(self.exponents)))


def variable(column: int, count: int) -> Monomial:
    """Return the term that is one of `count` variables."""
    return Monomial(tuple(int(i == column) for i in range(count)))
