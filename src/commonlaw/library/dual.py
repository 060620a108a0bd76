"""Exact derivatives by computing with a value and its slopes together (forward mode)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from commonlaw.array_types import Floats
from commonlaw.library.grammar import FUNCTIONS, Algebra


@dataclass(frozen=True)
class Dual:
    """A value, shape (n,), and its derivatives by the variables it depends on, by column, of that shape or numbers."""

    value: Any
    slopes: Mapping[int, Any]

    __array_ufunc__ = None  # NumPy's numbers then leave the operation to this class

    def chain(self, value: Any, slope: Any) -> "Dual":
        """Return the function of this that has that value and, by this, that slope."""
        return Dual(value, {i: slope * inner for i, inner in self.slopes.items()})

    def __neg__(self) -> "Dual":
        return self.chain(-self.value, -1.0)

    def __add__(self, other: Any) -> "Dual":
        if not isinstance(other, Dual):
            return Dual(self.value + other, self.slopes)
        both = {i: self.slopes.get(i, 0.0) + other.slopes.get(i, 0.0) for i in {**self.slopes, **other.slopes}}
        return Dual(self.value + other.value, both)

    def __sub__(self, other: Any) -> "Dual":
        return self.__add__(-other)

    def __mul__(self, other: Any) -> "Dual":
        if not isinstance(other, Dual):
            return self.chain(self.value * other, other)
        product = self.value * other.value
        slopes = self.chain(product, other.value) + other.chain(product, self.value)
        return Dual(product, slopes.slopes)

    def __truediv__(self, other: Any) -> "Dual":
        if not isinstance(other, Dual):
            return self.chain(self.value / other, 1 / other)
        quotient = self.value / other.value
        slopes = self.chain(quotient, 1 / other.value) + other.chain(quotient, -quotient / other.value)
        return Dual(quotient, slopes.slopes)

    def __rsub__(self, other: float) -> "Dual":
        return -self + other

    def __rtruediv__(self, other: float) -> "Dual":
        quotient = other / self.value
        return self.chain(quotient, -quotient / self.value)

    def __pow__(self, exponent: Any) -> "Dual":
        if isinstance(exponent, Dual):
            power = self.value**exponent.value
            by_base = self.chain(power, exponent.value * self.value ** (exponent.value - 1))
            return Dual(power, (by_base + _power(self.value, exponent)).slopes)
        slope = 0.0 if exponent == 0 else exponent * self.value ** (exponent - 1)
        return self.chain(self.value**exponent, slope)

    def __rpow__(self, base: float) -> "Dual":
        return _power(base, self)

    __radd__ = __add__
    __rmul__ = __mul__


def _power(base: Any, exponent: Dual) -> Dual:
    """Return a power that depends on its exponent alone; that of zero is zero whatever stands above."""
    value = base**exponent.value
    return exponent.chain(value, np.where(value == 0, 0.0, value * np.log(base)))


_SLOPES: Mapping[str, Callable[[Floats, Floats], Any]] = {
    "abs": lambda x, _: np.sign(x),
    "sqrt": lambda _, root: 0.5 / root,
    "exp": lambda _, power: power,
    "log": lambda x, _: 1 / x,
    "sin": lambda x, _: np.cos(x),
    "cos": lambda x, _: -np.sin(x),
    "tan": lambda _, tangent: 1 + tangent**2,
    "sinh": lambda x, _: np.cosh(x),
    "cosh": lambda x, _: np.sinh(x),
    "tanh": lambda x, _: 1 / np.cosh(x) ** 2,
    "arctan": lambda x, _: 1 / (1 + x**2),
    "sign": lambda x, _: 0.0 * x,
}


def _function(name: str) -> Callable[[Any], Any]:
    function, slope = FUNCTIONS[name], _SLOPES[name]

    def apply(argument: Any) -> Any:
        if not isinstance(argument, Dual):
            return function(argument)
        value = function(argument.value)
        return argument.chain(value, slope(argument.value, value))

    return apply


DUAL = Algebra(float, {name: _function(name) for name in FUNCTIONS})
